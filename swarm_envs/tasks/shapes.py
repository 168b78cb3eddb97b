"""Shapes of formations: functions from a number n and a spacing to n points.

The center of the points' bounding box is the origin, and the spacing is their smallest distance.
Points are deterministic. Letters consist of lines on a grid of 5 x 7 points.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import cache
from itertools import pairwise

import numpy as np

from swarm_envs.errors import check_name
from swarm_envs.state import FloatArray, IntArray

__all__ = ["CHARACTERS", "LETTER", "SHAPES", "THIN_UP_TO", "plane", "shape_points", "strokes"]

_ROUND = "10-01-05-16-36-45-41-30-10"
_BOW = "00-06-36-45-44-33-03"
_LINES: dict[str, str] = {
    "A": "00-26-40 13-33",
    "B": f"{_BOW} 33-42-41-30-00",
    "C": "45-36-16-05-01-10-30-41",
    "D": "00-06-26-44-42-20-00",
    "E": "46-06-00-40 03-33",
    "F": "46-06-00 03-33",
    "G": "45-36-16-05-01-10-30-41-43-23",
    "H": "00-06 40-46 03-43",
    "I": "16-36 26-20 10-30",
    "J": "46-41-30-10-01",
    "K": "00-06 46-03-40",
    "L": "06-00-40",
    "M": "00-06-23-46-40",
    "N": "00-06-40-46",
    "O": _ROUND,
    "P": _BOW,
    "Q": f"{_ROUND} 22-40",
    "R": f"{_BOW} 23-40",
    "S": "45-36-16-05-04-13-33-42-41-30-10-01",
    "T": "06-46 26-20",
    "U": "06-01-10-30-41-46",
    "V": "06-20-46",
    "W": "06-10-23-30-46",
    "X": "00-46 06-40",
    "Y": "06-23-46 23-20",
    "Z": "06-46-00-40",
    "0": f"{_ROUND} 12-34",
    "1": "15-26-20 10-30",
    "2": "05-16-36-45-44-00-40",
    "3": "06-46-23-33-42-41-30-10-01",
    "4": "30-36-02-42",
    "5": "46-06-04-34-43-41-30-10-01",
    "6": "45-36-16-05-01-10-30-41-42-33-03",
    "7": "06-46-10",
    "8": "13-04-05-16-36-45-44-33-13-02-01-10-30-41-42-33",
    "9": "01-10-30-41-45-36-16-05-04-13-43",
}
"""Strokes of each character; two digits are x and y of a point, hyphens join points."""
CHARACTERS = tuple(_LINES)
"""The available characters."""
THIN_UP_TO = 24
"""Largest number of drones of a character with thin strokes; strokes of larger ones are broad."""
_STEP, _BROAD, _SWEEPS = 0.05, 0.5, 15


def strokes(character: str) -> list[tuple[FloatArray, FloatArray]]:
    """Return the line segments of a character: pairs of points (2,) with x in 0-4, y in 0-6.

    Raises:
        ValueError: the character is not among `CHARACTERS`.
    """
    check_name("character", character, CHARACTERS)
    pieces = []
    for line in _LINES[character].split():
        points = [np.array([float(point[0]), float(point[1])]) for point in line.split("-")]
        pieces += list(pairwise(points))
    return pieces


def written(character: str, n: int) -> FloatArray:
    """Return points (n, 2) spread evenly over a character.

    Points are chosen one after another, each farthest from those before, and then spread by
    Lloyd's method.

    Raises:
        ValueError: the character is not among `CHARACTERS`.
    """
    candidates = _dense(character, broad=n > THIN_UP_TO)
    chosen = np.empty((n, 2))
    distance = np.full(len(candidates), np.inf)
    for k in range(n):
        chosen[k] = candidates[int(np.argmax(distance))]
        distance = np.minimum(distance, np.linalg.norm(candidates - chosen[k], axis=1))
    return _spread(chosen, candidates)


def _spread(points: FloatArray, candidates: FloatArray) -> FloatArray:
    """Return the most even point set (n, 2) of the iterations of Lloyd's method on candidates."""
    best, n = points, len(points)
    for _ in range(_SWEEPS):
        owner = _squares(candidates, points).argmin(axis=1)
        size = np.bincount(owner, minlength=n)
        sums = [np.bincount(owner, candidates[:, k], minlength=n) for k in range(2)]
        means = np.stack(sums, axis=-1) / size[:, None]
        points = candidates[_squares(means, candidates).argmin(axis=1)]
        if len(np.unique(points, axis=0)) < n:
            break
        if _evenness(points) > _evenness(best):
            best = points
    return best


