"""Options of `swarm-envs reproduce neural-swarm2`, and what it does with them."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, NamedTuple

from swarm_envs.errors import check_name
from swarm_envs.files import write_json
from swarm_envs.training.reproduce.cells import CELLS
from swarm_envs.training.reproduce.figure import format_summary, reproduce_figure
from swarm_envs.training.reproduce.flight_cases import SWAPS
from swarm_envs.training.reproduce.planning.scenarios import SCENARIOS, TRIALS

CELL_NAMES = tuple(cell.name for cell in CELLS)
"""Every cell of Table III by name."""


@dataclass(frozen=True, kw_only=True)
class ReproduceOptions:
    """Remake a figure or a table of Neural-Swarm2, with the paper's values beside ours.

    `--table 1` identifies both vehicles anew.
    `--figure 5` draws the heat maps, the superposition gaps and larger swarms of any force model,
    with `--bins` its calibration too. `--figure 8` flies stacked swaps with and without
    compensation, `--figure 9` the rings of 5, `--figure 1` those of 16, in environments whose force
    the controllers do not know. `--figure 6` and `--figure 7` plan swaps with and without knowing
    the forces. `--table 3` fits the ablations. `--study` looks at what the
    controller claims, and at where compensation ends. What takes a while goes on where it was when
    it is killed and called again.
    """

    figure: Literal[1, 5, 6, 7, 8, 9] | None = None
    """number of the figure"""
    table: Literal[1, 3] | None = None
    """number of the table"""
    study: Literal["lag", "ball", "limits"] | None = None
    """lag compensation on and off; the ball of Theorem 5; the limits of compensation"""
    out: Path = Path("reproduce")
    """folder for pictures, numbers and runs; made if missing"""
    json: Path | None = None
    """write the numbers to this file too"""
    seed: int = 0
    """table: seed of the first run of each cell; flights: seeds are drawn from it; figure 5: of the
    swarms that `--truth` asks about"""
    truth: str | None = None
    """flights: the force that blows, `learned`, `wake` or a path of weights; both of those with a
    belief of their own if not given. Figure 5: the force that blew where the model was learned: how
    much of it is explained for 2 to 16 drones"""
    belief: Path | None = None
    """flights: weights that the compensating controller believes, such as those of `swarm-envs
    curriculum`; what ships for `--truth` if not given"""
    episodes: int | None = None
    """flights: how many of each case by each controller; 20 if not given"""
    engine: Literal["bullet", "batch"] | None = None
    """flights: who computes them; Bullet where it can be imported, if not given"""
    cases: tuple[str, ...] = SWAPS
    """figure 8: teams, the lowest drone last"""
    radius_m: float = 0.5
    """figure 8: radius of the circle that the drones cross"""
    duration_s: float = 4.0
    """figure 8: time of a crossing"""
    scenarios: tuple[str, ...] = SCENARIOS
    """figure 7: teams that exchange positions"""
    trials: int = TRIALS
    """figure 7: random swaps of each team; figure 6: seeds with which its swap is planned"""
    model: str = "learned"
    """figure 5: `learned`, `wake`, or the path of a weights file"""
    bins: Path | None = None
    """figure 5: CSV of measured force bins to hold the model against"""
    data: Path | None = None
    """table: rows of measured force, a file or a folder, as `swarm-envs fit` reads them"""
    seeds: int = 3
    """table: runs of each cell"""
    cells: tuple[str, ...] = CELL_NAMES
    """table: which cells to fit"""
    steps: int | None = None
    """table: optimiser steps of each fit; the trainer's default if not given"""

    def __post_init__(self) -> None:
        """Refuse what cannot be done.

        Raises:
            ValueError: not exactly one of figure, table and study, an option that has no meaning
                there, a table without data, or a number out of range.
        """
        if sum(asked is not None for asked in (self.figure, self.table, self.study)) != 1:
            raise ValueError(f"give one of {', '.join(f'--{w} {n}' for w, n in WORKS)}")
        foreign = [name for name in _changed(self) if name not in self.work.takes]
        if foreign:
            raise ValueError(
                f"--{foreign[0].replace('_', '-')} has no meaning for {self.name}, but for "
                f"{_homes(foreign[0])}; leave it out"
            )
        if self.table == 3 and self.data is None:
            raise ValueError("--table 3 fits models: give the rows to fit by --data PATH")
        if self.seed < 0:
            raise ValueError(f"--seed is {self.seed}, but must be 0 or more")
        for name in ("seeds", "steps", "episodes", "trials"):
            if getattr(self, name) is not None and getattr(self, name) < 1:
                raise ValueError(f"--{name} is {getattr(self, name)}, but must be 1 or more")
        for cell in self.cells:
            check_name("cell", cell, CELL_NAMES)
        self.work.check(self)

    @property
    def work(self) -> Work:
        """What is remade."""
        return WORKS[self._asked]

    @property
    def needs_torch(self) -> bool:
        """Whether something is trained."""
        return self.work.needs_torch

    @property
    def name(self) -> str:
        """How it is asked for, such as `--figure 5`."""
        return "--{} {}".format(*self._asked)

    @property
    def _asked(self) -> tuple[str, int | str]:
        """The key in `WORKS`."""
        given = {"figure": self.figure, "table": self.table, "study": self.study}
        return next((kind, name) for kind, name in given.items() if name is not None)


def run(options: ReproduceOptions) -> str:
    """Do what the options say, and return what to print."""
    content, text = options.work.run(options)
    if options.json is not None:
        write_json(options.json, content)
    return text


def _figure(options: ReproduceOptions) -> tuple[dict[str, Any], str]:
    summary = reproduce_figure(
        options.out, options.model, options.bins, options.truth, options.seed
    )
    files = [options.out / name for name in ("figure_5.json", *summary["files"].values())]
    return summary, f"{format_summary(summary)}\nwrote {', '.join(map(str, files))}"


