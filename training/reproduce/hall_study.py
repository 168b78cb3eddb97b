"""Which part of the hall costs how much: two motions of the paper, one part after the other.

A small drone passes below a large one (L2S, Neural-Swarm2, Sec. VII-E), and five drones fly the
rings of Fig. 9, without and with a belief, and with a controller that adapts (docs/adaptation.md),
in the ideal world, in each part of `swarm_envs.hall.Hall` alone, in the whole hall, and in one
whose rotors are wrong by 5 %. The rings are flown without any force between drones as well.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np

from swarm_envs.agents.evaluation import bootstrap_interval, frozen_seeds
from swarm_envs.baselines.neural_swarm.agent import load_belief
from swarm_envs.baselines.neural_swarm.flights import (
    FlightTest,
    default_engine,
    fly,
    format_columns,
    swap_test,
)
from swarm_envs.control.config import ControllerConfig, Indi
from swarm_envs.hall import Hall
from swarm_envs.interactions import load
from swarm_envs.tasks.ring import RingTask, ring_team
from swarm_envs.training.reproduce.charts import draw_numbered_bars, label_axis
from swarm_envs.training.reproduce.study import Cell, Cells, Report, Study, error_cell
from swarm_envs.viewing.style import picture

TEAM, RING = "L2S", "ring of 5"
"""What is flown; errors are those of the small drone, and of the worst of each flight."""
_EPISODES = 40
_WHOLE = Hall()
_PARTS = {
    "random force": ("residual_quiet", "residual_wake", "residual_alone"),
    "offset of the force": ("offset",),
    "thrust curve": ("thrust_error",),
    "state estimate": (
        *("frame_delay_s", "frame_loss", "position_noise_m", "attitude_noise_rad"),
        *("accelerometer_noise", "gyro_noise"),
    ),
}
"""Numbers of each part of the hall; where all are zero, nothing is otherwise than in the ideal."""


def _without(*parts: str) -> Hall:
    names = [name for part in parts for name in _PARTS[part]]
    zero: Any = {
        name: 0.0 if isinstance(getattr(_WHOLE, name), float) else (0.0, 0.0) for name in names
    }
    return replace(_WHOLE, **zero)


def hall_worlds() -> dict[str, str | Hall]:
    """The worlds that are flown in, by name."""
    alone = {part: _without(*(other for other in _PARTS if other != part)) for part in _PARTS}
    wrong = replace(_WHOLE, thrust_error=0.05)
    return {"ideal": "ideal", **alone, "hall": "hall", "hall, thrust wrong by 5 %": wrong}


@dataclass(frozen=True)
class _Side:
    believes: bool
    adapts: bool
    exact: bool = False

    @property
    def name(self) -> str:
        """Also part of its cells' names."""
        has = {"belief": self.believes, "INDI": self.adapts, "exact force": self.exact}
        words = [word for word, there in has.items() if there]
        return " + ".join(words) or "neither"

    def controller(self, truth: str) -> ControllerConfig:
        """The configuration of the tracking loop, in an environment with these forces."""
        belief = load_belief(truth) if self.believes else load(truth) if self.exact else None
        return ControllerConfig(feedforward=belief, adaptation=Indi() if self.adapts else None)


_SIDES = tuple(_Side(believes, adapts) for adapts in (False, True) for believes in (False, True))
_RING_SIDES = (*_SIDES, _Side(False, False, exact=True))  # whose belief is not what is missing


def _settings(options: Any) -> dict[str, Any]:
    return {
        "motions": [TEAM, RING],
        "seed": options.seed,
        "episodes": options.episodes or _EPISODES,
        "engine": options.engine or default_engine(),
        "hall": repr(_WHOLE),
    }


def _rows(options: Any) -> Iterator[tuple[str, str, str, _Side]]:
    """Motion, force model, world and controller of every cell."""
    rings = (*options.truths, "none")
    for motion, truth in [*((TEAM, t) for t in options.truths), *((RING, t) for t in rings)]:
        for world in hall_worlds():
            for side in _SIDES if motion == TEAM else _RING_SIDES:
                if truth != "none" or not (side.believes or side.exact):
                    yield motion, truth, world, side


