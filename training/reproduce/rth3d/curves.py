"""Runs of a setting together, and the power law by which their time grows."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from swarm_envs.training.reproduce.rth3d.experiments import GUARANTEED, Figure, Setting
from swarm_envs.training.reproduce.runs import Cell

FIT_FROM = 5000
"""Vertices from which on a setting counts in a fit: below, calls cost more than work."""
_FEWEST = 3
"""Settings that a fit needs."""


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
class Point:
    """All runs of a method on a setting."""

    setting: Setting
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


Curves = Mapping[tuple[str, str], Sequence[Point]]
"""Points by the name of the series and the method."""


def gather(setting: Setting, method: str, cells: Sequence[Cell]) -> Point:
    """Put the runs of a method on a setting together."""
    solved = [cell for cell in cells if cell["solved"]]
    before = [cell for cell in solved if method in GUARANTEED]
    excess = [cell["before_compaction"] - setting.length for cell in before]
    winners = [str(cell["winner"]) for cell in solved]
    cpu_s = Spread.of([cell["cpu_s"] for cell in cells])
    assert cpu_s is not None
    return Point(
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


@dataclass(frozen=True)
class PowerLaw:
    """y = c x^exponent, fitted."""

    exponent: float
    """Slope in a picture whose axes are logarithmic."""
    error: float
    """Standard error of the exponent."""
    settings: int
    """Values that it was fitted to."""


def fit_power_law(x: npt.ArrayLike, y: npt.ArrayLike) -> PowerLaw:
    """Fit a straight line to logarithms by least squares.

    Args:
        x: (n,) above 0, at least three, not all the same.
        y: (n,) above 0.

    Raises:
        ValueError: values to which no line with an error can be fitted.
    """
    first, second = (np.asarray(v, dtype=np.float64) for v in (x, y))
    if first.shape != second.shape or first.ndim != 1 or len(first) < _FEWEST:
        raise ValueError(
            f"x and y have shapes {first.shape} and {second.shape}, but must be as many values, "
            f"at least {_FEWEST}"
        )
    if min(first.min(), second.min()) <= 0 or np.ptp(first) == 0:
        raise ValueError("x and y must be above 0, and x not the same everywhere")
    away = np.log(first) - np.log(first).mean()
    height = np.log(second) - np.log(second).mean()
    spread = float(away @ away)
    slope = float(away @ height) / spread
    rest = height - slope * away
    error = np.sqrt(float(rest @ rest) / (len(first) - 2) / spread)
    return PowerLaw(slope, float(error), len(first))


def growth(points: Sequence[Point]) -> PowerLaw | None:
    """How the mean time grows with the vertices, where the grid is no longer small.

    Between settings of one density robots grow as vertices do: the exponent is that of robots too.
    None where fewer than three sizes are large enough.
    """
    large = [point for point in points if point.setting.vertices >= FIT_FROM]
    sizes = [point.setting.vertices for point in large]
    if len(set(sizes)) < _FEWEST:
        return None
    return fit_power_law(sizes, [point.cpu_s.mean for point in large])


def curves(
    figure: Figure, methods: Sequence[str], found: Mapping[Setting, Mapping[str, Sequence[Cell]]]
) -> Curves:
    """Every curve of a figure.

    Args:
        figure: what was run.
        methods: by which.
        found: runs by setting and method.
    """
    return {
        (name, method): [gather(setting, method, found[setting][method]) for setting in settings]
        for name, settings in figure.series.items()
        for method in methods
    }
