"""The reference paths of a show: cubic curves of N drones with common knots, and their clearance.

Within a piece the jerk is constant, so that Skybrush's Bezier curves say exactly the same.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from swarm_envs.state import FloatArray, IntArray
from swarm_envs.trajectories import Reference

_POWERS = np.array([[1, 0, 0, 0], [-3, 3, 0, 0], [3, -6, 3, 0], [-1, 3, -3, 1]], dtype=np.float64)
"""Coefficients of the powers of u, by row, that weigh the four Bezier points of a piece."""
_STEP_S = 0.02


@dataclass(frozen=True, eq=False)
class Choreography:
    """Piecewise cubic paths of N drones, at rest at both ends.

    Args:
        knots: (K + 1,) times at which pieces begin and end, s, increasing from 0.
        points: (K, 4, N, 3) Bezier points of each piece, m.
    """

    knots: FloatArray
    points: FloatArray

    @property
    def duration_s(self) -> float:
        """From the beginning to the end, s."""
        return float(self.knots[-1])

    def reference(self, time: float) -> Reference:
        """Where the drones should be at a time, s: arrays (N, 3). They rest before and after."""
        now = min(max(time, 0.0), self.duration_s)
        k = min(int(np.searchsorted(self.knots, now, side="right")) - 1, len(self.points) - 1)
        length = self.knots[k + 1] - self.knots[k]
        u = (now - self.knots[k]) / length
        a, b, c, d = np.tensordot(_POWERS, self.points[k], axes=1)
        first = (b + u * (2 * c + u * 3 * d)) / length
        second = (2 * c + 6 * u * d) / length**2
        third = 6 * d / length**3 if 0.0 <= time < self.duration_s else np.zeros_like(d)
        return Reference(a + u * (b + u * (c + u * d)), first, second, third)

    def positions(self, times: FloatArray) -> FloatArray:
        """(T, N, 3) where the drones should be at times (T,), s."""
        now = np.clip(times, 0.0, self.duration_s)
        k = np.clip(np.searchsorted(self.knots, now, side="right") - 1, 0, len(self.points) - 1)
        u = (now - self.knots[k]) / np.diff(self.knots)[k]
        weights = np.vander(u, 4, increasing=True) @ _POWERS
        return np.stack([np.tensordot(w, self.points[j], axes=1) for w, j in zip(weights, k)])

    def largest(self) -> tuple[float, float]:
        """Largest speed, m/s, and acceleration, m/s^2, of any drone."""
        length = np.diff(self.knots)[:, None, None, None]
        first = 3.0 * np.diff(self.points, axis=1) / length
        second = 2.0 * np.diff(first, axis=1) / length
        speeds, accelerations = (
            np.linalg.norm(x, axis=-1).max(initial=0.0) for x in (first, second)
        )
        return float(speeds), float(accelerations)


def between(times: FloatArray, values: FloatArray, at: FloatArray | float) -> FloatArray:
    """Values (L, ...) that are known at times (L,), s, at others: linear, constant outside."""
    k = np.clip(np.searchsorted(times, at, side="right") - 1, 0, len(times) - 2)
    share = np.clip((at - times[k]) / (times[k + 1] - times[k]), 0.0, 1.0)
    share = np.reshape(share, np.shape(share) + (1,) * (values.ndim - 1))
    return np.asarray((1.0 - share) * values[k] + share * values[k + 1])


def joined(parts: Sequence[Choreography]) -> Choreography:
    """Paths one after another; each begins where the last one ends."""
    ends = np.cumsum([0.0, *(part.duration_s for part in parts)])
    knots = [part.knots[1:] + begin for part, begin in zip(parts, ends)]
    points = [part.points for part in parts]
    return Choreography(np.concatenate([[0.0], *knots]), np.concatenate(points))


def hold(places: FloatArray, seconds: float) -> Choreography:
    """Rest at places (N, 3), m, for so long, s."""
    return Choreography(np.array([0.0, seconds]), np.repeat(places[None, None], 4, axis=1))


def least_distance(paths: Choreography, scaling: FloatArray) -> float:
    """A lower bound of the scaled distance of any two drones at any time, m, to about 1 mm.

    Between samples 0.02 s apart the difference of two drones is a straight line, but for its
    curvature: at most its largest second derivative times the square of the step, over 8.

    Args:
        paths: of N drones.
        scaling: (3,) by which distances are divided.
    """
    if paths.points.shape[2] < 2:
        return math.inf
    least = math.inf
    for begin, end, points in zip(paths.knots, paths.knots[1:], paths.points / scaling):
        still = bool((points == points[0]).all())
        steps = 1 if still else math.ceil((end - begin) / _STEP_S)
        weights = np.vander(np.linspace(0.0, 1.0, steps + 1), 4, increasing=True) @ _POWERS
        bend = 12.0 * np.linalg.norm(np.diff(points, n=2, axis=0), axis=-1).max() / steps**2 / 8.0
        here = np.tensordot(weights[0], points, axes=1)
        for row in weights[1:]:
            there = np.tensordot(row, points, axes=1)
            least = min(least, _least_between(here, there) - bend)
            here = there
    return least


def _least_between(here: FloatArray, there: FloatArray) -> float:
    """Least distance of N points that all move straight from one place to another."""
    tree = cKDTree(here)
    travel = float(np.linalg.norm(there - here, axis=1).max())
    reach = float(tree.query(here, k=2)[0][:, 1].min()) + 2.0 * travel
    pairs = tree.query_pairs(reach * (1.0 + 1e-9), output_type="ndarray")
    return float(np.sqrt(_square_between(here, there, pairs).min()))


def _square_between(here: FloatArray, there: FloatArray, pairs: IntArray) -> FloatArray:
    """Squared least distance of each pair (P, 2) while all move straight."""
    a = here[pairs[:, 0]] - here[pairs[:, 1]]
    way = there[pairs[:, 0]] - there[pairs[:, 1]] - a
    length = np.maximum((way * way).sum(axis=1), 1e-300)
    share = np.clip(-(a * way).sum(axis=1) / length, 0.0, 1.0)
    return np.square(a + share[:, None] * way).sum(axis=1)