def _table(options: ReproduceOptions) -> tuple[dict[str, Any], str]:
    from swarm_envs.training.reproduce.ablation import Budget, format_table, run_ablation

    assert options.data is not None
    seeds = range(options.seed, options.seed + options.seeds)
    cells = [cell for cell in CELLS if cell.name in options.cells]
    table = run_ablation(options.out, Budget(options.data, options.steps), seeds, cells)
    return table, f"{format_table(table)}\n{_wrote(options, 'table_3')}"


def _identified(options: ReproduceOptions) -> tuple[dict[str, Any], str]:
    from swarm_envs.training.reproduce.identification import (
        format_identification,
        reproduce_identification,
    )

    summary = reproduce_identification(options.out, options.seed)
    return summary, f"{format_identification(summary)}\n{_wrote(options, 'table_1')}"


def _flights(options: ReproduceOptions) -> tuple[dict[str, Any], str]:
    from swarm_envs.training.reproduce.flight_report import format_report
    from swarm_envs.training.reproduce.flight_tests import reproduce_flights

    report = reproduce_flights(options.out, _plan(options))
    return report, f"{format_report(report)}\n{_wrote(options, f'figure_{options.figure}')}"


def _study(options: ReproduceOptions) -> tuple[dict[str, Any], str]:
    from swarm_envs.training.reproduce.studies.command import run_study

    assert options.study is not None
    asked = (options.out, options.seed, options.episodes, options.engine)
    summary, text = run_study(options.study, *asked)
    return summary, f"{text}\n{_wrote(options, options.study)}"


def _planned(options: ReproduceOptions) -> tuple[dict[str, Any], str]:
    from swarm_envs.training.reproduce.planning.command import run_figure

    assert options.figure is not None
    asked = (options.out, options.seed, options.truth, options.engine)
    summary, text = run_figure(options.figure, *asked, options.scenarios, options.trials)
    return summary, f"{text}\n{_wrote(options, f'figure_{options.figure}')}"


def _check_planned(options: ReproduceOptions) -> None:
    from swarm_envs.baselines.neural_swarm.agent import load_belief
    from swarm_envs.training.reproduce.planning.scenarios import draw_swap

    load_belief(options.truth or "learned")
    for team in options.scenarios:
        draw_swap(team, options.seed)


def _plan(options: ReproduceOptions) -> Any:
    """The `FlightPlan` of the options; raises ValueError for what cannot be flown."""
    from swarm_envs.tasks.swap import StackedLayout
    from swarm_envs.training.reproduce.flight_tests import FlightPlan

    given: dict[str, Any] = {
        "truths": None if options.truth is None else (options.truth,),
        "episodes": options.episodes,
    }
    radius, duration = options.radius_m, options.duration_s
    return FlightPlan(
        figure=options.figure,  # type: ignore[arg-type]  # `WORKS` names the figures that fly
        belief=options.belief,
        seed=options.seed,
        engine=options.engine,
        cases=options.cases,
        layout=StackedLayout(radius_m=(radius, radius), duration_s=(duration, duration)),
        **{name: value for name, value in given.items() if value is not None},
    )


def _check_plan(options: ReproduceOptions) -> None:
    _plan(options)


def _wrote(options: ReproduceOptions, name: str) -> str:
    files = (options.out / f"{name}.{kind}" for kind in ("json", "csv", "png"))
    return "wrote " + ", ".join(map(str, files))


def _nothing(options: ReproduceOptions) -> None:
    """No further check."""


class Work(NamedTuple):
    """A figure, a table or a study that can be remade."""

    run: Callable[[ReproduceOptions], tuple[dict[str, Any], str]]
    """Gives what JSON holds, and what to print."""
    takes: tuple[str, ...]
    """Options that have a meaning for it, beside those that all have."""
    check: Callable[[ReproduceOptions], None] = _nothing
    """Refuses options that contradict each other."""
    needs_torch: bool = False
    """Whether it trains."""


_FLIGHTS = ("truth", "belief", "episodes", "engine")
_RINGS = Work(_flights, _FLIGHTS, _check_plan)

WORKS: Mapping[tuple[str, int | str], Work] = {
    ("figure", 1): _RINGS,
    ("figure", 5): Work(_figure, ("model", "bins", "truth")),
    ("figure", 6): Work(_planned, ("truth", "engine", "trials"), _check_planned),
    ("figure", 7): Work(_planned, ("truth", "engine", "scenarios", "trials"), _check_planned),
    ("figure", 8): Work(_flights, (*_FLIGHTS, "cases", "radius_m", "duration_s"), _check_plan),
    ("figure", 9): _RINGS,
    ("study", "lag"): Work(_study, ("episodes", "engine")),
    ("study", "ball"): Work(_study, ("episodes",)),
    ("study", "limits"): Work(_study, ("episodes",)),
    ("table", 1): Work(_identified, ()),
    ("table", 3): Work(_table, ("data", "seeds", "cells", "steps"), needs_torch=True),
}
"""Everything that can be remade. To add one, name it here and in `ReproduceOptions`."""

_ALL = ("figure", "table", "study", "out", "json", "seed")


def _changed(options: ReproduceOptions) -> list[str]:
    """Options that were given another value than their default, but for those that all have."""
    return [
        entry.name
        for entry in dataclasses.fields(options)
        if entry.name not in _ALL and getattr(options, entry.name) != entry.default
    ]


def _homes(name: str) -> str:
    """Where an option has a meaning."""
    return " or ".join(f"--{kind} {n}" for (kind, n), work in WORKS.items() if name in work.takes)
