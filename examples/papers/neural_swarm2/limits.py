"""Limits of compensation, by errors of the prediction, sensors, motors, and by density.

Every point has stacked swaps without and with compensation, with equal swaps, gains and sensors. In
the sweeps of imperfections the predicted force is that of the environment's own model (an oracle)
with one error. In the others both the oracle and the included model are simulated.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from tqdm import tqdm

from examples.papers.common import markdown, write_csv, write_json
from examples.papers.neural_swarm2.imperfect_flights import NOTHING, Imperfection, fly_imperfectly
from swarm_envs.agents.evaluation import frozen_seeds
from swarm_envs.baselines.neural_swarm import load_belief
from swarm_envs.baselines.neural_swarm.flights import (
    PAPER_SWAP,
    FlightTest,
    quartiles,
    swap_test,
)
from swarm_envs.control.config import ControllerConfig
from swarm_envs.envs.randomization import Randomization
from swarm_envs.interactions import InteractionModel, load
from swarm_envs.state import FloatArray
from swarm_envs.vehicles import GRAVITY, SMALL, parse_team
from swarm_envs.viewing.style import GREY, picture

if TYPE_CHECKING:
    from matplotlib.axes import Axes

TRUTH = "learned"  # The environment's force model
BELIEFS: Mapping[str, Callable[[], InteractionModel | None]] = {
    "none": lambda: None,
    "exact": lambda: load(TRUTH),
    "shipped": lambda: load_belief(TRUTH),
}
"""Force models of controllers: none (the baseline), the environment's (an oracle), or the one that
was fitted to flights in it."""


class SweepPoint(NamedTuple):
    """Flights of a sweep with one value, by one controller."""

    cell: str  # points of the same name are the same flights
    case: str  # such as "L2S"
    value: float  # what the sweep varies, in its unit
    belief: str  # one of `BELIEFS`
    test: FlightTest
    imperfection: Imperfection = NOTHING


@dataclass(frozen=True)
class Sweep:
    """Flights in which one thing is varied."""

    name: str  # in tables and files
    label: str  # of the axis, with the unit
    points: Sequence[SweepPoint]


CASES = ("S2S", "L2S")

IMPERFECTIONS: Mapping[str, tuple[str, str, float, tuple[float, ...]]] = {
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


def _imperfect(name: str) -> Sweep:
    """Return a sweep of one imperfection of an exact model; sensors affect the baseline too."""
    label, field, unit, values = IMPERFECTIONS[name]
    points, sensed = [], name in ("velocity noise", "position noise")
    for case in CASES:
        test = swap_test(case, truth=TRUTH)
        for x in values:
            cell, spoiled = f"{name} {x:g}: {case}", Imperfection(**{field: unit * x})
            alone = cell if sensed else f"unspoiled: {case}"
            sensors = spoiled if sensed else NOTHING
            points.append(SweepPoint(f"{alone}, none", case, x, "none", test, sensors))
            points.append(SweepPoint(f"{cell}, exact", case, x, "exact", test, spoiled))
    return Sweep(name, label, points)


def _flown(name: str, label: str, cases: Mapping[str, Mapping[float, FlightTest]]) -> Sweep:
    """Return a sweep of what is flown, by the baseline and both force models."""
    points = [
        SweepPoint(f"{name} {x:g}: {case}, {belief}", case, x, belief, test)
        for case, tests in cases.items()
        for x, test in tests.items()
        for belief in BELIEFS
    ]
    return Sweep(name, label, points)


def _thrust(case: str) -> dict[float, FlightTest]:
    """Return tests of the lowest drone, a small one, at other thrust-to-weight ratios."""
    lowest = {
        ratio: replace(SMALL, max_thrust=ratio * SMALL.mass * GRAVITY)
        for ratio in (1.2, 1.3, 1.4, 1.5, 1.7, 1.91, 2.6)
    }
    team = parse_team(case)[:-1]
    return {ratio: swap_test((*team, one), truth=TRUTH) for ratio, one in lowest.items()}


def _air(case: str) -> dict[float, FlightTest]:
    """Return tests in which the true force is scaled."""
    test, strengths = swap_test(case, truth=TRUTH), (0.1, 0.25, 0.5, 0.75, 1.0, 1.25, 1.5)
    return {x: replace(test, randomization=Randomization(force_scale=(x, x))) for x in strengths}


def all_sweeps() -> tuple[Sweep, ...]:
    """Return every sweep."""
    weak = {case: _thrust(case) for case in ("L2S", "LL2S")}
    many = {
        f"{one} above S": {float(n): swap_test(one * n + "2S", truth=TRUTH) for n in range(1, 6)}
        for one in "SL"
    }
    gaps = {x: replace(PAPER_SWAP, gap_m=(x, x)) for x in (0.2, 0.3, 0.4, 0.6, 0.8, 1.0)}
    planes = {case: {x: swap_test(case, gaps[x], TRUTH) for x in gaps} for case in CASES}
    return (
        *map(_imperfect, IMPERFECTIONS),
        _flown("air", "True over predicted force", {case: _air(case) for case in CASES}),
        _flown("thrust", "Thrust over weight of the lowest drone", weak),
        _flown("neighbours", "Drones above the lowest", many),
        _flown("plane distance", "Distance between planes (m)", planes),
    )


def limits(out: Path = Path("neural_swarm2"), episodes: int = 20, seed: int = 0) -> None:
    """Fly swaps with ever worse prediction, sensors, motors or density (docs/limits.md).

    Takes a quarter of an hour. Writes `limits.json` (`rows`: every point with and without
    compensation; `hurts`: from which value on compensation makes the median worse), `limits.csv`
    (the rows) and `limits.png`.

    Args:
        out: folder, made if missing.
        episodes: swaps of each point.
        seed: seeds of the flights are drawn from it.
    """
    sweeps, seeds = all_sweeps(), frozen_seeds(seed, episodes)
    points = {point.cell: point for sweep in sweeps for point in sweep.points}
    cells = {name: measure(p, seeds) for name, p in tqdm(points.items(), "limits", unit="point")}
    rows = [row for sweep in sweeps for row in sweep_rows(sweep, cells)]
    hurts = [hurt for sweep in sweeps for hurt in harmful_values(sweep, rows)]
    summary = {"seed": seed, "episodes": episodes, "truth": TRUTH, "engine": "batch"}
    summary |= {"rows": rows, "hurts": hurts}
    write_json(out / "limits.json", summary)
    write_csv(out / "limits.csv", rows)
    plot_limits(out / "limits.png", sweeps, rows)
    print(f"Worst height error of the lowest drone, median of {episodes} swaps")
    print(markdown(rows, list(rows[0])))
    print("Compensation makes the median worse:")
    print(markdown(hurts, ("sweep", "case", "belief", "side", "value")))


class Flown(NamedTuple):
    """Results of the flights of a point."""

    worst_cm: FloatArray  # (E,) worst height error of the lowest drone
    crashed: int  # how many flights crashed


def measure(point: SweepPoint, seeds: Sequence[int]) -> Flown:
    """Fly a point with the default gains."""
    controller = ControllerConfig(feedforward=BELIEFS[point.belief]())
    flown = fly_imperfectly(point.test, controller, seeds, point.imperfection)
    worst = np.round(100.0 * flown.height_error[:, -1], 4)
    return Flown(worst, int(flown.crashed.sum()))


def sweep_rows(sweep: Sweep, cells: Mapping[str, Flown]) -> list[dict[str, Any]]:
    """Return a row for each point with a force model, with the baseline's numbers."""
    alone = {(p.case, p.value): cells[p.cell] for p in sweep.points if p.belief == "none"}
    return [
        {"sweep": sweep.name, **_row(point, cells[point.cell], alone[point.case, point.value])}
        for point in sweep.points
        if point.belief != "none"
    ]


