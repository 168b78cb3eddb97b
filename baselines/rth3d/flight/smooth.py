"""Smoother flights of up to about a thousand robots: corridors and quadratic programs.

As in Hoenig et al. 2018, corridors are bounded by separating planes: each robot's control points
are moved to lower acceleration and jerk within planes halfway between it and the others. All robots
move at once, as pairs share their planes. The present flight is feasible for every program, so no
round makes it less safe; a robot whose program fails keeps its path.

A step of a spline lies in the hull of its four Bezier points, and so does the difference of two: if
all four Bezier differences lie beyond a plane at distance d from the origin, the robots keep d.

With the free control points X and the Hessian H = L L', a robot's cost is |L' X - Y|^2 / 2. H is
the same for every robot and round, so it is factorized once. Few of the thousands of rows of planes
and boxes are active. Rows are added when the solution breaks them; the result is exact when none is
broken.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy.linalg import solve_triangular
from scipy.spatial import cKDTree

from swarm_envs.baselines.mlr_dmpc.condensed_qp import solve_qp
from swarm_envs.baselines.rth3d.flight.clearance import smallest_distance
from swarm_envs.baselines.rth3d.flight.spline import SplineFlight
from swarm_envs.compiled import kernel
from swarm_envs.state import FloatArray, IntArray

__all__ = ["SmoothingConfig", "smooth"]

BEZIER = np.array([[1, 4, 1, 0], [0, 4, 2, 0], [0, 2, 4, 0], [0, 1, 4, 1]]) / 6.0
"""The Bezier points of a step, by row, from its four control points."""
_TRAVEL_M = 0.25  # The farthest that a control point moves by axis in a round


class _Planes(NamedTuple):
    """Half-spaces normal . B_k >= offset_k, k = 0..3, for each of P pairs of a robot and a step."""

    robot: IntArray  # (P,) the robot to which it applies
    step: IntArray  # (P,) the step in which it applies
    normal: FloatArray  # (P, 3) of unit length
    offset: FloatArray  # (P, 4) one for each Bezier point, m

    def some(self, which: IntArray | slice) -> _Planes:
        """Return the planes of a selection."""
        robot, step = self.robot[which], self.step[which]
        return _Planes(robot, step, self.normal[which], self.offset[which])


def _join(parts: Sequence[_Planes]) -> _Planes:
    return _Planes(*(np.concatenate(arrays) for arrays in zip(*parts)))


def bezier_points(control: FloatArray) -> FloatArray:
    """Return Bezier points (steps, ..., 4, 3) of every step, m, for control points (K, ..., 3)."""
    windows = np.stack([control[k : len(control) - 3 + k] for k in range(4)], axis=-2)
    return np.asarray(np.einsum("bk,...kx->...bx", BEZIER, windows))


def planes_between(flight: SplineFlight, distance: float) -> _Planes:
    """Return planes halfway between robots that could come close, for both of each pair.

    The present flight satisfies every plane: pairs that are closer than `distance`, m, keep their
    distance.
    """
    points = bezier_points(flight.control)
    steps, first, second = _near_pairs(points, distance)
    a, b = points[steps, first], points[steps, second]
    normal, apart = _nearest_points(np.ascontiguousarray(a - b))
    near = (apart - distance) / 2 < _TRAVEL_M * np.abs(normal).sum(axis=1)
    steps, first, second, a, b = (x[near] for x in (steps, first, second, a, b))
    normal, apart = normal[near], apart[near]
    half = np.minimum(distance, apart)[:, None] / 2
    middle = np.einsum("px,pkx->pk", normal, (a + b) / 2)
    return _Planes(
        np.concatenate([first, second]),
        np.concatenate([steps, steps]),
        np.concatenate([normal, -normal]),
        np.concatenate([middle + half, half - middle]),
    )


def _near_pairs(points: FloatArray, distance: float) -> tuple[IntArray, IntArray, IntArray]:
    """Return steps and pairs of robots (first < second) that could come within a distance."""
    middle = points.mean(axis=2)
    radius = np.linalg.norm(points - middle[:, :, None], axis=-1).max(axis=2)
    apart = distance + 2.0 * np.sqrt(3.0) * _TRAVEL_M
    reach = apart + 2.0 * radius.max(initial=0.0)
    found = [cKDTree(row).query_pairs(reach, output_type="ndarray") for row in middle]
    steps = np.repeat(np.arange(len(found)), [len(pairs) for pairs in found])
    pairs = np.concatenate(found) if found else np.empty((0, 2), dtype=np.int64)
    first, second = pairs[:, 0].astype(np.int64), pairs[:, 1].astype(np.int64)
    between = np.linalg.norm(middle[steps, first] - middle[steps, second], axis=-1)
    near = between < apart + radius[steps, first] + radius[steps, second]
    return steps[near], first[near], second[near]


def planes_to_boxes(flight: SplineFlight, boxes: FloatArray, distance: float) -> _Planes:
    """Return planes at a distance, m, from the faces of near boxes (B, 2, 3).

    The face of a box is that from which a robot is farthest. A robot that is closer keeps its
    distance.
    """
    points = bezier_points(flight.control)
    nothing = np.empty(0, dtype=np.int64)
    parts = [_Planes(nothing, nothing, np.empty((0, 3)), np.empty((0, 4)))]
    for low, high in boxes:
        gaps = np.concatenate([low - points.max(axis=2), points.min(axis=2) - high], axis=-1)
        face = gaps.argmax(axis=-1)
        best = np.take_along_axis(gaps, face[..., None], axis=-1)[..., 0]
        step, robot = np.nonzero(best < distance + 2.0 * _TRAVEL_M)
        chosen = face[step, robot]
        normal = np.concatenate([-np.eye(3), np.eye(3)])[chosen]
        surface = np.concatenate([-low, high])[chosen]
        keep = surface + np.minimum(distance, best[step, robot])
        parts.append(_Planes(robot, step, normal, np.repeat(keep[:, None], 4, axis=1)))
    return _join(parts)


def _nearest_points(hulls: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return unit vectors (P, 3) to each hull's (P, 4, 3) point nearest to zero, and distances."""
    nearest = np.empty((len(hulls), 3))
    _nearest(hulls, nearest)
    apart = np.linalg.norm(nearest, axis=1)
    if (apart <= 1e-9).any():
        raise ValueError("no plane separates two robots of this flight; use one without contacts")
    return nearest / apart[:, None], apart