def _squares(a: FloatArray, b: FloatArray) -> FloatArray:
    """Return the squared distances (A, B) between points (A, 2) and (B, 2)."""
    return np.asarray(
        np.square(a).sum(axis=1)[:, None] - 2.0 * a @ b.T + np.square(b).sum(axis=1)[None]
    )


def _evenness(points: FloatArray) -> float:
    """Return the smallest squared distance between two of the points (n, 2)."""
    return float((_squares(points, points) + np.diag(np.full(len(points), np.inf))).min())


def _dense(character: str, broad: bool) -> FloatArray:
    """Return dense points of a character: on its lines or, if broad, in a band around them."""
    pieces = strokes(character)
    if not broad:
        rows = []
        for a, b in pieces:
            share = np.linspace(0.0, 1.0, 1 + round(float(np.linalg.norm(b - a)) / _STEP))
            rows.append(a + share[:, None] * (b - a))
        return np.concatenate(rows)
    grid = np.stack(
        np.meshgrid(np.arange(-_BROAD, 4.51, 0.1), np.arange(-_BROAD, 6.51, 0.1)), axis=-1
    ).reshape(-1, 2)
    near = np.full(len(grid), np.inf)
    for a, b in pieces:
        share = np.clip((grid - a) @ (b - a) / ((b - a) @ (b - a)), 0.0, 1.0)
        near = np.minimum(near, np.linalg.norm(grid - a - share[:, None] * (b - a), axis=1))
    return np.asarray(grid[near <= _BROAD + 1e-9])


LETTER = "letter:"
"""Prefix of the names of letters, as in `letter:A`."""
LETTER_TILT = math.radians(30.0)
"""Angle between a letter and the floor, rad: it is tilted, so that drones are not in the downwash
of those above them."""
_BLOCKS = 9


def _centered(points: FloatArray) -> FloatArray:
    middle = (points.min(axis=0) + points.max(axis=0)) / 2
    return np.asarray(points - middle)


def _lattice(counts: tuple[int, int, int]) -> FloatArray:
    """Return the points (., 3) of a lattice of unit spacing, layer by layer, row by row."""
    nx, ny, nz = counts
    z, y, x = np.meshgrid(np.arange(nz), np.arange(ny), np.arange(nx), indexing="ij")
    return np.stack([x, y, z], axis=-1).reshape(-1, 3).astype(np.float64)


def plane(n: int, spacing: float) -> FloatArray:
    """Return points (n, 3), m, of a horizontal square grid, whose last row may be shorter."""
    side = math.ceil(math.sqrt(n))
    points = _lattice((side, side, 1))[:n]
    last = points[:, 1] == points[-1, 1]
    points[last, 0] += (side - last.sum()) / 2
    return _centered(points * spacing)


def pyramid(n: int, spacing: float) -> FloatArray:
    """Return square layers of 1, 4, 9, ... points from the top; the last is filled from outside."""
    layers, left, size = [], n, 1
    while left > 0:
        layer = plane(size * size, 1.0)
        out = np.argsort(-np.abs(layer).sum(axis=1), kind="stable")
        layer = layer[out[:left]] - np.array([0.0, 0.0, size - 1.0])
        layers.append(layer)
        left, size = left - len(layer), size + 1
    return _centered(np.concatenate(layers) * spacing)


def cube(n: int, spacing: float) -> FloatArray:
    """Return points of a cubic lattice, chosen from outside: corners first, then edges, faces."""
    side = max(k for k in range(1, n + 2) if (k - 1) ** 3 < n)
    points = _lattice((side, side, side)) - (side - 1) / 2
    outermost = np.argsort(-np.square(points).sum(axis=1), kind="stable")
    return _centered(points[outermost[:n]] * spacing)


def sphere(n: int, spacing: float) -> FloatArray:
    """Return points of a Fibonacci spiral on a sphere."""
    k = np.arange(n) + 0.5
    height, turn = 1.0 - 2.0 * k / n, math.pi * (3.0 - math.sqrt(5.0)) * k
    out = np.sqrt(1.0 - height**2)
    points = np.stack([out * np.cos(turn), out * np.sin(turn), height], axis=-1)
    return _centered(points * (spacing / _smallest_distance(points)))


