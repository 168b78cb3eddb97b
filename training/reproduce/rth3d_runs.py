"""What Fig. 5 to 9 of RTH3D vary, and their runs: drawn, planned, timed and put together."""

from __future__ import annotations

import functools
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from swarm_envs.baselines.rth3d import GridPlan, PlanNotFound, make_instance, plan
from swarm_envs.baselines.rth3d.grid import Shape
from swarm_envs.training.reproduce.study import Cell

PUBLISHED = ("rth3d", "rth3d-lba-paper")  # Methods with the matchings of the paper
GUARANTEED = (*PUBLISHED, "rth3d-lba")  # Methods that always succeed, and whose plans are compacted


@dataclass(frozen=True)
class GridSetting:
    """A family of instances on one grid: a point of a curve."""

    family: str  # Of `FAMILIES`
    shape: Shape  # Vertices by axis
    robots: int | None = None
    """None where the family says how many, a third of the vertices or 2/9 between buildings."""

    @property
    def vertices(self) -> int:
        """Of the grid."""
        return self.shape[0] * self.shape[1] * self.shape[2]

    @property
    def length(self) -> int:
        """m1 + 2 m2 + 2 m3, m1 the longest: the theory's makespan but for a constant."""
        return 2 * sum(self.shape) - max(self.shape)

    @property
    def grid(self) -> str:
        """Such as 12x6x3."""
        return "x".join(map(str, self.shape))

    @property
    def name(self) -> str:
        """Such as `uniform 12x6x3`, with the number of robots where it was chosen."""
        return f"{self.family} {self.grid}" + (f" {self.robots}" if self.robots else "")


class Peer(NamedTuple):
    """A public implementation, measured once on instances of the same kind, on one core."""

    name: str  # Of the implementation
    robots: int  # Robots that it planned for
    seconds: float  # Of wall time; the limit if there was no answer
    ratio: float | None  # None if there was no answer in that time


# On uniform instances of Fig. 5, C++; LaCAM3 by its first solution. They are not shipped.
_PEERS = (
    Peer("ECBS, w = 1.5", 576, 0.6, 1.09),
    Peer("ECBS, w = 1.5", 1944, 60.0, None),
    Peer("LaCAM3", 9000, 4.8, 1.02),
    Peer("LaCAM3", 36864, 57.0, 1.00),
    Peer("LaCAM3", 72000, 181.0, 1.00),
    Peer("LaCAM3", 124416, 300.0, None),
)


@dataclass(frozen=True)
class CurveFigure:
    """A figure of the paper."""

    headline: str  # Above the picture
    axis: str  # What grows along x: "robots", "density" or "m" (the height)
    series: Mapping[str, tuple[GridSetting, ...]]
    """Curves by their name, each from its smallest to its largest setting."""
    paper: Mapping[str, float] = field(default_factory=dict)
    """Ratio that the paper's text gives for the largest sizes, by method."""
    limit: float | None = None
    """Ratio that the theory approaches on random instances (Cor. IV.1, IV.2)."""
    order: float | None = None  # The theory's exponent of the run time in the number of vertices
    peers: tuple[Peer, ...] = ()  # What others reach


def _curve(family: str, *shapes: Shape) -> tuple[GridSetting, ...]:
    return tuple(GridSetting(family, shape) for shape in shapes)


def slabs(family: str) -> tuple[GridSetting, ...]:
    """4:2:1, 3 to 36 high, as in Fig. 5 and 7."""
    return _curve(family, *((4 * m, 2 * m, m) for m in range(3, 37, 3)))


def _cubes(family: str, *heights: int) -> tuple[GridSetting, ...]:
    """Cubic grids, as the paper says of Fig. 9."""
    return _curve(family, *((m, m, m) for m in heights))


def _wide(family: str) -> tuple[GridSetting, ...]:
    """Grids of 2m x 2m x m, as the authors' scripts have it for Fig. 9."""
    return _curve(family, *((2 * m, 2 * m, m) for m in (6, 12, 18, 24, 30, 36)))


