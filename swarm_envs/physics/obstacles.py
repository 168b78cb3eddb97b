"""Static obstacles as rows of numbers: how far, and which way, the nearest point of one is.

A row holds seven numbers: its kind, then for a box the lower and upper corner, for a column the
axis x and y, the radius, and the lower and upper end. `swarm_envs.tasks.obstacles` makes the rows.
"""

from __future__ import annotations

import math

import numpy as np

from swarm_envs.compiled import kernel
from swarm_envs.state import FloatArray

BOX, COLUMN = 0.0, 1.0
"""Kinds of obstacles, as they stand first in a row."""
ROW = 7
"""Numbers in a row."""


def no_obstacles() -> FloatArray:
    """Rows (0, 7) of no obstacle at all."""
    return np.zeros((0, ROW))


@kernel
def _beyond(low: float, high: float, x: float) -> float:
    """What must be added to x to come into [low, high]; 0 within."""
    return max(low - x, 0.0) + min(high - x, 0.0)


@kernel
def nearest_point(row: FloatArray, x: float, y: float, z: float) -> tuple[float, float, float]:
    """Offset from a point to the nearest point of an obstacle, m; zero inside of it.

    Args:
        row: (7,) of the obstacle.
        x: of the point, m.
        y: of the point, m.
        z: of the point, m.
    """
    if row[0] == BOX:
        return _beyond(row[1], row[4], x), _beyond(row[2], row[5], y), _beyond(row[3], row[6], z)
    dx, dy = row[1] - x, row[2] - y
    away = math.sqrt(dx * dx + dy * dy)
    share = 1.0 - row[3] / away if away > row[3] else 0.0
    return share * dx, share * dy, _beyond(row[4], row[5], z)


@kernel
def distance_to(row: FloatArray, x: float, y: float, z: float) -> float:
    """Distance from a point to an obstacle, m; zero inside of it."""
    dx, dy, dz = nearest_point(row, x, y, z)
    return math.sqrt(dx * dx + dy * dy + dz * dz)


@kernel
def distances(rows: FloatArray, points: FloatArray, out: FloatArray) -> None:
    """Write the distance (P, M), m, from each of P points (P, 3) to each of M obstacles (M, 7)."""
    for p in range(points.shape[0]):
        for k in range(rows.shape[0]):
            out[p, k] = distance_to(rows[k], points[p, 0], points[p, 1], points[p, 2])