def rings(n: int, spacing: float) -> FloatArray:
    """Return concentric square rings in horizontal planes, as in Fig. 9 of the RTH3D paper.

    Rings have half sides of 1, 3, 5, ... spacings; drones are spread evenly over the planes.
    """
    number = next(j for j in range(1, n + 1) if 8 * j * j * 2 * j >= n)
    ring_points = [_square_ring(2 * k + 1) for k in range(number)]
    flat = np.concatenate(ring_points)
    planes = -(-n // len(flat))
    layers = []
    for z, members in enumerate(np.array_split(np.arange(n), planes)):
        chosen = flat[np.arange(len(members)) * len(flat) // max(len(members), 1)]
        layers.append(np.column_stack([chosen, np.full(len(members), float(z))]))
    return _centered(np.concatenate(layers) * spacing)


def _square_ring(half: int) -> FloatArray:
    """Return the lattice points (8 half, 2) on the edges of a square of side 2 half, in order."""
    along = np.arange(-half, half, dtype=np.float64)
    edge = np.column_stack([along, np.full(2 * half, -float(half))])
    turn = np.array([[0.0, -1.0], [1.0, 0.0]])
    sides = [edge]
    for _ in range(3):
        sides.append(sides[-1] @ turn.T)
    return np.concatenate(sides)


def block_of(n: int) -> IntArray:
    """Return the index (n,) of the block of each point of `blocks`."""
    sizes = [len(part) for part in np.array_split(np.arange(n), min(n, _BLOCKS))]
    return np.repeat(np.arange(len(sizes)), sizes)


def blocks(n: int, spacing: float) -> FloatArray:
    """Return nine blocks in a cube of 27, none above another, as in Fig. 9 of the RTH3D paper."""
    owner = block_of(n)
    largest = int(np.bincount(owner).max())
    x = next(k for k in range(1, n + 1) if k**3 >= largest)
    y = next(k for k in range(1, n + 1) if k**2 * x >= largest)
    z = -(-largest // (x * y))
    inside = _lattice((x, y, z))
    pitch = np.array([x, y, z]) + 0.5
    cells = np.array([(i, j, (i + j) % 3) for i in range(3) for j in range(3)], dtype=np.float64)
    member = np.concatenate([np.arange(size) for size in np.bincount(owner)])
    return _centered((cells[owner] * pitch + inside[member]) * spacing)


def letter(character: str, n: int, spacing: float) -> FloatArray:
    """Return points of a tilted capital letter or digit, upright for a viewer who looks along y.

    Raises:
        ValueError: there is no such character.
    """
    points = written(character, n)
    points = points * (spacing / _smallest_distance(points))
    up = points[:, 1]
    lean = [points[:, 0], up * math.cos(LETTER_TILT), up * math.sin(LETTER_TILT)]
    return _centered(np.stack(lean, axis=-1))


def _smallest_distance(points: FloatArray) -> float:
    """Return the smallest distance between two points; 1 if there is only one."""
    if len(points) < 2:
        return 1.0
    distance = np.linalg.norm(points[:, None] - points[None], axis=-1)
    return float(distance[np.triu_indices(len(points), 1)].min())


SHAPES: dict[str, Callable[[int, float], FloatArray]] = {
    shape.__name__: shape for shape in (plane, pyramid, cube, sphere, rings, blocks)
}
"""The shapes by name, without letters."""
SHAPE_NAMES = (*SHAPES, *(LETTER + character for character in CHARACTERS))
"""The names of all shapes and letters."""


@cache
def _unit(name: str, n: int) -> FloatArray:
    """Return points (n, 3) of a shape with spacing 1."""
    if name.startswith(LETTER):
        return letter(name.removeprefix(LETTER), n, 1.0)
    return SHAPES[name](n, 1.0)


def shape_points(name: str, n: int, spacing: float) -> FloatArray:
    """Return the points (n, 3) of a shape about the origin, m, with smallest distance `spacing`.

    Raises:
        ValueError: there is no such shape; the message names the nearest.
    """
    return _unit(check_name("shape", name, SHAPE_NAMES), n) * spacing