_RANDOM = {family: slabs(family) for family in ("uniform", "quasi-random")}
_BUILDINGS = {family: slabs(family) for family in ("buildings", "quasi-buildings")}
_SIDES = (6, 12, 24, 36, 48, 60, 90, 120, 150, 180, 210, 240, 270)
_FLATS = {family: _curve(family, *((m, m, 6) for m in _SIDES)) for family in _RANDOM}
# Fig. 8: robots on one grid, to a third of its vertices. The authors' scripts begin at 4,800.
_DENSITIES = (144, 720, 2400, 4800, 7200, 9600, 12000, 14400)
_DENSITY = tuple(GridSetting("uniform", (120, 60, 6), robots) for robots in _DENSITIES)
_RINGS = "rings, 2m x 2m x m"
_PATTERNS = {
    "rings, m x m x m": _cubes("rings", 6, 12, 18, 24, 36, 48),
    _RINGS: _wide("rings"),
    "27 blocks, m x m x m": _cubes("blocks", 9, 18, 27, 36, 45, 54),
    "3 x 3 x 3 blocks, 2m x 2m x m": _wide("small-blocks"),
}


FIGURES: dict[str, CurveFigure] = {
    "5": CurveFigure(
        "Fig. 5: 4:2:1 grids, a third of the vertices taken",
        "robots",
        _RANDOM,
        paper={"rth3d": 1.7, "rth3d-lba-paper": 1.5},
        limit=1 + 3 / 7,
        order=5 / 3,
        peers=_PEERS,
    ),
    "6": CurveFigure(
        "Fig. 6: square grids six vertices high, a third of them taken",
        "robots",
        _FLATS,
        paper={"rth3d": 1.5, "rth3d-lba-paper": 1.5},
        limit=1.5,
        order=2.0,
    ),
    "7": CurveFigure(
        "Fig. 7: 4:2:1 grids between tall buildings, density 2/9",
        "robots",
        _BUILDINGS,
        limit=1 + 3 / 7,
        order=5 / 3,
    ),
    "8": CurveFigure(
        "Fig. 8: 120 x 60 x 6, from a few robots to a third of the vertices",
        "density",
        {"uniform": _DENSITY},
    ),
    "9": CurveFigure(
        "Fig. 9: rings and blocks",
        "m",
        _PATTERNS,
    ),
}
"""Every figure by its number. Orders: matchings of all heights, O(m3 m1^2 m2^2) (Sec. IV)."""


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
    small = make_instance("uniform", (6, 6, 3), 12)
    for method in (*GUARANTEED, "auto"):
        plan(small.starts, small.goals, small.shape, method=method, time_limit=60.0)


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

    mean: float  # Of all runs
    least: float  # Of all runs
    most: float  # Of all runs

    @classmethod
    def of(cls, values: Sequence[float]) -> Spread | None:
        """Of values; None if there are none."""
        if not values:
            return None
        return cls(float(np.mean(values)), float(min(values)), float(max(values)))


@dataclass(frozen=True)
class CurvePoint:
    """All runs of a method on a setting."""

    setting: GridSetting  # What was planned
    runs: int  # How often
    solved: int  # How often with success
    robots: int  # 0 if nothing was solved
    cpu_s: Spread  # Of planning and validation, one thread, s; failures counted
    ratio: Spread | None  # Makespan over lower bound; None if nothing was solved
    before: Spread | None  # The same before compaction; None for methods without
    constant: int | None
    """Largest excess of the makespan before compaction over m1 + 2 m2 + 2 m3; may be negative."""
    winners: Mapping[str, int]  # How often the plan was whose


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


def growth(points: Sequence[CurvePoint]) -> _PowerLaw | None:
    """How the mean time grows with the vertices, where the grid is no longer small.

    A straight line is fitted to logarithms. Between settings of one density robots grow as
    vertices do: the exponent is that of robots too. None where fewer than three sizes are large
    enough.
    """
    from scipy.stats import linregress

    large = [point for point in points if point.setting.vertices >= FIT_FROM]
    sizes = [point.setting.vertices for point in large]
    if len(set(sizes)) < _FEWEST:
        return None
    line = linregress(np.log(sizes), np.log([point.cpu_s.mean for point in large]))
    return _PowerLaw(float(line.slope), float(line.stderr), len(sizes))
