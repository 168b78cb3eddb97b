"""Shapes of formations: each a function of n and a smallest distance, giving n points.

Points are centred: the middle of their bounding box is the origin. They are the same at every call,
and no two are nearer than the distance asked for.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import cache

import numpy as np

from swarm_envs.errors import check_name
from swarm_envs.state import FloatArray, IntArray
from swarm_envs.tasks.font import CHARACTERS, written

LETTER = "letter:"
"""What names of letters begin with, as in `letter:A`."""
LETTER_TILT = math.radians(30.0)
"""Angle between a letter and the floor, rad: it leans back, so that drones do not fly in the
downwash of those above them."""
_BLOCKS = 9


def _centered(points: FloatArray) -> FloatArray:
    middle = (points.min(axis=0) + points.max(axis=0)) / 2
    return np.asarray(points - middle)


def _lattice(counts: tuple[int, int, int]) -> FloatArray:
    """Points (., 3) of a lattice of unit spacing, layer by layer, row by row."""
    nx, ny, nz = counts
    z, y, x = np.meshgrid(np.arange(nz), np.arange(ny), np.arange(nx), indexing="ij")
    return np.stack([x, y, z], axis=-1).reshape(-1, 3).astype(np.float64)


def plane(n: int, spacing: float) -> FloatArray:
    """A level square grid, its last row perhaps shorter: points (n, 3), m."""
    side = math.ceil(math.sqrt(n))
    points = _lattice((side, side, 1))[:n]
    last = points[:, 1] == points[-1, 1]
    points[last, 0] += (side - last.sum()) / 2
    return _centered(points * spacing)


def pyramid(n: int, spacing: float) -> FloatArray:
    """Square layers of 1, 4, 9, ... from the top; the lowest has what remains, outermost first."""
    layers, left, size = [], n, 1
    while left > 0:
        layer = plane(size * size, 1.0)
        out = np.argsort(-np.abs(layer).sum(axis=1), kind="stable")
        layer = layer[out[:left]] - np.array([0.0, 0.0, size - 1.0])
        layers.append(layer)
        left, size = left - len(layer), size + 1
    return _centered(np.concatenate(layers) * spacing)


def cube(n: int, spacing: float) -> FloatArray:
    """A cubic lattice, of which corners, then edges, then faces are taken first."""
    side = max(k for k in range(1, n + 2) if (k - 1) ** 3 < n)
    points = _lattice((side, side, side)) - (side - 1) / 2
    outermost = np.argsort(-np.square(points).sum(axis=1), kind="stable")
    return _centered(points[outermost[:n]] * spacing)


def sphere(n: int, spacing: float) -> FloatArray:
    """A Fibonacci spiral on a sphere that is just large enough."""
    k = np.arange(n) + 0.5
    height, turn = 1.0 - 2.0 * k / n, math.pi * (3.0 - math.sqrt(5.0)) * k
    out = np.sqrt(1.0 - height**2)
    points = np.stack([out * np.cos(turn), out * np.sin(turn), height], axis=-1)
    return _centered(points * (spacing / _smallest_distance(points)))


def rings(n: int, spacing: float) -> FloatArray:
    """Concentric square rings in level planes, as in Fig. 9 of the RTH3D paper.

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
    """Lattice points (8 half, 2) on a square of side 2 half, one after another."""
    along = np.arange(-half, half, dtype=np.float64)
    edge = np.column_stack([along, np.full(2 * half, -float(half))])
    turn = np.array([[0.0, -1.0], [1.0, 0.0]])
    sides = [edge]
    for _ in range(3):
        sides.append(sides[-1] @ turn.T)
    return np.concatenate(sides)


def block_of(n: int) -> IntArray:
    """(n,) the block of each point of `blocks`."""
    sizes = [len(part) for part in np.array_split(np.arange(n), min(n, _BLOCKS))]
    return np.repeat(np.arange(len(sizes)), sizes)


def blocks(n: int, spacing: float) -> FloatArray:
    """Nine small blocks in a cube of 27, none above another, as in Fig. 9 of the RTH3D paper."""
    owner = block_of(n)
    largest = int(np.bincount(owner).max())
    x = next(k for k in range(1, n + 1) if k**3 >= largest)
    y = next(k for k in range(1, n + 1) if k**2 * x >= largest)
    z = -(-largest // (x * y))
    inside = _lattice((x, y, z))
    pitch = np.array([x, y, z]) + 0.5
    cells = np.array([(i, j, (i + j) % 3) for i in range(3) for j in range(3)], dtype=np.float64)
    place = np.concatenate([np.arange(size) for size in np.bincount(owner)])
    return _centered((cells[owner] * pitch + inside[place]) * spacing)


def letter(character: str, n: int, spacing: float) -> FloatArray:
    """A capital letter or digit that leans back; upright as seen against y.

    Raises:
        ValueError: there is no such character.
    """
    points = written(character, n)
    points = points * (spacing / _smallest_distance(points))
    up = points[:, 1]
    lean = [points[:, 0], up * math.cos(LETTER_TILT), up * math.sin(LETTER_TILT)]
    return _centered(np.stack(lean, axis=-1))


def _smallest_distance(points: FloatArray) -> float:
    """Smallest distance between two points; 1 if there is only one."""
    if len(points) < 2:
        return 1.0
    distance = np.linalg.norm(points[:, None] - points[None], axis=-1)
    return float(distance[np.triu_indices(len(points), 1)].min())


SHAPES: dict[str, Callable[[int, float], FloatArray]] = {
    shape.__name__: shape for shape in (plane, pyramid, cube, sphere, rings, blocks)
}
"""Every shape by name, letters apart."""
SHAPE_NAMES = (*SHAPES, *(LETTER + character for character in CHARACTERS))
"""Every shape and letter by name."""


@cache
def _unit(name: str, n: int) -> FloatArray:
    """Points (n, 3) of a shape whose smallest distance is 1."""
    if name.startswith(LETTER):
        return letter(name.removeprefix(LETTER), n, 1.0)
    return SHAPES[name](n, 1.0)


def shape_points(name: str, n: int, spacing: float) -> FloatArray:
    """Points (n, 3) of a shape, m, about the origin, no two nearer than `spacing`.

    Raises:
        ValueError: there is no such shape; the message names the nearest.
    """
    return _unit(check_name("shape", name, SHAPE_NAMES), n) * spacing
