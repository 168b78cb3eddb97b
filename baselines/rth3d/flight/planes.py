"""Planes that move between two robots, or stand between a robot and a box, for each spline step.

A step of a spline lies in the hull of its four Bezier points, and so does the difference of two: if
all four Bezier differences lie beyond a plane at distance d from the origin, the robots keep d.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from swarm_envs.baselines.rth3d.flight.spline import SplineFlight
from swarm_envs.compiled import kernel
from swarm_envs.state import FloatArray, IntArray

BEZIER = np.array([[1, 4, 1, 0], [0, 4, 2, 0], [0, 2, 4, 0], [0, 1, 4, 1]]) / 6.0
"""The Bezier points of a step, by row, from its four control points."""


class Planes(NamedTuple):
    """For each of P pairs of a robot and a step: normal . B_k >= offset_k, k = 0..3."""

    robot: IntArray
    """(P,) who keeps it."""
    step: IntArray
    """(P,) in which step."""
    normal: FloatArray
    """(P, 3) of unit length in the scaled metric."""
    offset: FloatArray
    """(P, 4) one for each Bezier point, m."""

    def some(self, which: IntArray | slice) -> Planes:
        """Those of a selection."""
        robot, step = self.robot[which], self.step[which]
        return Planes(robot, step, self.normal[which], self.offset[which])


def joined(parts: Sequence[Planes]) -> Planes:
    """All planes of several sets."""
    return Planes(
        np.concatenate([part.robot for part in parts]),
        np.concatenate([part.step for part in parts]),
        np.concatenate([part.normal for part in parts]),
        np.concatenate([part.offset for part in parts]),
    )


def bezier_points(flight: SplineFlight) -> FloatArray:
    """(steps, n, 4, 3) Bezier points of every step, m."""
    control = flight.control
    windows = np.stack([control[k : k + flight.num_steps] for k in range(4)], axis=2)
    return np.asarray(np.einsum("bk,snkx->snbx", BEZIER, windows))


def planes_between(
    flight: SplineFlight, distance: float, scaling: FloatArray, travel: float
) -> Planes:
    """Planes half way between robots that could meet, for both of each pair.

    Args:
        flight: as it is now; it satisfies every plane.
        distance: scaled distance to keep, m; where two are closer now, they keep what they have.
        scaling: (3,) diagonal of Theta.
        travel: how far a control point may be moved by axis, m: who is farther off cannot meet.
    """
    points = bezier_points(flight) / scaling
    steps, first, second = _near_pairs(points, distance, travel / float(scaling.min()))
    a, b = points[steps, first], points[steps, second]
    normal, apart = _nearest_points(np.ascontiguousarray(a - b))
    world = normal / scaling
    meet = (apart - distance) / 2 < travel * np.abs(world).sum(axis=1)
    steps, first, second, a, b = (x[meet] for x in (steps, first, second, a, b))
    normal, world, apart = normal[meet], world[meet], apart[meet]
    half = np.minimum(distance, apart)[:, None] / 2
    middle = np.einsum("px,pkx->pk", normal, (a + b) / 2)
    return Planes(
        np.concatenate([first, second]),
        np.concatenate([steps, steps]),
        np.concatenate([world, -world]),
        np.concatenate([middle + half, half - middle]),
    )


def _near_pairs(
    points: FloatArray, distance: float, travel: float
) -> tuple[IntArray, IntArray, IntArray]:
    """Steps and pairs of robots, first below second, that could come within a distance."""
    middle = points.mean(axis=2)
    radius = np.linalg.norm(points - middle[:, :, None], axis=-1).max(axis=2)
    apart = distance + 2.0 * np.sqrt(3.0) * travel
    reach = apart + 2.0 * radius.max(initial=0.0)
    found = [cKDTree(row).query_pairs(reach, output_type="ndarray") for row in middle]
    steps = np.repeat(np.arange(len(found)), [len(pairs) for pairs in found])
    pairs = np.concatenate(found) if found else np.empty((0, 2), dtype=np.int64)
    first, second = pairs[:, 0].astype(np.int64), pairs[:, 1].astype(np.int64)
    between = np.linalg.norm(middle[steps, first] - middle[steps, second], axis=-1)
    near = between < apart + radius[steps, first] + radius[steps, second]
    return steps[near], first[near], second[near]


def planes_to_boxes(
    flight: SplineFlight, boxes: FloatArray, distance: float, travel: float
) -> Planes:
    """The face of each near box from which a robot is farthest, at a distance.

    Args:
        flight: as it is now; it satisfies every plane.
        boxes: (B, 2, 3) lower and upper corners, m.
        distance: to keep, m; where a robot is closer now, it keeps what it has.
        travel: how far a control point may be moved by axis, m.
    """
    points = bezier_points(flight)
    parts = [_nobody()]
    for low, high in boxes:
        gaps = np.concatenate([low - points.max(axis=2), points.min(axis=2) - high], axis=-1)
        face = gaps.argmax(axis=-1)
        best = np.take_along_axis(gaps, face[..., None], axis=-1)[..., 0]
        step, robot = np.nonzero(best < distance + 2.0 * travel)
        chosen = face[step, robot]
        normal = np.concatenate([-np.eye(3), np.eye(3)])[chosen]
        surface = np.concatenate([-low, high])[chosen]
        keep = surface + np.minimum(distance, best[step, robot])
        parts.append(Planes(robot, step, normal, np.repeat(keep[:, None], 4, axis=1)))
    return joined(parts)


def _nobody() -> Planes:
    nothing = np.empty(0, dtype=np.int64)
    return Planes(nothing, nothing, np.empty((0, 3)), np.empty((0, 4)))


def _nearest_points(hulls: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Unit vectors (P, 3) to the point of each hull (P, 4, 3) nearest to zero, and distances."""
    nearest = np.empty((len(hulls), 3))
    _nearest(hulls, nearest)
    apart = np.linalg.norm(nearest, axis=1)
    if (apart <= 1e-9).any():
        raise ValueError("two robots of this flight touch: no plane separates them")
    return nearest / apart[:, None], apart


@kernel
def _nearest(hulls: FloatArray, out: FloatArray) -> None:
    """The point of each hull nearest to zero, by Gilbert's iteration (Frank-Wolfe with away steps).

    Converged when no vertex is nearer along the direction, to 1e-10.
    """
    for p in range(len(hulls)):
        points = hulls[p]
        weight = np.full(4, 0.25)
        for _ in range(2000):
            x = np.zeros(3)
            for k in range(4):
                x += weight[k] * points[k]
            along = points @ x
            toward, away = np.argmin(along), -1
            for k in range(4):
                if weight[k] > 0.0 and (away < 0 or along[k] > along[away]):
                    away = k
            square = x @ x
            if square - along[toward] <= 1e-10 * square + 1e-22:
                break
            direction = points[toward] - points[away]
            length = direction @ direction
            if length == 0.0:
                break
            step = min(float(weight[away]), -float(x @ direction) / float(length))
            weight[toward] += step
            weight[away] -= step
        for axis in range(3):
            out[p, axis] = 0.0
            for k in range(4):
                out[p, axis] += weight[k] * points[k, axis]
