"""Static obstacles as rows of numbers: how far, and which way, the nearest point of one is.

A row holds seven numbers: its kind, then for a box the lower and upper corner, for a column the
axis x and y, the radius, and the lower and upper end. `swarm_envs.tasks.obstacles` makes the rows.
"""

from __future__ import annotations

import math

import numpy as np

from swarm_envs.compiled import kernel, part
from swarm_envs.state import FloatArray

BOX, COLUMN = 0.0, 1.0
"""Kinds of obstacles, as they stand first in a row."""
ROW = 7
"""Numbers in a row."""


def no_obstacles() -> FloatArray:
    """Rows (0, 7) of no obstacle at all."""
    return np.zeros((0, ROW))


@part
def _beyond(low: float, high: float, x: float) -> float:
    """What must be added to x to come into [low, high]; 0 within."""
    return max(low - x, 0.0) + min(high - x, 0.0)


@part
def nearest_point(
    rows: FloatArray, k: int, x: float, y: float, z: float
) -> tuple[float, float, float]:
    """Offset from a point to the nearest point of obstacle k, m; zero inside of it.

    Args:
        rows: (M, 7) obstacles.
        k: which of them.
        x: of the point, m.
        y: of the point, m.
        z: of the point, m.
    """
    if rows[k, 0] == BOX:
        return (
            _beyond(rows[k, 1], rows[k, 4], x),
            _beyond(rows[k, 2], rows[k, 5], y),
            _beyond(rows[k, 3], rows[k, 6], z),
        )
    dx, dy = rows[k, 1] - x, rows[k, 2] - y
    away = math.sqrt(dx * dx + dy * dy)
    share = 1.0 - rows[k, 3] / away if away > rows[k, 3] else 0.0
    return share * dx, share * dy, _beyond(rows[k, 4], rows[k, 5], z)


@part
def distance_to(rows: FloatArray, k: int, x: float, y: float, z: float) -> float:
    """Distance from a point to obstacle k of the rows (M, 7), m; zero inside of it."""
    dx, dy, dz = nearest_point(rows, k, x, y, z)
    return math.sqrt(dx * dx + dy * dy + dz * dz)


@kernel
def distances(rows: FloatArray, points: FloatArray, out: FloatArray) -> None:
    """Write the distance (P, M), m, from each of P points (P, 3) to each of M obstacles (M, 7)."""
    for p in range(points.shape[0]):
        for k in range(rows.shape[0]):
            out[p, k] = distance_to(rows, k, points[p, 0], points[p, 1], points[p, 2])
