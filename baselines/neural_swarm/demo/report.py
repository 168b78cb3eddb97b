"""The demonstration's numbers: a summary for machines, a table for the terminal."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from swarm_envs.baselines.neural_swarm.demo.flights import CONTROLLERS, HORIZON_S, Flight
from swarm_envs.baselines.neural_swarm.flights import PAPER_SWAP
from swarm_envs.baselines.neural_swarm.summary import (
    describe_model,
    describe_spread,
    format_columns,
    quartiles,
    versions,
)
from swarm_envs.interactions import InteractionModel, load
from swarm_envs.viewing.record import FlightRecord


def summarise(
    seed: int,
    seeds: Sequence[int],
    engine: str,
    belief: InteractionModel,
    flown: Mapping[str, Mapping[str, list[Flight]]],
) -> dict[str, Any]:
    """What `summary.json` holds of the flights.

    Args:
        seed: the one from which the others were drawn.
        seeds: one for each swap.
        engine: that flew.
        belief: of the compensating controller.
        flown: flights by team and by controller.
    """
    return {
        "seed": seed,
        "swaps": len(seeds),
        "engine": engine,
        "layout": {
            "radius_m": PAPER_SWAP.radius_m[0],
            "duration_s": PAPER_SWAP.duration_s[0],
            "gap_m": list(PAPER_SWAP.gap_m),
            "horizon_s": HORIZON_S,
        },
        "interactions": describe_model(load("learned")),
        "belief": describe_model(belief),
        "versions": versions(),
        "scenarios": {team: _scenario(sides, seeds) for team, sides in flown.items()},
    }


def _scenario(sides: Mapping[str, list[Flight]], seeds: Sequence[int]) -> dict[str, Any]:
    entry: dict[str, Any] = {}
    worst = {}
    for name, flights in sides.items():
        worst[name] = np.array([record.worst_height_error_cm() for record, _ in flights])
        entry[name] = {
            "crashed": sum(metrics["length_s"] < HORIZON_S - 1e-6 for _, metrics in flights),
            "worst_height_error_cm": quartiles(worst[name]),
            "flights": [
                _flight(seed, *flight) for seed, flight in zip(seeds, flights, strict=True)
            ],
        }
    before, after = (worst[name] for name in CONTROLLERS)
    entry["ratio_of_medians"] = float(np.median(after) / np.median(before))
    entry["made_worse"] = int((after > before).sum())
    return entry


def _flight(seed: int, record: FlightRecord, metrics: Mapping[str, Any]) -> dict[str, Any]:
    heights = np.sort(record.reference[0, :, 2])
    return {
        "seed": seed,
        "gap_m": float(np.diff(heights).mean()),
        "worst_height_error_cm": record.worst_height_error_cm(),
        "strongest_vertical_force_g": float(np.abs(record.vertical_force_g()).max()),
        "metrics": dict(metrics),
    }


def crashed_flights(summary: Mapping[str, Any]) -> int:
    """Number of flights that ended before the clock: their error is not their worst."""
    entries = summary["scenarios"].values()
    return sum(int(entry[name]["crashed"]) for entry in entries for name in CONTROLLERS)


def format_table(summary: Mapping[str, Any]) -> str:
    """The summary as a table for the terminal: medians, quartiles, ratios."""
    head = ("scenario", "without (cm)", "with (cm)", "with / without", "made worse", "crashed")
    rows = [head]
    for team, entry in summary["scenarios"].items():
        sides = [describe_spread(entry[name]["worst_height_error_cm"]) for name in CONTROLLERS]
        worse = f"{entry['made_worse']} of {summary['swaps']}"
        crashed = " / ".join(str(entry[name]["crashed"]) for name in CONTROLLERS)
        rows.append((team, *sides, f"{entry['ratio_of_medians']:.2f}", worse, crashed))
    caption = (
        f"Worst height error of the lowest drone, median (quartiles) of {summary['swaps']} "
        f"swaps, {summary['engine']} engine, {summary['interactions']['name']} forces:"
    )
    return "\n".join([caption, "", *format_columns(rows)])