def _grid(options: Any) -> Cells:
    """The same flights in every world by every controller."""
    seeds = frozen_seeds(options.seed, options.episodes or _EPISODES)
    engine, worlds = options.engine or default_engine(), hall_worlds()
    return {
        f"{motion}, {truth}, {world}, {side.name}": partial(
            _measure, motion, truth, worlds[world], side.controller, seeds, engine
        )
        for motion, truth, world, side in _rows(options)
    }


def _measure(
    motion: str,
    truth: str,
    world: str | Hall,
    controller: Callable[[str], ControllerConfig],
    seeds: Sequence[int],
    engine: str,
) -> Cell:
    """Fly: worst height errors of the drone that counts, and how many flights ended early."""
    rings = motion == RING
    plain = swap_test(TEAM, truth=truth, engine=engine)
    if rings:
        plain = FlightTest(RingTask(ring_team(5)), truth, engine)
    flights = fly(replace(plain, world=world), controller(truth), seeds)
    worst = flights.worst_height_error
    return error_cell(worst.max(axis=1) if rings else worst[:, -1], flights.crashed)


def _report(options: Any, cells: Mapping[str, Cell]) -> Report:
    rows = []
    for motion, truth, world, side in _rows(options):
        cell = cells[f"{motion}, {truth}, {world}, {side.name}"]
        worst = np.array(cell["worst_cm"])
        errors = (float(np.median(worst)), *bootstrap_interval(worst, np.median))
        names = ("median_cm", "low_cm", "high_cm")
        rows.append(
            {"motion": motion, "truth": truth, "world": world, "controller": side.name}
            | {name: round(value, 3) for name, value in zip(names, errors, strict=True)}
            | {"crashed": cell["crashed"]}
        )
    summary = {**_settings(options), "rows": rows}
    return Report(summary, _text(summary), rows, {"hall.png": partial(_plot, rows=rows)})


def _text(summary: Mapping[str, Any]) -> str:
    lines: list[tuple[str, ...]] = [("motion", "forces", "world", *(s.name for s in _RING_SIDES))]
    for place, rows in groupby(
        summary["rows"], lambda row: (row["motion"], row["truth"], row["world"])
    ):
        said = {row["controller"]: _said(row) for row in rows}
        lines.append((*place, *(said.get(side.name, "-") for side in _RING_SIDES)))
    head = (
        f"Worst height error, of {TEAM} that of the small drone, median of {summary['episodes']} "
        "flights [95 % interval], cm; by what the controller has"
    )
    return "\n".join([head, *format_columns(lines)])


def _said(row: Mapping[str, Any]) -> str:
    crashed = f", {row['crashed']} crashed" if row["crashed"] else ""
    return f"{row['median_cm']:.2f} [{row['low_cm']:.2f}, {row['high_cm']:.2f}]{crashed}"


_COLORS = ("#D55E00", "#0072B2", "#E69F00", "#56B4E9")


def _plot(path: Path, rows: Sequence[Mapping[str, Any]]) -> None:
    """Medians of the swap by world, a panel for each force model."""
    rows = [row for row in rows if row["motion"] == TEAM]
    truths = list(dict.fromkeys(row["truth"] for row in rows))
    headline = "A small drone passes under a large one: what each part of the hall costs"
    with picture(path, 11.0, 4.4 * len(truths), headline) as figure:
        panels = figure.subplots(len(truths), 1, squeeze=False)[:, 0]
        for axis, truth in zip(panels, truths, strict=True):
            own = [row for row in rows if row["truth"] == truth]
            series = [
                ([r["median_cm"] for r in own if r["controller"] == side.name], color, side.name)
                for side, color in zip(_SIDES, _COLORS, strict=True)
            ]
            names = [w.replace(", ", ",\n") for w in dict.fromkeys(row["world"] for row in own)]
            draw_numbered_bars(axis, names, series)
            axis.set_ylim(0.1, 100.0)
            axis.legend(fontsize=9, ncols=len(_SIDES), loc="upper center")
            title = "Worst height error, median (cm)"
            label_axis(axis, f"Forces: {truth}", "", title, grid="y")


HALL = Study(
    paper="neural-swarm2",
    name="study-hall",
    label="Hall",
    shows="height errors in each part of the hall, with and without belief and adaptation",
    takes=("truth", "episodes", "engine"),
    grid=_grid,
    settings=_settings,
    report=_report,
)
"""Which part of the hall costs how much."""
