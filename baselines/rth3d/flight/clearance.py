"""Clearances: the least distance of robots on splines of any valid plan, and that of a flight.

Two robots on valid paths are never on the same vertex and never swap. Within a step their offset is
a spline of four differences of vertices. There are finitely many such windows near zero, so the
least distance over all of them holds for any plan of any number of robots.
"""

from __future__ import annotations

import math
from functools import cache

import numpy as np

from swarm_envs.baselines.rth3d.flight.spline import BASIS, SplineFlight
from swarm_envs.baselines.rth3d.grid_validation import MOVES
from swarm_envs.compiled import kernel
from swarm_envs.state import FloatArray

__all__ = ["smallest_distance"]

_SAMPLES = 64
_CURVATURE = 4.0
"""The bound of the second derivative of a difference by the fraction of a step: the longest second
difference of two robots' relative positions, when both turn back, in spacings."""


@cache
def worst_clearance(stretch: tuple[float, float, float] = (1.0, 1.0, 1.0)) -> float:
    """Return the least distance of robots on any valid plan's splines, over the spacing along x.

    Args:
        stretch: The spacing by axis over that along x.

    Returns:
        A lower bound: 0.647 on a cubic lattice, where straight motion has 1 / sqrt(2).

    Raises:
        ValueError: A stretch is not positive and finite.
    """
    if not all(0.0 < s < math.inf for s in stretch):
        raise ValueError(f"stretch is {stretch}, but must be positive and finite")
    # All changes of the difference of two robots in a step.
    moves = np.unique((MOVES[:, None] - MOVES).reshape(-1, 3), axis=0).astype(np.float64)
    time = np.linspace(0.0, 1.0, _SAMPLES + 1)
    weights = np.vander(time, 4, increasing=True) @ BASIS
    square = _worst_square(moves, np.array(stretch), weights)
    between = _CURVATURE * max(stretch) * (0.5 / _SAMPLES) ** 2 / 2.0
    return math.sqrt(square) - between


@kernel
def _worst_square(moves: FloatArray, stretch: FloatArray, weights: FloatArray) -> float:
    """Return the least squared stretched distance over windows of small inner differences."""
    least = np.inf
    d = np.zeros((4, 3))
    for cell in range(125):
        d[1] = cell % 5 - 2, cell // 5 % 5 - 2, cell // 25 - 2
        if not _apart(d[1]):
            continue
        for j in range(len(moves)):
            d[2] = d[1] + moves[j]
            if not (_apart(d[2]) and _apart(d[1] + d[2])):
                continue
            for i in range(len(moves)):
                d[0] = d[1] - moves[i]
                if not (_apart(d[0]) and _apart(d[0] + d[1])):
                    continue
                for k in range(len(moves)):
                    d[3] = d[2] + moves[k]
                    if _apart(d[3]) and _apart(d[2] + d[3]):
                        least = min(least, _least_square(d, stretch, weights))
    return least


@kernel
def _apart(difference: FloatArray) -> bool:
    """Return True if not zero: a zero difference is a shared vertex, a zero sum of two a swap."""
    return bool(difference[0] != 0.0 or difference[1] != 0.0 or difference[2] != 0.0)


@kernel
def _least_square(d: FloatArray, stretch: FloatArray, weights: FloatArray) -> float:
    least = np.inf
    for t in range(len(weights)):
        square = 0.0
        for axis in range(3):
            along = 0.0
            for k in range(4):
                along += weights[t, k] * d[k, axis]
            square += (along * stretch[axis]) ** 2
        least = min(least, square)
    return least


def smallest_distance(flight: SplineFlight, samples: int = 8) -> float:
    """Return the least distance of a flight's robots, at samples of each step, m."""
    from scipy.spatial import cKDTree

    if flight.num_robots < 2:
        return math.inf
    times = np.arange(flight.num_steps * samples + 1) * (flight.step_s / samples)
    least = math.inf
    for time in times:
        points = flight.reference(float(time)).position
        distance, _ = cKDTree(points).query(points, k=2)
        least = min(least, float(distance[:, 1].min()))
    return least
