"""Formations: the places of N drones on a shape, no two nearer than a spacing that counts heights.

Downwash reaches far down, so that heights are divided by a factor before distances are taken
(`scaling`, as in Hoenig et al. 2018 and in MLR-DMPC): two drones are apart if they lie outside of
an ellipsoid that is higher than wide.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from scipy.spatial import cKDTree

from swarm_envs.arguments import POSITIVE_M, Count, Range, typed
from swarm_envs.shows.outlines import Outline, outline
from swarm_envs.state import FloatArray, IntArray
from swarm_envs.tasks.shapes import plane

__all__ = ["Room", "formations_of"]

_SWEEPS = 12
_ROUNDING = 1e-9
_CLEAR = 1.003  # so that checks with rounding find the spacing
GROUND = 0.3  # Height of the formation at the beginning and at the end, m
PALETTE = ("#ff3b30:#ffcc00", "#00c6ff:#7a5cff", "#ff2d78:#ff8fb1", "#34e08a:#00a3ff", "#ffd36b")
"""Colours of formations unless others are given; `a:b` is a gradient from the bottom to the top."""


@typed
@dataclass(frozen=True)
class Room:
    """How drones are spaced, and how large formations may be."""

    spacing: Annotated[float, POSITIVE_M] = 0.35
    """Scaled distance that reference paths keep at any time, m."""
    height_factor: Annotated[float, Range(1.0, 10.0)] = 2.0
    """Heights are divided by it: drones keep so many times more below each other than aside."""
    lean_deg: Annotated[float, Range(0.0, 90.0, unit="degrees")] = 30.0
    """By how much flat shapes lean back from the vertical."""
    floor: Annotated[float, POSITIVE_M] = 1.8
    """Lowest place of a formation, m."""
    largest: Annotated[float, POSITIVE_M] = 60.0
    """Largest width, depth or height of a formation, m."""

    @property
    def scaling(self) -> FloatArray:
        """(3,) by which distances are divided."""
        return np.array([1.0, 1.0, self.height_factor])

    @property
    def apart(self) -> float:
        """Scaled distance of places, m: straight ways to them keep the `spacing` (CAPT)."""
        return _CLEAR * math.sqrt(2.0) * self.spacing


@dataclass(frozen=True, eq=False)
class Formation:
    """Where N drones stand, and what they show."""

    name: str  # The shape
    places: FloatArray  # (N, 3) m
    colors: FloatArray  # (N, 3) red, green and blue in [0, 1]


@typed
def formation_of(name: str, drones: Count, colors: str | None, room: Room) -> Formation:
    """The formation of a shape: places spread evenly over it, no larger than the spacing asks for.

    Args:
        name: of the shape, a word, a letter or a file; see `swarm_envs.shows.outlines`.
        drones: N.
        colors: a colour of matplotlib, a gradient `a:b`, `rainbow`, or None for the shape's own.
        room: how drones are spaced.

    Raises:
        ValueError: no such shape or colour, too few points, or more room than there is.
        OSError: there is no such file.
    """
    shape = outline(name, drones, room.height_factor)
    points = _leaning(shape.points, room.lean_deg) if shape.flat else shape.points
    chosen = _chosen(name, shape, points, drones, room)
    places = points[chosen] * _enlargement(name, points[chosen], room)
    places = places - (places.min(axis=0) + places.max(axis=0)) / 2
    _check_size(name, places, room)
    places[:, 2] += room.floor - places[:, 2].min()
    own = None if shape.colors is None else shape.colors[chosen]
    return Formation(name, places, own if colors is None and own is not None else
                     painted(colors or PALETTE[0], places))  # fmt: skip


def ground(drones: int, room: Room) -> Formation:
    """Where the drones begin and land: a level grid of dim white lights."""
    places = plane(drones, room.apart) + np.array([0.0, 0.0, GROUND])
    return Formation("ground", places, np.full((drones, 3), 0.25))


def _leaning(points: FloatArray, degrees: float) -> FloatArray:
    angle = math.radians(degrees)
    tilt = np.array([[1, 0, 0], [0, 1, 0], [0, math.sin(angle), math.cos(angle)]])
    return np.asarray(points @ tilt)


def _chosen(name: str, shape: Outline, points: FloatArray, drones: int, room: Room) -> IntArray:
    """(N,) the points that become places."""
    if len(points) < drones:
        raise ValueError(
            f"shape {name!r} has {len(points)} points, but there are {drones} drones; use at most "
            f"{len(points)} drones, or more points"
        )
    if shape.fixed and len(points) == drones:
        return np.arange(drones)
    return _evened(points / room.scaling, drones)


def _evened(points: FloatArray, count: int) -> IntArray:
    """(N,) points far from each other: farthest first, then Lloyd's method as long as it helps."""
    chosen = np.zeros(count, dtype=np.int64)
    distance = np.linalg.norm(points - points[0], axis=1)
    for k in range(1, count):
        chosen[k] = np.argmax(distance)
        distance = np.minimum(distance, np.linalg.norm(points - points[chosen[k]], axis=1))
    best, least = chosen, _nearest(points[chosen])
    for _ in range(_SWEEPS):
        owner = cKDTree(points[chosen]).query(points)[1]
        size = np.bincount(owner, minlength=count)
        sums = [np.bincount(owner, points[:, k], minlength=count) for k in range(3)]
        chosen = cKDTree(points).query(np.stack(sums, axis=1) / size[:, None])[1]
        if len(np.unique(chosen)) < count:
            break
        if _nearest(points[chosen]) > least:
            best, least = chosen, _nearest(points[chosen])
    return best


