"""Formations: the places of N drones on a shape, no two nearer than a spacing that counts heights.

Downwash reaches far down, so that heights are divided by a factor before distances are taken
(`scaling`, as in Hoenig et al. 2018 and in MLR-DMPC): two drones are apart if they lie outside of
an ellipsoid that is higher than wide.

Places are chosen among many points, perhaps with colours: the outline of a shape. A shape is a
name, `text:WORD`, `letter:A`, or a file: a drawing (.svg) or a point cloud (.csv, .npy). Flat
shapes lie in the plane of x and z and face the audience, which looks along y.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from swarm_envs.arguments import POSITIVE_M, Count, Range, typed
from swarm_envs.errors import check_name
from swarm_envs.shows.drawing import read_drawing
from swarm_envs.state import FloatArray, IntArray
from swarm_envs.tasks.shapes import CHARACTERS, LETTER, SHAPES, THIN_UP_TO, plane, strokes

__all__ = ["Room", "formations_of", "spelled"]

TEXT, WORDS = "text:", "letters:"
"""What names of a word in one formation, and of one letter after another, begin with."""
_GRID = 150
_MANY = 12_000
_PEN, _ADVANCE = (0.2, 0.45), 6.4
_LATTICES = tuple(name for name in SHAPES if name != "sphere")


class Outline(NamedTuple):
    """Points among which places are chosen."""

    points: FloatArray  # (M, 3), of any scale
    colors: FloatArray | None = None
    """(M, 3) red, green and blue, each in [0, 1], where the shape has its own."""
    fixed: bool = False  # Whether the points are the places, all of them and in this order
    flat: bool = False  # Whether they lie in the plane of x and z


def _upright(flat: FloatArray) -> FloatArray:
    """Points (M, 2) of a picture in the plane of x and z (M, 3)."""
    return np.column_stack([flat[:, 0], np.zeros(len(flat)), flat[:, 1]])


def _filled(edge: FloatArray) -> FloatArray:
    """Points (M, 2) of a fine grid inside a polygon (K, 2)."""
    from matplotlib.path import Path as Polygon

    low, high = edge.min(axis=0), edge.max(axis=0)
    axes = [np.linspace(low[k], high[k], _GRID) for k in range(2)]
    grid = np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, 2)
    return np.asarray(grid[Polygon(edge).contains_points(grid)])


def heart() -> FloatArray:
    """A filled heart: points (M, 3)."""
    t = np.linspace(0.0, 2 * np.pi, 400)
    y = 13 * np.cos(t) - 5 * np.cos(2 * t) - 2 * np.cos(3 * t) - np.cos(4 * t)
    return _upright(_filled(np.column_stack([16 * np.sin(t) ** 3, y])))


def star() -> FloatArray:
    """A filled star with five points: (M, 3)."""
    angle = np.pi / 2 + np.arange(10) * np.pi / 5
    reach = np.where(np.arange(10) % 2, 0.42, 1.0)
    return _upright(_filled(np.column_stack([reach * np.cos(angle), reach * np.sin(angle)])))


def ball() -> FloatArray:
    """The surface of a sphere: points (M, 3)."""
    k = np.arange(_MANY) + 0.5
    height, turn = 1.0 - 2.0 * k / _MANY, math.pi * (3.0 - math.sqrt(5.0)) * k
    out = np.sqrt(1.0 - height**2)
    return np.stack([out * np.cos(turn), out * np.sin(turn), height], axis=-1)


def helix() -> FloatArray:
    """Two ribbons that wind about one upright axis: points (M, 3)."""
    t, across = np.meshgrid(np.linspace(0.0, 1.0, _MANY // 20), np.linspace(0.0, 0.25, 10))
    turn = [2.5 * np.pi * t.ravel() + phase for phase in (0.0, np.pi)]
    height = (3.0 * t + across).ravel()
    return np.concatenate([np.column_stack([np.cos(a), np.sin(a), height]) for a in turn])


def wave() -> FloatArray:
    """A level disk with a ripple: points (M, 3)."""
    k = np.arange(_MANY) + 0.5
    out, turn = np.sqrt(k / _MANY), math.pi * (3.0 - math.sqrt(5.0)) * k
    height = 0.2 * np.cos(3 * np.pi * out)
    return np.column_stack([out * np.cos(turn), out * np.sin(turn), height])


_SURFACES: dict[str, tuple[Callable[[], FloatArray], bool]] = {
    "heart": (heart, True),
    "star": (star, True),
    "sphere": (ball, False),
    "helix": (helix, False),
    "wave": (wave, False),
}
"""Shapes that are spread over points, and whether they are flat."""
NAMES = (*_SURFACES, *_LATTICES)  # Shapes by name; letters, words and files apart


def written_word(word: str, drones: int) -> FloatArray:
    """Points (M, 3) of the strokes of a word, broad for many drones; a space leaves a gap.

    Raises:
        ValueError: a character is not in the font.
    """
    pen = _PEN[drones > 2 * THIN_UP_TO * max(len(word), 1)]
    square = np.array([[x, y] for x in (-1, 0, 1) for y in (-1, 0, 1)]) * pen
    parts = []
    for k, character in enumerate(word.upper()):
        for a, b in strokes(character) if character != " " else []:
            share = np.linspace(0.0, 1.0, 1 + round(float(np.linalg.norm(b - a)) / 0.05))
            middle = a + share[:, None] * (b - a) + [_ADVANCE * k, 0.0]
            parts.append((middle[:, None] + square).reshape(-1, 2))
    if not parts:
        raise ValueError(f"the text is {word!r}, but must have one of {' '.join(CHARACTERS)}")
    return _upright(np.concatenate(parts))


def read_cloud(path: Path) -> Outline:
    """A point cloud: x, y, z (m), and red, green, blue in [0, 1] or up to 255 where given.

    Raises:
        ValueError: it is no array of three or six finite columns; nothing is unpickled.
        OSError: it cannot be read.
    """
    try:
        if path.suffix == ".npy":
            rows = np.load(path, allow_pickle=False)
        else:
            rows = np.genfromtxt(path, delimiter=",", dtype=np.float64, comments="#", ndmin=2)
            rows = rows[1:] if np.isnan(rows[0]).all() else rows  # names of columns
        rows = np.asarray(rows, dtype=np.float64)
    except (ValueError, TypeError, EOFError, IndexError) as error:
        raise ValueError(f"{path} is no table of numbers: {error}") from error
    if rows.ndim != 2 or rows.shape[1] not in (3, 6) or not np.isfinite(rows).all():
        rule = "must have 3 finite columns x, y, z, or 6 with red, green, blue"
        raise ValueError(f"{path} has shape {rows.shape} or numbers that are not finite; it {rule}")
    colors = rows[:, 3:] if rows.shape[1] == 6 else None
    if colors is not None:
        colors = np.clip(colors / (255.0 if colors.max() > 1.0 else 1.0), 0.0, 1.0)
    return Outline(rows[:, :3], colors, fixed=True)


def outline(name: str, drones: int, stretch: float) -> Outline:
    """The points of a shape, for so many drones; lattices have their heights stretched.

    Raises:
        ValueError: there is no such shape or character, or the file holds none.
        OSError: there is no such file.
    """
    if name.endswith((".svg", ".csv", ".npy")):
        path = Path(name)
        if not path.is_file():
            raise FileNotFoundError(f"there is no file {name!r}; give the path of a shape's file")
        if path.suffix != ".svg":
            return read_cloud(path)
        flat, colors = read_drawing(path)
        return Outline(_upright(flat), colors, flat=True)
    for prefix in (TEXT, LETTER):
        if name.startswith(prefix):
            return Outline(written_word(name.removeprefix(prefix), drones), flat=True)
    check_name("shape", name, (*NAMES, f"{TEXT}SWARM", f"{WORDS}ABC", f"{LETTER}A", "drawing.svg"))
    if name in _SURFACES:
        make, flat_shape = _SURFACES[name]
        return Outline(make(), flat=flat_shape)
    places = SHAPES[name](drones, 1.0) * np.array([1.0, 1.0, stretch])
    return Outline(places, fixed=True)


def spelled(shapes: tuple[str, ...]) -> tuple[str, ...]:
    """Shapes with `letters:ABC` as one letter after another."""
    found: list[str] = []
    for name in shapes:
        letters = name.removeprefix(WORDS) if name.startswith(WORDS) else ""
        found += [LETTER + letter for letter in letters.upper() if letter != " "] or [name]
    return tuple(found)


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
        name: of the shape, a word, a letter or a file; see the top of this module.
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
