"""Where compensation ends: how its gain falls as belief, sensors, motors or density get worse.

Every point is stacked swaps flown by the baseline and by the compensating controller, which share
swaps, gains and sensors. In the sweeps of imperfections the belief is the environment's own model,
an oracle, spoiled in one way: what is lost is lost to that. In the others the belief that ships
flies together with the oracle.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from swarm_envs.agents.evaluation import frozen_seeds
from swarm_envs.baselines.neural_swarm.agent import load_belief
from swarm_envs.baselines.neural_swarm.flights import (
    PAPER_SWAP,
    FlightTest,
    format_columns,
    quartiles,
    swap_test,
)
from swarm_envs.control.config import ControllerConfig
from swarm_envs.envs.randomization import Randomization
from swarm_envs.interactions import InteractionModel, load
from swarm_envs.training.reproduce.charts import label_axis
from swarm_envs.training.reproduce.imperfect_flights import NOTHING, Imperfection, fly_imperfectly
from swarm_envs.training.reproduce.study import Cell, Cells, Report, Study, error_cell
from swarm_envs.vehicles import GRAVITY, SMALL, parse_team
from swarm_envs.viewing.style import GREY, picture

if TYPE_CHECKING:
    from matplotlib.axes import Axes

TRUTH = "learned"  # The environment's force model
_BELIEFS: Mapping[str, Callable[[], InteractionModel | None]] = {
    "none": lambda: None,
    "exact": lambda: load(TRUTH),
    "shipped": lambda: load_belief(TRUTH),
}
"""Force models of controllers: none (the baseline), the environment's (an oracle), or what was
learned from flights in it."""


class _SweepPoint(NamedTuple):
    cell: str  # its name; points of one name are the same flights
    case: str  # what flies, for people
    value: float  # what the sweep varies, in its unit
    belief: str  # one of `_BELIEFS`
    test: FlightTest  # team, swaps, air
    imperfection: Imperfection = NOTHING  # what is spoiled


@dataclass(frozen=True)
class Sweep:
    """One thing that is varied."""

    name: str  # In tables and files
    label: str  # Of the axis, with the unit
    points: Sequence[_SweepPoint]  # What is flown, one after another


_CASES = ("S2S", "L2S")


_IMPERFECTIONS: Mapping[str, tuple[str, str, float, tuple[float, ...]]] = {
    "scale": (
        *("Predicted over true force", "scale", 1.0),
        (0.25, 0.5, 0.75, 0.9, 1.0, 1.1, 1.25, 1.5, 2.0, 2.5),
    ),
    "noise": (
        *("Noise of the belief below 5 Hz, rms (g)", "noise_g", 1.0),
        (0.0, 0.5, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0),
    ),
    "delay": (
        *("Delay of the belief (ms)", "delay_s", 1e-3),
        (0.0, 10.0, 20.0, 40.0, 80.0, 160.0, 320.0, 640.0),
    ),
    "velocity noise": (
        *("White noise of velocities (cm/s)", "velocity_noise", 1e-2),
        (0.0, 0.5, 1.0, 1.5, 2.0, 3.0, 5.0),
    ),
    "position noise": (
        *("White noise of positions (mm)", "position_noise_m", 1e-3),
        (0.0, 3.0, 10.0, 15.0, 20.0, 30.0),
    ),
}
"""By sweep: label of the axis, field of `Imperfection`, unit of the values in SI, values."""


def _spoiled(name: str) -> Sweep:
    """A sweep of one imperfection of an exact belief; what sensors spoil, the baseline suffers."""
    label, field, unit, values = _IMPERFECTIONS[name]
    points, sensed = [], name in ("velocity noise", "position noise")
    for case in _CASES:
        test = swap_test(case, truth=TRUTH)
        for x in values:
            cell, spoiled = f"{name} {x:g}: {case}", Imperfection(**{field: unit * x})
            alone = cell if sensed else f"unspoiled: {case}"
            sensors = spoiled if sensed else NOTHING
            points.append(_SweepPoint(f"{alone}, none", case, x, "none", test, sensors))
            points.append(_SweepPoint(f"{cell}, exact", case, x, "exact", test, spoiled))
    return Sweep(name, label, points)


def _flown(name: str, label: str, cases: Mapping[str, Mapping[float, FlightTest]]) -> Sweep:
    """A sweep of what is flown, by the baseline and both beliefs."""
    points = [
        _SweepPoint(f"{name} {x:g}: {case}, {belief}", case, x, belief, test)
        for case, tests in cases.items()
        for x, test in tests.items()
        for belief in _BELIEFS
    ]
    return Sweep(name, label, points)


def _thrust(case: str) -> dict[float, FlightTest]:
    """The lowest drone, a small one, at other thrust-to-weight ratios."""
    lowest = {
        ratio: replace(SMALL, max_thrust=ratio * SMALL.mass * GRAVITY)
        for ratio in (1.2, 1.3, 1.4, 1.5, 1.7, 1.91, 2.6)
    }
    team = parse_team(case)[:-1]
    return {ratio: swap_test((*team, one), truth=TRUTH) for ratio, one in lowest.items()}


def _air(case: str) -> dict[float, FlightTest]:
    test, strengths = swap_test(case, truth=TRUTH), (0.1, 0.25, 0.5, 0.75, 1.0, 1.25, 1.5)
    return {x: replace(test, randomization=Randomization(force_scale=(x, x))) for x in strengths}


def all_sweeps() -> tuple[Sweep, ...]:
    """Every sweep of the study."""
    weak = {case: _thrust(case) for case in ("L2S", "LL2S")}
    many = {
        f"{one} above S": {float(n): swap_test(one * n + "2S", truth=TRUTH) for n in range(1, 6)}
        for one in "SL"
    }
    gaps = {x: replace(PAPER_SWAP, gap_m=(x, x)) for x in (0.2, 0.3, 0.4, 0.6, 0.8, 1.0)}
    planes = {case: {x: swap_test(case, gaps[x], TRUTH) for x in gaps} for case in _CASES}
    return (
        *map(_spoiled, _IMPERFECTIONS),
        _flown("air", "True over predicted force", {case: _air(case) for case in _CASES}),
        _flown("thrust", "Thrust over weight of the lowest drone", weak),
        _flown("neighbours", "Drones above the lowest", many),
        _flown("plane distance", "Distance between planes (m)", planes),
    )


_EPISODES = 20


def _settings(options: Any) -> dict[str, Any]:
    episodes = options.episodes or _EPISODES
    return {"seed": options.seed, "episodes": episodes, "truth": TRUTH, "engine": "batch"}


def _grid(options: Any) -> Cells:
    """Every point of every sweep; points of the same name are the same flights."""
    seeds = frozen_seeds(options.seed, options.episodes or _EPISODES)
    points = [p for sweep in all_sweeps() for p in sweep.points]
    return {p.cell: partial(_measure, p, seeds) for p in points}


def _measure(point: _SweepPoint, seeds: Sequence[int]) -> Cell:
    """Worst height error of the lowest drone in each flight, cm; default gains."""
    controller = ControllerConfig(feedforward=_BELIEFS[point.belief]())
    flown = fly_imperfectly(point.test, controller, seeds, point.imperfection)
    return error_cell(flown.height_error[:, -1], flown.crashed)


def _report(options: Any, cells: Mapping[str, Cell]) -> Report:
    sweeps = all_sweeps()
    rows = [row for sweep in sweeps for row in sweep_rows(sweep, cells)]
    hurts = [hurt for sweep in sweeps for hurt in harmful_values(sweep, rows)]
    summary = {**_settings(options), "rows": rows, "hurts": hurts}
    draw = partial(_plot, sweeps=sweeps, rows=rows)
    return Report(summary, _text(summary), rows, {"limits.png": draw})


def sweep_rows(sweep: Sweep, cells: Mapping[str, Cell]) -> list[dict[str, Any]]:
    """One row for each point with a belief, with the baseline's numbers."""
    alone = {(p.case, p.value): cells[p.cell] for p in sweep.points if p.belief == "none"}
    return [
        {"sweep": sweep.name, **_row(point, cells[point.cell], alone[point.case, point.value])}
        for point in sweep.points
        if point.belief != "none"
    ]