def _nearest(points: FloatArray) -> float:
    """Smallest distance between two points; infinite if there is only one."""
    if len(points) < 2:
        return math.inf
    return float(cKDTree(points).query(points, k=2)[0][:, 1].min())


def _enlargement(name: str, points: FloatArray, room: Room) -> float:
    """What points are multiplied by so that the nearest two are as far apart as places must be."""
    least = _nearest(points / room.scaling)
    if least <= _ROUNDING * max(float(np.ptp(points)), 1e-300):
        raise ValueError(f"shape {name!r} has two points in one place; remove one of them")
    return 1.0 if math.isinf(least) else room.apart / least


def _check_size(name: str, places: FloatArray, room: Room) -> None:
    size = float(np.ptp(places, axis=0).max())
    if size > room.largest:
        fits = math.floor(1000 * room.spacing * room.largest / size) / 1000
        raise ValueError(
            f"shape {name!r} of {len(places)} drones with a spacing of {room.spacing} m is "
            f"{size:.1f} m large, but may be {room.largest} m; use fewer drones, a spacing of at "
            f"most {fits} m, or --largest {math.ceil(size)}"
        )


def painted(colors: str, places: FloatArray) -> FloatArray:
    """Colours (N, 3) of places: one colour, a gradient `a:b` by height, or `rainbow` by width.

    Raises:
        ValueError: matplotlib knows no such colour.
    """
    from matplotlib.colors import hsv_to_rgb, to_rgb

    axis = 0 if colors == "rainbow" else 2
    share = (places[:, axis] - places[:, axis].min()) / max(float(np.ptp(places[:, axis])), 1e-9)
    if colors == "rainbow":
        return np.asarray(hsv_to_rgb(np.column_stack([0.85 * share, *np.full((2, len(share)), 1)])))
    try:
        ends = np.array([to_rgb(word) for word in colors.split(":")])
    except ValueError as error:
        rule = "must be a colour such as gold or #ff8800, a gradient such as red:gold, or rainbow"
        raise ValueError(f"colour {colors!r} is unknown; it {rule}") from error
    at = np.linspace(0.0, 1.0, len(ends)) if len(ends) > 1 else np.zeros(1)
    return np.column_stack([np.interp(share, at, ends[:, k]) for k in range(3)])


def formations_of(
    shapes: Sequence[str], drones: int, colors: Sequence[str] | None, room: Room
) -> list[Formation]:
    """The ground, each shape, and the ground again; colours are repeated where there are fewer.

    Raises:
        ValueError: as `formation_of` does.
        OSError: there is no such file.
    """
    own = [name.endswith((".svg", ".csv", ".npy")) and not colors for name in shapes]
    given = colors or PALETTE
    found = [
        formation_of(name, drones, None if own[k] else given[k % len(given)], room)
        for k, name in enumerate(shapes)
    ]
    end = ground(drones, room)
    return [end, *found, end]
