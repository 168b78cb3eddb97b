"""Options and summary of `swarm-envs collect`; also `python -m` of this package."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
import tyro

from swarm_envs.files import write_json
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
    """Fly drones through each other's wakes in the environment and log them.

    Every team walks at random, kept apart by artificial potentials, and swaps places in a stack;
    both aloft and near the ground. Writes one file a flight, `manifest.json`, and `rows.npz`, whose
    labels are computed from the noisy logs. Killed and called again, it goes on where it was.
    `swarm-envs fit --data OUT` fits a force model to the flights.
    """

    out: Path
    """folder for the flights, the manifest and the table `rows.npz`"""
    config: CollectionConfig = CollectionConfig()
    """what to fly"""
    json: Path | None = None
    """write the numbers that are printed to this file too"""
    progress: bool = True
    """show a progress bar"""


@dataclass(frozen=True)
class ScenarioSummary:
    """What a scenario gave."""

    flights: int
    """Flights in which the scenario occurs."""
    drone_seconds: float
    """Time of its drones."""
    near_seconds: float
    """Of it, with a neighbour in the interaction volume; of lone drones all."""
    rows: int
    """Rows of it."""
    held_out: int
    """Rows of flights that are for validation."""
    rms_force_g: float
    """Of the vertical labels, noise included."""


@dataclass(frozen=True)
class CollectSummary:
    """What a collection gave; the content of `--json`."""

    flights: int
    """Flights that were logged."""
    cut_short: list[str]
    """Flights that ended before their time, at a contact."""
    seconds: float
    """Their length together, s."""
    rows: int
    """Rows of measured force."""
    table: str
    """Name of the file of rows."""
    scenarios: dict[str, ScenarioSummary]
    """What there is of each scenario."""
    missing: list[str]
    """Scenarios of Table II that have no row."""

    def lines(self) -> list[str]:
        """What the command prints of it."""
        said = [scenario_table(self.scenarios), ""]
        if self.missing:
            said.append(f"of Table II no row of {', '.join(self.missing)}")
        else:
            said.append("all twelve scenarios of Table II have rows")
        if self.cut_short:
            cut = len(self.cut_short)
            said.append(f"{cut} flight{' was' if cut == 1 else 's were'} cut at a contact")
        said.append(f"{self.flights} flights, {self.seconds:.0f} s, {self.rows} rows")
        return said


def _summary(
    flights: list[CollectedFlight], rows: InteractionRows, config: CollectionConfig, table: str
) -> CollectSummary:
    """Count what was flown and what rows it gave."""
    scenarios = {}
    for name, count in scenario_counts(flights).items():
        here = np.zeros(len(rows), dtype=np.bool_)
        if name in rows.scenario_names:
            here = rows.scenario == rows.scenario_names.index(name)
        labels = rows.force_g[here, 2]
        scenarios[name] = ScenarioSummary(
            **count._asdict(),
            rows=len(labels),
            held_out=int(rows.validation[here].sum()),
            rms_force_g=round(float(np.sqrt(np.mean(labels**2))), 3) if len(labels) else 0.0,
        )
    found = {name for name, entry in scenarios.items() if entry.rows}
    return CollectSummary(
        flights=len(flights),
        cut_short=[flight.name for flight in flights if was_cut_short(flight, config.duration_s)],
        seconds=round(sum(flight.seconds for flight in flights), 1),
        rows=len(rows),
        table=table,
        scenarios=scenarios,
        missing=[name for name in SCENARIOS if name not in found],
    )


def scenario_table(scenarios: Mapping[str, ScenarioSummary]) -> str:
    """The scenarios as a table."""
    head = ("scenario", "flights", "drone-s", "near, s", "rows", "held out", "rms, g")
    body = [
        (
            name,
            str(s.flights),
            f"{s.drone_seconds:.0f}",
            f"{s.near_seconds:.0f}",
            str(s.rows),
            str(s.held_out),
            f"{s.rms_force_g:.2f}",
        )
        for name, s in scenarios.items()
    ]
    widths = [max(len(line[k]) for line in (head, *body)) for k in range(len(head))]
    return "\n".join(
        "  ".join([line[0].ljust(widths[0]), *map(str.rjust, line[1:], widths[1:])])
        for line in (head, *body)
    )


def run_collect(options: CollectOptions) -> CollectSummary:
    """Collect, and say what was collected."""
    flights = collect(options.config, options.out, options.progress)
    table = options.out / "rows.npz"
    rows = interaction_rows(flights, options.config.label)
    save_rows(table, rows)
    summary = _summary(flights, rows, options.config, table.name)
    print(
        *summary.lines(), f"wrote flights, {MANIFEST} and {table.name} into {options.out}", sep="\n"
    )
    if options.json is not None:
        write_json(options.json, asdict(summary))
    return summary


if __name__ == "__main__":
    run_collect(tyro.cli(CollectOptions, config=(tyro.conf.OmitArgPrefixes,)))