def _row(point: _SweepPoint, flown: Cell, baseline: Cell) -> dict[str, Any]:
    with_it, without = np.array(flown["worst_cm"]), np.array(baseline["worst_cm"])
    mine, theirs = quartiles(with_it), quartiles(without)
    return {
        "case": point.case,
        "belief": point.belief,
        "value": point.value,
        "without_cm": round(theirs["median"], 3),
        "compensated_cm": round(mine["median"], 3),
        "lower_quartile_cm": round(mine["lower_quartile"], 3),
        "upper_quartile_cm": round(mine["upper_quartile"], 3),
        "ratio": round(mine["median"] / theirs["median"], 4),
        "made_worse": int((with_it > without).sum()),
        "episodes": len(with_it),
        "crashed_without": baseline["crashed"],
        "crashed": flown["crashed"],
    }


def harmful_values(sweep: Sweep, rows: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Where the compensated median becomes the larger one, interpolated linearly in the ratio."""
    found = []
    own = [row for row in rows if row["sweep"] == sweep.name]
    for case, belief in dict.fromkeys((row["case"], row["belief"]) for row in own):
        line = [row for row in own if (row["case"], row["belief"]) == (case, belief)]
        for a, b in pairwise(line):
            if (a["ratio"] > 1.0) != (b["ratio"] > 1.0):
                share = (1.0 - a["ratio"]) / (b["ratio"] - a["ratio"])
                value = a["value"] + share * (b["value"] - a["value"])
                side = "above" if b["ratio"] > 1.0 else "below"
                found.append(
                    {"sweep": sweep.name, "case": case, "belief": belief, "side": side,
                     "value": round(value, 3)}
                )  # fmt: skip
    return found


def _text(summary: Mapping[str, Any]) -> str:
    """Every point, and where compensation hurts."""
    head = ("sweep", "case", "belief", "value", "without", "compensated", "ratio", "worse")
    lines: list[tuple[str, ...]] = [(*head, "crashed")]
    for r in summary["rows"]:
        errors = (f"{r['without_cm']:.2f}", f"{r['compensated_cm']:.2f}", f"{r['ratio']:.2f}")
        crashed = f"{r['crashed_without']} / {r['crashed']}"
        where = (r["sweep"], r["case"], r["belief"], f"{r['value']:g}")
        lines.append((*where, *errors, str(r["made_worse"]), crashed))
    hurts = [
        f"  {h['sweep']} {h['side']} {h['value']:g} ({h['case']}, belief {h['belief']})"
        for h in summary["hurts"]
    ]
    crashes = [
        f"compensation crashes {r['crashed']} of {r['episodes']}, the baseline "
        f"{r['crashed_without']}: {r['sweep']} {r['value']:g} ({r['case']}, belief {r['belief']})"
        for r in summary["rows"]
        if r["crashed"] > r["crashed_without"]
    ]
    return "\n".join(
        [
            f"Worst height error of the lowest drone, median of {summary['episodes']} swaps (cm)",
            *format_columns(lines),
            "compensation makes the median worse:",
            *(hurts or ["  nowhere"]),
            *crashes,
        ]
    )


_COLORS = ("#0072B2", "#D55E00")
_LINES = {"exact": ("-", "o"), "shipped": (":", "s")}
_HARM = "#C0202A"
_STRETCHED = ("delay",)  # sweeps whose values spread over orders of magnitude


def _plot(path: Path, sweeps: Sequence[Sweep], rows: Sequence[Mapping[str, Any]]) -> None:
    """One panel a sweep; where compensation hurts, points are red."""
    columns = min(3, len(sweeps))
    lines = -(-len(sweeps) // columns)
    headline = "Limits of compensation: worst height error of the lowest drone (cm)"
    with picture(path, 4.5 * columns, 3.1 * lines + 0.9, headline) as figure:
        axes = figure.subplots(lines, columns, squeeze=False).ravel()
        for axis, sweep in zip(axes, sweeps):
            _panel(axis, sweep, [row for row in rows if row["sweep"] == sweep.name])
        for axis in axes[len(sweeps) :]:
            axis.set_axis_off()
        figure.supxlabel(
            "Medians. Dashed: without compensation. Solid: belief exact but for what is varied; "
            "dotted: the belief that ships. Red ring: compensation made the median worse; "
            "red cross: it made drones crash.",
            fontsize=9,
        )


def _panel(axis: Axes, sweep: Sweep, rows: Sequence[Mapping[str, Any]]) -> None:
    cases = list(dict.fromkeys(row["case"] for row in rows))
    for color, case in zip(_COLORS, cases, strict=False):
        for belief, (dashes, marker) in _LINES.items():
            own = [row for row in rows if (row["case"], row["belief"]) == (case, belief)]
            if not own:
                continue
            x = [row["value"] for row in own]
            label = case if belief == "exact" else None
            axis.plot(x, [row["compensated_cm"] for row in own], dashes, color=color,
                      marker=marker, markersize=3.5, label=label)  # fmt: skip
            harm = {
                "o": [row for row in own if row["ratio"] > 1.0],
                "x": [row for row in own if row["crashed"] > row["crashed_without"]],
            }
            for sign, bad in harm.items():  # the median made worse; drones made to crash
                points = [row["value"] for row in bad], [row["compensated_cm"] for row in bad]
                look: Any = {"markersize": 10, "markerfacecolor": "none", "markeredgewidth": 1.6}
                axis.plot(*points, sign, color=_HARM, **look)
            if belief == "exact":
                axis.plot(x, [row["without_cm"] for row in own], "--", color=color)
    axis.set_yscale("log")
    axis.set_ylim(0.02, 120.0)
    axis.set_yticks([0.1, 1.0, 10.0, 100.0], ["0.1", "1", "10", "100"])
    if sweep.name in _STRETCHED:
        axis.set_xscale("symlog", linthresh=10.0, linscale=0.5)
        axis.set_xlim(-0.5, 750.0)
        shown = (0, 10, 40, 160, 640)
        axis.set_xticks(shown, [str(value) for value in shown])
        axis.minorticks_off()
    label_axis(axis, legend=8, xlabel=sweep.label)
    axis.tick_params(axis="y", colors=GREY)


LIMITS = Study(
    paper="neural-swarm2",
    name="study-limits",
    label="Limits",
    shows="how the gain of compensation falls as belief, sensors, motors or density get worse",
    takes=("episodes",),
    grid=_grid,
    settings=_settings,
    report=_report,
)
"""Every point of every sweep."""