@kernel
def _nearest(hulls: FloatArray, out: FloatArray) -> None:
    """Write the point of each hull nearest to zero, by Gilbert's iteration with away steps.

    It has converged when no vertex is nearer along the direction, to 1e-10.
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


FIXED = 3  # The fixed control points at either end, where the robot rests
_TOLERANCE = 1e-6  # The tolerance of rows, m
_AT_ONCE = 60  # The most broken rows that are added before the program is solved again
_ROUNDS = 30  # The most additions of rows, after which the solution is drawn towards the old path


class _Smoothness(NamedTuple):
    """The cost of K control points, of which the F = K - 6 in the middle are free."""

    pull: FloatArray  # (F, K) L' times the best free points, as a function of all control points
    inverse: FloatArray  # (F, F) inverse of L
    # (4 S + F, F) by row, L^-1 times the weights of a Bezier point, or of a control point
    rows: FloatArray


def smoothness(count: int) -> _Smoothness:
    """Return the cost of K control points, at least 7, by squared second and third differences."""
    eye = np.eye(count)
    second, third = np.diff(eye, n=2, axis=0), np.diff(eye, n=3, axis=0)
    hessian = second.T @ second + third.T @ third
    free = slice(FIXED, count - FIXED)
    held = np.r_[:FIXED, count - FIXED : count]
    lower = np.linalg.cholesky(hessian[free, free])
    inverse = solve_triangular(lower, np.eye(len(lower)), lower=True)
    pull = np.zeros((len(lower), count))
    pull[:, held] = -inverse @ hessian[free][:, held]
    weights = np.zeros((count - 3, 4, count))
    for step in range(count - 3):
        weights[step, :, step : step + 4] = BEZIER
    every = np.concatenate([weights.reshape(-1, count), eye[free]])[:, free]
    return _Smoothness(pull, inverse, np.ascontiguousarray(every @ inverse.T))


class _Rows(NamedTuple):
    """Rows normal . point >= offset, for Bezier points and for the free control points."""

    point: IntArray  # (R,) index of the point in `_Smoothness.rows`
    normal: FloatArray  # (R, 3)
    offset: FloatArray  # (R,) m


def _rows(planes: _Planes, low: FloatArray, high: FloatArray) -> _Rows:
    """Return the rows of planes, and of boxes (F, 3) around the free control points."""
    count = len(low)
    point = (4 * planes.step[:, None] + np.arange(4)).ravel()
    own = np.repeat(4 * (count + FIXED) + np.arange(count), 3)
    sides = np.tile(np.eye(3), (count, 1))
    return _Rows(
        np.concatenate([point, own, own]),
        np.concatenate([np.repeat(planes.normal, 4, axis=0), sides, -sides]),
        np.concatenate([planes.offset.ravel(), low.ravel(), -high.ravel()]),
    )


def _points(control: FloatArray) -> FloatArray:
    """Return the Bezier points of each step, then the free control points (4 S + F, 3)."""
    return np.concatenate([bezier_points(control).reshape(-1, 3), control[FIXED:-FIXED]])


def _slack(rows: _Rows, control: FloatArray) -> FloatArray:
    """Return the slack (R,) of each row at control points (K, 3), m."""
    points = _points(control)[rows.point]
    return np.asarray(np.einsum("rx,rx->r", points, rows.normal) - rows.offset)


def improve(
    control: FloatArray, planes: _Planes, low: FloatArray, high: FloatArray, cost: _Smoothness
) -> FloatArray:
    """Return better control points (K, 3) of one robot within its planes, or the same.

    The free ones (F, 3) stay between `low` and `high`, m. `control` must satisfy every row.
    """
    rows, slope = _rows(planes, low, high), -(cost.pull @ control)
    held, better = control.copy(), control.copy()
    held[FIXED:-FIXED] = 0.0
    still = -_slack(rows, held)
    chosen, active = np.empty(0, dtype=np.int64), np.empty(0, dtype=np.bool_)
    y = -slope
    for _ in range(_ROUNDS):
        better[FIXED:-FIXED] = cost.inverse.T @ y
        broken = _worst(_slack(rows, better))
        if not len(broken):
            return better
        chosen, active = np.r_[chosen, broken], np.r_[active, np.zeros(len(broken), np.bool_)]
        matrix = cost.rows[rows.point[chosen], :, None] * rows.normal[chosen, None, :]
        found = solve_qp(slope.ravel(), matrix.reshape(len(chosen), -1), still[chosen], active)
        if not found.solved:
            return control
        y, active = found.y.reshape(slope.shape), found.active
    return _between(rows, control, better)


def _worst(slack: FloatArray) -> IntArray:
    broken = np.flatnonzero(slack < -_TOLERANCE)
    if len(broken) <= _AT_ONCE:
        return broken
    return np.asarray(broken[np.argpartition(slack[broken], _AT_ONCE)[:_AT_ONCE]])


def _between(rows: _Rows, control: FloatArray, better: FloatArray) -> FloatArray:
    """Return the farthest point from the old towards the better that satisfies every row."""
    before, after = _slack(rows, control), _slack(rows, better)
    worse = after < np.minimum(before, -_TOLERANCE)
    room = np.maximum(before + _TOLERANCE, 0.0)
    share = float((room[worse] / (before - after)[worse]).min(initial=1.0))
    return np.asarray(control + share * (better - control))


_ROUNDING = 1e-5  # By how much robots may come closer, due to the tolerance of planes, m


@dataclass(frozen=True, kw_only=True)
class SmoothingConfig:
    """The distances, limits and rounds of smoothing."""

    distance: float
    """The distance of robots, m; closer ones keep their distance."""
    box: tuple[tuple[float, float, float], tuple[float, float, float]]
    """The corners of the box in which robots may fly, m; enlarged to contain the present flight."""
    obstacles: tuple[tuple[tuple[float, float, float], tuple[float, float, float]], ...] = ()
    """The corners of boxes to avoid, m."""
    obstacle_distance: float = 0.1
    """The distance from them, m; closer robots keep their distance."""
    rounds: int = 5
    """The number of rounds."""
    speed: float = 2.0
    """The largest speed by axis, m/s."""
    acceleration: float = 5.0
    """The largest acceleration by axis, m/s^2."""


def smooth(flight: SplineFlight, config: SmoothingConfig) -> SplineFlight:
    """Return a flight near the given one with less acceleration, at the limits of `config`.

    Planes separate the hulls of steps, which may be closer than the robots. If robots come closer
    in a round than before, and than `config.distance`, its flight is only used for the next round.
    """
    if flight.num_steps <= FIXED:
        return flight
    safe = flight
    kept = min(config.distance, smallest_distance(flight)) - _ROUNDING
    for _ in range(config.rounds):
        flight = _round(flight, config)
        if smallest_distance(flight) >= kept:
            safe = flight
    return faster(safe, config.speed, config.acceleration)


def faster(flight: SplineFlight, speed: float, acceleration: float) -> SplineFlight:
    """Return the flight with the shortest step within speed, m/s, and acceleration, m/s^2."""
    fast, hard, _ = flight.largest()
    factor = max(fast / speed, (hard / acceleration) ** 0.5)
    return replace(flight, step_s=flight.step_s * factor) if factor > 0.0 else flight


def _round(flight: SplineFlight, config: SmoothingConfig) -> SplineFlight:
    boxes = np.array(config.obstacles, dtype=np.float64).reshape(-1, 2, 3)
    planes = (
        planes_between(flight, config.distance),
        planes_to_boxes(flight, boxes, config.obstacle_distance),
    )
    together = _join(planes)
    together = together.some(np.argsort(together.robot, kind="stable"))
    bounds = np.searchsorted(together.robot, np.arange(flight.num_robots + 1))
    cost = smoothness(len(flight.control))
    control = flight.control.copy()
    for i in range(flight.num_robots):
        own = together.some(slice(bounds[i], bounds[i + 1]))
        control[:, i] = improve(flight.control[:, i], own, *_reach(flight, i, config), cost)
    return replace(flight, control=control)


def _reach(
    flight: SplineFlight, robot: int, config: SmoothingConfig
) -> tuple[FloatArray, FloatArray]:
    """Return the bounds (F, 3) of a robot's free control points in a round."""
    control = flight.control[:, robot]
    low = np.minimum(np.array(config.box[0]), control.min(axis=0))
    high = np.maximum(np.array(config.box[1]), control.max(axis=0))
    free = control[FIXED:-FIXED]
    return np.maximum(low, free - _TRAVEL_M), np.minimum(high, free + _TRAVEL_M)