def _row(point: SweepPoint, flown: Flown, baseline: Flown) -> dict[str, Any]:
    mine, theirs = quartiles(flown.worst_cm), quartiles(baseline.worst_cm)
    return {
        "case": point.case,
        "belief": point.belief,
        "value": point.value,
        "without_cm": round(theirs["median"], 3),
        "compensated_cm": round(mine["median"], 3),
        "lower_quartile_cm": round(mine["lower_quartile"], 3),
        "upper_quartile_cm": round(mine["upper_quartile"], 3),
        "ratio": round(mine["median"] / theirs["median"], 4),
        "made_worse": int((flown.worst_cm > baseline.worst_cm).sum()),
        "episodes": len(flown.worst_cm),
        "crashed_without": baseline.crashed,
        "crashed": flown.crashed,
    }


def harmful_values(sweep: Sweep, rows: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Return where the compensated median becomes the larger one, interpolated in the ratio."""
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


COLORS = ("#0072B2", "#D55E00")
LINES = {"exact": ("-", "o"), "shipped": (":", "s")}
HARM_COLOR = "#C0202A"
STRETCHED = ("delay",)  # sweeps whose values spread over orders of magnitude


def plot_limits(path: Path, sweeps: Sequence[Sweep], rows: Sequence[Mapping[str, Any]]) -> None:
    """Draw a panel for each sweep; where compensation hurts, points are red."""
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
            "Medians. Dashed: without compensation. Solid: exact prediction with what is varied; "
            "dotted: the fitted model that ships. Red ring: compensation made the median worse; "
            "red cross: it made drones crash.",
            fontsize=9,
        )


def _panel(axis: Axes, sweep: Sweep, rows: Sequence[Mapping[str, Any]]) -> None:
    cases = list(dict.fromkeys(row["case"] for row in rows))
    for color, case in zip(COLORS, cases, strict=False):
        for belief in LINES:
            own = [row for row in rows if (row["case"], row["belief"]) == (case, belief)]
            if own:
                _draw_line(axis, own, color)
    axis.set_yscale("log")
    axis.set_ylim(0.02, 120.0)
    axis.set_yticks([0.1, 1.0, 10.0, 100.0], ["0.1", "1", "10", "100"])
    if sweep.name in STRETCHED:
        axis.set_xscale("symlog", linthresh=10.0, linscale=0.5)
        axis.set_xlim(-0.5, 750.0)
        shown = (0, 10, 40, 160, 640)
        axis.set_xticks(shown, [str(value) for value in shown])
        axis.minorticks_off()
    axis.set_xlabel(sweep.label)
    axis.grid(True)
    axis.legend(fontsize=8)
    axis.tick_params(axis="y", colors=GREY)


def _draw_line(axis: Axes, own: Sequence[Mapping[str, Any]], color: str) -> None:
    """Draw the errors with one force model, red where it made the median worse or drones crash."""
    x, (dashes, marker) = [row["value"] for row in own], LINES[own[0]["belief"]]
    exact = own[0]["belief"] == "exact"
    look: Any = {"color": color, "marker": marker, "markersize": 3.5}
    label = own[0]["case"] if exact else None
    axis.plot(x, [row["compensated_cm"] for row in own], dashes, label=label, **look)
    harm = {
        "o": [row for row in own if row["ratio"] > 1.0],
        "x": [row for row in own if row["crashed"] > row["crashed_without"]],
    }
    for sign, bad in harm.items():
        points = [row["value"] for row in bad], [row["compensated_cm"] for row in bad]
        look = {"markersize": 10, "markerfacecolor": "none", "markeredgewidth": 1.6}
        axis.plot(*points, sign, color=HARM_COLOR, **look)
    if exact:
        axis.plot(x, [row["without_cm"] for row in own], "--", color=color)
