"""What Fig. 5 to 9 vary, and what the paper and others report there."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

from swarm_envs.baselines.rth3d.grid import Shape

GUARANTEED = ("rth3d", "rth3d-lba")
"""Methods that always succeed, and whose plans are compacted."""


@dataclass(frozen=True)
class GridSetting:
    """A family of instances on one grid: a point of a curve."""

    family: str
    """Of `FAMILIES`."""
    shape: Shape
    """Vertices by axis."""
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


class RatioTarget(NamedTuple):
    """A number that a curve should reach."""

    series: str
    """The curve that should reach it."""
    method: str
    """The method of that curve."""
    most: float
    """Mean ratio of makespan to lower bound, at most."""
    settings: tuple[GridSetting, ...]
    """Where."""
    compacted: bool = True
    """Or before compaction, as the paper's."""
    of_paper: bool = False
    """Whether the paper reports the number; otherwise it is what we set ourselves."""


class Peer(NamedTuple):
    """A public implementation, measured once on instances of the same kind, on one core."""

    name: str
    """Of the implementation."""
    robots: int
    """Robots that it planned for."""
    seconds: float
    """Of wall time; the limit if there was no answer."""
    ratio: float | None
    """None if there was no answer in that time."""


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

    headline: str
    """Above the picture."""
    axis: str
    """What grows along x: "robots", "density" or "m" (the height)."""
    series: Mapping[str, tuple[GridSetting, ...]]
    """Curves by their name, each from its smallest to its largest setting."""
    paper: Mapping[str, float] = field(default_factory=dict)
    """Ratio that the paper's text gives for the largest sizes, by method."""
    limit: float | None = None
    """Ratio that the theory approaches on random instances (Cor. IV.1, IV.2)."""
    order: float | None = None
    """The theory's exponent of the run time in the number of vertices."""
    targets: tuple[RatioTarget, ...] = ()
    """Numbers that its curves should reach."""
    peers: tuple[Peer, ...] = ()
    """What others reach."""


_Series = Mapping[str, tuple[GridSetting, ...]]  # curves by name


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


def _largest(series: _Series, method: str, most: float) -> Iterable[RatioTarget]:
    """The same target for each curve's largest setting."""
    return (RatioTarget(name, method, most, settings[-1:]) for name, settings in series.items())


def _paper_says(series: _Series, most: Mapping[str, float]) -> Iterable[RatioTarget]:
    """What the paper's text says of the largest uniform setting, by method."""
    where = series["uniform"][-1:]
    return (
        RatioTarget("uniform", method, ratio, where, compacted=False, of_paper=True)
        for method, ratio in most.items()
    )


FIGURES: dict[str, CurveFigure] = {
    "5": CurveFigure(
        "Fig. 5: 4:2:1 grids, a third of the vertices taken",
        "robots",
        _RANDOM,
        paper={"rth3d": 1.7, "rth3d-lba": 1.5},
        limit=1 + 3 / 7,
        order=5 / 3,
        targets=(
            *_paper_says(_RANDOM, {"rth3d": 1.7, "rth3d-lba": 1.5}),
            *_largest(_RANDOM, "rth3d-lba", 1.30),
            *_largest(_RANDOM, "auto", 1.05),
        ),
        peers=_PEERS,
    ),
    "6": CurveFigure(
        "Fig. 6: square grids six vertices high, a third of them taken",
        "robots",
        _FLATS,
        paper={"rth3d": 1.5, "rth3d-lba": 1.5},
        limit=1.5,
        order=2.0,
        targets=(*_paper_says(_FLATS, {"rth3d": 1.5, "rth3d-lba": 1.5}),),
    ),
    "7": CurveFigure(
        "Fig. 7: 4:2:1 grids between tall buildings, density 2/9",
        "robots",
        _BUILDINGS,
        limit=1 + 3 / 7,
        order=5 / 3,
        targets=(*_largest(_BUILDINGS, "rth3d-lba", 1.30), *_largest(_BUILDINGS, "auto", 1.10)),
    ),
    "8": CurveFigure(
        "Fig. 8: 120 x 60 x 6, from a few robots to a third of the vertices",
        "density",
        {"uniform": _DENSITY},
        targets=(RatioTarget("uniform", "auto", 1.02, _DENSITY[:4]),),
    ),
    "9": CurveFigure(
        "Fig. 9: rings and blocks",
        "m",
        _PATTERNS,
        targets=(
            RatioTarget(_RINGS, "rth3d-lba", 1.15, _PATTERNS[_RINGS][3:4]),
            *(
                RatioTarget(name, "auto", 1.10, _PATTERNS[name])
                for name in ("27 blocks, m x m x m", "3 x 3 x 3 blocks, 2m x 2m x m")
            ),
        ),
    ),
}
"""Every figure by its number. Orders: matchings of all heights, O(m3 m1^2 m2^2) (Sec. IV)."""
