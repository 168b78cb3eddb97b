"""What a formation looks like before drones take their places: many points, perhaps with colours.

A shape is a name, `text:WORD`, `letter:A`, or a file: a drawing (.svg) or a point cloud (.csv,
.npy). Flat shapes lie in the plane of x and z and face the audience, which looks along y.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np

from swarm_envs.errors import check_name
from swarm_envs.shows.drawing import read_drawing
from swarm_envs.state import FloatArray
from swarm_envs.tasks.shapes import CHARACTERS, LETTER, SHAPES, THIN_UP_TO, strokes

__all__ = ["spelled"]

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
