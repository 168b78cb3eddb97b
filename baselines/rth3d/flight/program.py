"""The quadratic program of one robot's corridor, in coordinates in which its cost is a distance.

With the free control points X and the Hessian H = L L', the cost is |L' X - Y|^2 / 2, the same for
every robot and round: one factorisation serves all. Of the thousands of rows that planes and boxes
put up, few are met. They are added as the solution breaks them, which is exact when none is broken.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.linalg import solve_triangular

from swarm_envs.baselines.mlr_dmpc.solvers import solver
from swarm_envs.baselines.rth3d.flight.planes import BEZIER, Planes
from swarm_envs.state import FloatArray, IntArray

FIXED = 3
"""Control points at either end that stay: the robot rests there."""
_solve = solver("daqp")
_TOLERANCE = 1e-6
"""By which a row may be broken, m."""
_AT_ONCE = 60
"""Broken rows that are added before the program is solved again."""
_ROUNDS = 30
"""How often rows are added; what is found by then is drawn towards the old way."""


class Smoothness(NamedTuple):
    """The cost of K control points, of which the F = K - 6 in the middle are free."""

    pull: FloatArray
    """(F, K) L' times the best free points, as a function of all control points."""
    inverse: FloatArray
    """(F, F) inverse of L."""
    rows: FloatArray
    """(4 S + F, F) by row, L^-1 times the weights of a Bezier point of a step, or of a point."""


def smoothness(count: int, jerk_weight: float) -> Smoothness:
    """The cost of so many control points: squared second and third differences.

    Args:
        count: K, at least 7.
        jerk_weight: of the third differences.
    """
    eye = np.eye(count)
    second, third = np.diff(eye, n=2, axis=0), np.diff(eye, n=3, axis=0)
    hessian = second.T @ second + jerk_weight * (third.T @ third)
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
    return Smoothness(pull, inverse, np.ascontiguousarray(every @ inverse.T))


class _Rows(NamedTuple):
    """normal . point >= offset, for Bezier points and for the free control points themselves."""

    point: IntArray
    """(R,) which row of `Smoothness.rows`."""
    normal: FloatArray
    """(R, 3)."""
    offset: FloatArray
    """(R,) m."""


def _rows(planes: Planes, low: FloatArray, high: FloatArray) -> _Rows:
    """Those of planes, and of boxes (F, 3) around the free control points."""
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
    """(4 S + F, 3) Bezier points of each step, then the free control points."""
    windows = np.stack([control[k : len(control) - 3 + k] for k in range(4)], axis=1)
    bezier = np.einsum("bk,skx->sbx", BEZIER, windows).reshape(-1, 3)
    return np.concatenate([bezier, control[FIXED:-FIXED]])


def _slack(rows: _Rows, control: FloatArray) -> FloatArray:
    """(R,) by how much control points (K, 3) keep each row, m."""
    points = _points(control)[rows.point]
    return np.asarray(np.einsum("rx,rx->r", points, rows.normal) - rows.offset)


def improve(
    control: FloatArray, planes: Planes, low: FloatArray, high: FloatArray, cost: Smoothness
) -> FloatArray:
    """Better control points (K, 3) of one robot within its planes, or the same.

    Args:
        control: (K, 3) as they are; they keep every row.
        planes: the robot's.
        low: (F, 3) lower bounds of the free control points, m.
        high: (F, 3) upper bounds, m.
        cost: from `smoothness`.
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
        found = _solve(slope.ravel(), matrix.reshape(len(chosen), -1), still[chosen], active)
        if not found.solved:
            return control
        y, active = found.y.reshape(slope.shape), found.active
    return _between(rows, control, better)


def _worst(slack: FloatArray) -> IntArray:
    """The rows that are broken, or the worst of them."""
    broken = np.flatnonzero(slack < -_TOLERANCE)
    if len(broken) <= _AT_ONCE:
        return broken
    return np.asarray(broken[np.argpartition(slack[broken], _AT_ONCE)[:_AT_ONCE]])


def _between(rows: _Rows, control: FloatArray, better: FloatArray) -> FloatArray:
    """The farthest point on the way from the old to the better that keeps every row."""
    before, after = _slack(rows, control), _slack(rows, better)
    worse = after < np.minimum(before, -_TOLERANCE)
    room = np.maximum(before + _TOLERANCE, 0.0)
    share = float((room[worse] / (before - after)[worse]).min(initial=1.0))
    return np.asarray(control + share * (better - control))
