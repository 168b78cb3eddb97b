"""`swarm-envs collect`: collect flight logs in simulation."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from swarm_envs.baselines.neural_swarm.flights import format_columns
from swarm_envs.commands.checks import check_inputs, check_outputs
from swarm_envs.files import claimed, write_json
from swarm_envs.training.collection.collect import (
    MANIFEST,
    CollectionConfig,
    collect,
    was_cut_short,
)
from swarm_envs.training.collection.table import (
    SCENARIOS,
    CollectedFlight,
    interaction_rows,
    scenario_counts,
)
from swarm_envs.training.interaction_rows import InteractionRows, save_rows

__all__ = ["CollectOptions", "run_collect"]


@dataclass(frozen=True, kw_only=True)
class CollectOptions:
    """Simulate drones that fly through each other's wakes, and log their flights.

    Every team flies random walks, in which artificial potentials keep the drones apart, and stacked
    swaps, in which drones above one another exchange positions; both aloft and near the ground. The
    command writes one file per flight, `manifest.json`, and `rows.npz` with force labels computed
    from the noisy logs. An interrupted command resumes when it is run again. Fit a force model to
    the flights by `swarm-envs fit --data OUT`.
    """

    out: Path
    """Output folder for the flights, the manifest and the table `rows.npz`."""
    config: CollectionConfig = CollectionConfig()
    """Options of the flights."""
    json: Path | None = None
    """Also write the printed numbers to this file."""
    progress: bool = True
    """Show a progress bar."""


def _summary(
    flights: list[CollectedFlight], rows: InteractionRows, config: CollectionConfig, table: str
) -> dict[str, Any]:
    """Return the numbers of flights and rows: the content of `--json`."""
    scenarios: dict[str, dict[str, Any]] = {}
    for name, count in scenario_counts(flights).items():
        here = np.zeros(len(rows), dtype=np.bool_)
        if name in rows.scenario_names:
            here = rows.scenario == rows.scenario_names.index(name)
        held_out = int(rows.validation[here].sum())
        scenarios[name] = count | {"rows": int(here.sum()), "held_out": held_out}
    return {
        "flights": len(flights),
        "cut_short": [f.name for f in flights if was_cut_short(f, config.duration_s)],
        "seconds": round(sum(flight.seconds for flight in flights), 1),
        "rows": len(rows),
        "table": table,
        "scenarios": scenarios,
        "missing": [n for n in SCENARIOS if not scenarios.get(n, {}).get("rows")],
    }


def _lines(summary: Mapping[str, Any]) -> list[str]:
    lines = [*_scenario_table(summary["scenarios"]), ""]
    if summary["missing"]:
        lines.append(f"no rows of these scenarios of Table II: {', '.join(summary['missing'])}")
    else:
        lines.append("all twelve scenarios of Table II have rows")
    if summary["cut_short"]:
        cut = len(summary["cut_short"])
        lines.append(f"{cut} flight{'' if cut == 1 else 's'} ended early, at a contact")
    flights = f"{summary['flights']} flights, {summary['seconds']:.0f} s"
    return [*lines, f"{flights}, {summary['rows']} rows"]


def _scenario_table(scenarios: Mapping[str, Mapping[str, Any]]) -> list[str]:
    head = ("scenario", "flights", "drone-s", "rows", "held out")
    form = "{flights}|{drone_seconds:.0f}|{rows}|{held_out}"
    rows = [(name, *form.format(**s).split("|")) for name, s in scenarios.items()]
    return format_columns([head, *rows], rule=False)


def run_collect(options: CollectOptions) -> None:
    """Check the options, collect flights, write them, and print a summary."""
    check_outputs(options.out, options.json)
    check_inputs(options.config)
    with claimed(options.out):
        flights = collect(options.config, options.out, options.progress)
        table = options.out / "rows.npz"
        rows = interaction_rows(flights, options.config.label)
        save_rows(table, rows)
        summary = _summary(flights, rows, options.config, table.name)
        print(
            *_lines(summary),
            f"wrote flights, {MANIFEST} and {table.name} into {options.out}",
            sep="\n",
        )
        if options.json is not None:
            write_json(options.json, summary)
