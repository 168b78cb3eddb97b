"""Runs of RTH3D's experiments: an instance drawn, planned, validated and timed; runs together."""

from __future__ import annotations

import functools
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from swarm_envs.baselines.rth3d import GridPlan, PlanNotFound, make_instance, plan
from swarm_envs.training.reproduce.rth3d_settings import GUARANTEED, GridSetting
from swarm_envs.training.reproduce.study import Cell

# Instances whose plans need every kernel, also those for where PIBT has stalled.
_SMALL = (
    GridSetting("uniform", (12, 6, 3)),
    GridSetting("quasi-random", (3, 6, 12)),
    GridSetting("buildings", (12, 6, 3)),
    GridSetting("rings", (12, 12, 6)),
    GridSetting("uniform", (24, 12, 6), 40),
)


def runs_at(setting: GridSetting, most: int, budget: int) -> int:
    """How many runs: all of them where the grid is small, fewer where it is large, at least one.

    Rings are one instance, whatever the seed, and are run once.

    Args:
        setting: what is run.
        most: runs at small sizes.
        budget: vertices of all runs together, from which on there are fewer.
    """
    if setting.family == "rings":
        return 1
    return max(1, min(most, budget // setting.vertices))


@functools.cache
def warm_up() -> None:
    """Compile, or load, every kernel, so that no run is timed with that."""
    for setting in _SMALL:
        for method in ("rth3d", "rth3d-lba", "pibt", "auto"):
            _plan(setting, method, 0)


def _plan(setting: GridSetting, method: str, seed: int) -> tuple[GridPlan | None, float]:
    """The plan, None if there is none, and the CPU time that it took, s."""
    instance = make_instance(setting.family, setting.shape, setting.robots, seed)
    begin = time.process_time()
    try:
        found = plan(
            instance.starts,
            instance.goals,
            instance.shape,
            instance.obstacles,
            method=method,
            seed=seed,
        )
    except PlanNotFound:
        return None, time.process_time() - begin
    return found, time.process_time() - begin


def measure_run(setting: GridSetting, method: str, seed: int) -> Cell:
    """Run once, and return the numbers.

    Args:
        setting: from which the instance is drawn.
        method: of `plan`, whose plans are validated before it returns them.
        seed: of the instance and of PIBT.
    """
    warm_up()
    found, seconds = _plan(setting, method, seed)
    numbers: Cell = {"cpu_s": seconds, "solved": found is not None}
    if found is None:
        return numbers
    balancing = [phase.makespan for phase in found.phases if phase.name.startswith("balance ")]
    return numbers | {
        "robots": len(found.starts),
        "lower_bound": found.lower_bound,
        "makespan": found.makespan,
        "before_compaction": found.before_compaction,
        "bound": found.bound,
        "balancing_steps": sum(balancing),
        "winner": found.winner,
        "valid": found.valid,
    }


FIT_FROM = 5000
"""Vertices from which on a setting counts in a fit: below, calls cost more than work."""
_FEWEST = 3  # settings that a fit needs


@dataclass(frozen=True)
class Spread:
    """Mean, least and largest of the runs of a setting."""

    mean: float
    """Of all runs."""
    least: float
    """Of all runs."""
    most: float
    """Of all runs."""

    @classmethod
    def of(cls, values: Sequence[float]) -> Spread | None:
        """Of values; None if there are none."""
        if not values:
            return None
        return cls(float(np.mean(values)), float(min(values)), float(max(values)))


@dataclass(frozen=True)
class CurvePoint:
    """All runs of a method on a setting."""

    setting: GridSetting
    """What was planned."""
    runs: int
    """How often."""
    solved: int
    """How often with success."""
    robots: int
    """0 if nothing was solved."""
    cpu_s: Spread
    """Of planning and validation, one thread, s; failures counted."""
    ratio: Spread | None
    """Makespan over lower bound; None if nothing was solved."""
    before: Spread | None
    """The same before compaction; None for methods without."""
    constant: int | None
    """Largest excess of the makespan before compaction over m1 + 2 m2 + 2 m3; may be negative."""
    winners: Mapping[str, int]
    """How often the plan was whose."""


Curves = Mapping[tuple[str, str], Sequence[CurvePoint]]
"""Points by the name of the series and the method."""


def gather_runs(setting: GridSetting, method: str, cells: Sequence[Cell]) -> CurvePoint:
    """Put the runs of a method on a setting together."""
    solved = [cell for cell in cells if cell["solved"]]
    before = [cell for cell in solved if method in GUARANTEED]
    excess = [cell["before_compaction"] - setting.length for cell in before]
    winners = [str(cell["winner"]) for cell in solved]
    cpu_s = Spread.of([cell["cpu_s"] for cell in cells])
    assert cpu_s is not None
    return CurvePoint(
        setting=setting,
        runs=len(cells),
        solved=len(solved),
        robots=solved[0]["robots"] if solved else 0,
        cpu_s=cpu_s,
        ratio=Spread.of([cell["makespan"] / cell["lower_bound"] for cell in solved]),
        before=Spread.of([cell["before_compaction"] / cell["lower_bound"] for cell in before]),
        constant=max(excess, default=None),
        winners={name: winners.count(name) for name in sorted(set(winners))},
    )


class _PowerLaw(NamedTuple):
    """y = c x^exponent, fitted."""

    exponent: float  # slope in a picture whose axes are logarithmic
    error: float  # standard error of the exponent
    settings: int  # values that it was fitted to


def fit_power_law(x: npt.ArrayLike, y: npt.ArrayLike) -> _PowerLaw:
    """Fit a straight line to logarithms by least squares.

    Args:
        x: (n,) above 0, at least three, not all the same.
        y: (n,) above 0.
    """
    first, second = (np.asarray(v, dtype=np.float64) for v in (x, y))
    away = np.log(first) - np.log(first).mean()
    height = np.log(second) - np.log(second).mean()
    spread = float(away @ away)
    slope = float(away @ height) / spread
    rest = height - slope * away
    error = np.sqrt(float(rest @ rest) / (len(first) - 2) / spread)
    return _PowerLaw(slope, float(error), len(first))


def growth(points: Sequence[CurvePoint]) -> _PowerLaw | None:
    """How the mean time grows with the vertices, where the grid is no longer small.

    Between settings of one density robots grow as vertices do: the exponent is that of robots too.
    None where fewer than three sizes are large enough.
    """
    large = [point for point in points if point.setting.vertices >= FIT_FROM]
    sizes = [point.setting.vertices for point in large]
    if len(set(sizes)) < _FEWEST:
        return None
    return fit_power_law(sizes, [point.cpu_s.mean for point in large])
