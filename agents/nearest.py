"""The nearest point that satisfies a few linear inequalities in space, compiled.

Seidel's incremental method (de Berg et al., Computational Geometry, ch. 4), for a quadratic goal:
rows are added one after another; where one cuts off the nearest point so far, the new one lies on
its plane, a problem with one dimension fewer among the rows before it. Exact up to rounding, and a
microsecond for the dozen rows of a drone.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from swarm_envs.compiled import kernel
from swarm_envs.state import FloatArray

TOLERANCE = 1e-9
"""By how much a row of unit length may be broken, from rounding."""
_FLAT = 1e-10
_HALVINGS = 40


class Workspace(NamedTuple):
    """Memory for the problems of fewer dimensions, with room for so many rows."""

    plane: FloatArray
    """(m, 2) rows within a plane."""
    plane_bound: FloatArray
    """(m,)."""
    line: FloatArray
    """(m,) rows along a line."""
    line_bound: FloatArray
    """(m,)."""
    relaxed: FloatArray
    """(m,) bounds that have been eased."""


def new_workspace(rows: int) -> Workspace:
    """Memory for problems of so many rows."""
    return Workspace(np.zeros((rows, 2)), *(np.zeros(rows) for _ in range(4)))


@kernel
def nearest_point(
    target: FloatArray,
    rows: FloatArray,
    bound: FloatArray,
    count: int,
    work: Workspace,
    out: FloatArray,
) -> bool:
    """Write the point x (3,) nearest to a target with rows @ x >= bound; whether there is one.

    Args:
        target: (3,).
        rows: (m, 3) of unit length.
        bound: (m,).
        count: how many rows hold.
        work: room for as many.
        out: (3,) where to write; undefined if no point satisfies every row.
    """
    out[0], out[1], out[2] = target[0], target[1], target[2]
    for i in range(count):
        n0, n1, n2 = rows[i, 0], rows[i, 1], rows[i, 2]
        if n0 * out[0] + n1 * out[1] + n2 * out[2] >= bound[i] - TOLERANCE:
            continue
        gap = bound[i] - (n0 * target[0] + n1 * target[1] + n2 * target[2])
        p0, p1, p2 = target[0] + gap * n0, target[1] + gap * n1, target[2] + gap * n2
        # Two axes of the plane (Duff et al. 2017, Building an Orthonormal Basis, Revisited).
        sign = 1.0 if n2 >= 0.0 else -1.0
        a = -1.0 / (sign + n2)
        b = n0 * n1 * a
        u0, u1, u2 = 1.0 + sign * n0 * n0 * a, sign * b, -sign * n0
        v0, v1, v2 = b, sign + n1 * n1 * a, -n1
        for j in range(i):
            r0, r1, r2 = rows[j, 0], rows[j, 1], rows[j, 2]
            work.plane[j, 0] = r0 * u0 + r1 * u1 + r2 * u2
            work.plane[j, 1] = r0 * v0 + r1 * v1 + r2 * v2
            work.plane_bound[j] = bound[j] - (r0 * p0 + r1 * p1 + r2 * p2)
        s, t, found = _nearest_in_plane(i, work)
        if not found:
            return False
        out[0] = p0 + s * u0 + t * v0
        out[1] = p1 + s * u1 + t * v1
        out[2] = p2 + s * u2 + t * v2
    return True


@kernel
def _nearest_in_plane(count: int, work: Workspace) -> tuple[float, float, bool]:
    """The point nearest to the plane's origin that satisfies its rows, if there is one."""
    x, y = 0.0, 0.0
    rows, bound = work.plane, work.plane_bound
    for i in range(count):
        if rows[i, 0] * x + rows[i, 1] * y >= bound[i] - TOLERANCE:
            continue
        size = np.sqrt(rows[i, 0] ** 2 + rows[i, 1] ** 2)
        if size < _FLAT:
            return 0.0, 0.0, False
        n0, n1, offset = rows[i, 0] / size, rows[i, 1] / size, bound[i] / size
        for j in range(i):
            work.line[j] = rows[j, 1] * n0 - rows[j, 0] * n1
            work.line_bound[j] = bound[j] - offset * (rows[j, 0] * n0 + rows[j, 1] * n1)
        s, found = _nearest_on_line(i, work)
        if not found:
            return 0.0, 0.0, False
        x, y = offset * n0 - s * n1, offset * n1 + s * n0
    return x, y, True


@kernel
def _nearest_on_line(count: int, work: Workspace) -> tuple[float, bool]:
    """The point nearest to the line's origin that satisfies its rows, if there is one."""
    low, high = -np.inf, np.inf
    for i in range(count):
        slope, bound = work.line[i], work.line_bound[i]
        if slope > _FLAT:
            low = max(low, bound / slope)
        elif slope < -_FLAT:
            high = min(high, bound / slope)
        elif bound > TOLERANCE:
            return 0.0, False
    if low > high + TOLERANCE:
        return 0.0, False
    return min(max(0.0, low), high), True


@kernel
def least_broken(
    target: FloatArray,
    rows: FloatArray,
    bound: FloatArray,
    hard: int,
    count: int,
    work: Workspace,
    out: FloatArray,
) -> float:
    """Write the nearest point to a target among those that break rows the least.

    The first rows always hold; of the others the largest violation is the least that can be, which
    is found by halving; then the nearest such point is taken.

    Args:
        target: (3,).
        rows: (m, 3) of unit length.
        bound: (m,).
        hard: how many of the first rows are never broken; a point must satisfy them.
        count: how many rows there are in all.
        work: room for as many.
        out: (3,) where to write.

    Returns:
        By how much the worst row is broken: 0 if none is.
    """
    if nearest_point(target, rows, bound, count, work, out):
        return 0.0
    nearest_point(target, rows, bound, hard, work, out)
    enough, short = 0.0, 0.0
    for i in range(count):
        work.relaxed[i] = bound[i]
        met = rows[i, 0] * out[0] + rows[i, 1] * out[1] + rows[i, 2] * out[2]
        enough = max(enough, bound[i] - met)
    for _ in range(_HALVINGS):
        eased = 0.5 * (short + enough)
        for i in range(hard, count):
            work.relaxed[i] = bound[i] - eased
        if nearest_point(target, rows, work.relaxed, count, work, out):
            enough = eased
        else:
            short = eased
    for i in range(hard, count):
        work.relaxed[i] = bound[i] - enough
    nearest_point(target, rows, work.relaxed, count, work, out)
    return enough
