"""The demonstration's numbers: a summary for machines, a table for the terminal."""

from __future__ import annotations

import hashlib
import platform
from collections.abc import Mapping, Sequence
from contextlib import suppress
from importlib import metadata, resources
from pathlib import Path
from typing import Any

import numpy as np

from swarm_envs import __version__
from swarm_envs.baselines.neural_swarm.demo.flights import CONTROLLERS, HORIZON_S, LAYOUT, Flight
from swarm_envs.interactions import InteractionModel, load
from swarm_envs.state import FloatArray
from swarm_envs.viewing.record import FlightRecord

_PACKAGES = ("numpy", "numba", "pybullet", "gymnasium", "pettingzoo")


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
            "radius_m": LAYOUT.radius_m[0],
            "duration_s": LAYOUT.duration_s[0],
            "gap_m": list(LAYOUT.gap_m),
            "horizon_s": HORIZON_S,
        },
        "interactions": _weights(load("learned")),
        "belief": _weights(belief),
        "versions": _versions(),
        "scenarios": {team: _scenario(sides, seeds) for team, sides in flown.items()},
    }


def _scenario(sides: Mapping[str, list[Flight]], seeds: Sequence[int]) -> dict[str, Any]:
    entry: dict[str, Any] = {}
    worst = {}
    for name, flights in sides.items():
        worst[name] = np.array([record.worst_height_error_cm() for record, _ in flights])
        entry[name] = {
            "crashed": sum(metrics["length_s"] < HORIZON_S - 1e-6 for _, metrics in flights),
            "worst_height_error_cm": _statistics(worst[name]),
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


def _statistics(values: FloatArray) -> dict[str, float]:
    low, median, high = np.quantile(values, [0.25, 0.5, 0.75]).tolist()
    return {"median": median, "lower_quartile": low, "upper_quartile": high}


def _weights(model: InteractionModel) -> dict[str, str]:
    """Name of a model and the hash of its weights file, without the place of that file."""
    file = Path(model.name)
    if not file.is_file():  # one that ships, by its name
        shipped = resources.files("swarm_envs.interactions").joinpath("weights")
        with resources.as_file(shipped.joinpath(f"{model.name}.safetensors")) as path:
            return {"name": model.name, "sha256": hashlib.sha256(path.read_bytes()).hexdigest()}
    return {"name": file.name, "sha256": hashlib.sha256(file.read_bytes()).hexdigest()}


def _versions() -> dict[str, str]:
    found = {"swarm_envs": __version__, "python": platform.python_version()}
    for package in _PACKAGES:
        with suppress(metadata.PackageNotFoundError):
            found[package] = metadata.version(package)
    return found


def crashed_flights(summary: Mapping[str, Any]) -> int:
    """Number of flights that ended before the clock: their error is not their worst."""
    entries = summary["scenarios"].values()
    return sum(int(entry[name]["crashed"]) for entry in entries for name in CONTROLLERS)


def format_table(summary: Mapping[str, Any]) -> str:
    """The summary as a table for the terminal: medians, quartiles, ratios."""
    head = ("scenario", "without (cm)", "with (cm)", "with / without", "made worse", "crashed")
    rows = [head]
    for team, entry in summary["scenarios"].items():
        sides = [_spread(entry[name]["worst_height_error_cm"]) for name in CONTROLLERS]
        worse = f"{entry['made_worse']} of {summary['swaps']}"
        crashed = " / ".join(str(entry[name]["crashed"]) for name in CONTROLLERS)
        rows.append((team, *sides, f"{entry['ratio_of_medians']:.2f}", worse, crashed))
    widths = [max(len(row[i]) for row in rows) for i in range(len(head))]
    lines = [
        "  ".join([row[0].ljust(widths[0]), *(c.rjust(w) for c, w in zip(row[1:], widths[1:]))])
        for row in rows
    ]
    lines.insert(1, "  ".join("-" * width for width in widths))
    caption = (
        f"Worst height error of the lowest drone, median (quartiles) of {summary['swaps']} "
        f"swaps, {summary['engine']} engine, {summary['interactions']['name']} forces:"
    )
    return "\n".join([caption, "", *lines])


def _spread(statistics: Mapping[str, float]) -> str:
    median, low, high = (statistics[k] for k in ("median", "lower_quartile", "upper_quartile"))
    return f"{median:.1f} ({low:.1f} - {high:.1f})"
