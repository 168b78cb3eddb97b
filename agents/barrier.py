"""The safety filter's kernels: barriers as inequalities on accelerations, and their solver.

Two drones with constant velocities come closer than a distance D within a time T if their relative
velocity lies in the truncated cone of van den Berg et al. (ORCA, 2011). The barrier h is the
distance of the relative velocity from this cone, m/s, negative inside. Accelerations must satisfy
dh/dt >= -rate h, to which each of the two drones contributes a share. Drones that are already
closer than D must separate along the line between them, at a speed that brings them to D within
0.3 s. Positions and velocities are predicted over the response time of a drone. Vertical distances
are scaled down, because downwash reaches far down.

The nearest acceleration that satisfies all inequalities is computed by Seidel's incremental method
(de Berg et al., Computational Geometry, ch. 4) with a quadratic objective: rows are added one after
another; if one excludes the nearest point so far, the new nearest point lies on its plane, a
problem with one dimension fewer among the previous rows. The result is exact up to rounding, and
takes a microsecond for the dozen rows of a drone.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from swarm_envs.agents.features import ObservationColumns
from swarm_envs.compiled import kernel
from swarm_envs.envs.observation import Float32Array
from swarm_envs.state import FloatArray
from swarm_envs.tasks.base import ACCELERATION_LIMIT, SPEED_LIMIT
from swarm_envs.vehicles import GRAVITY, VEHICLES

TOLERANCE = 1e-9  # Largest violation of a row of unit length that counts as rounding
_FLAT = 1e-10
_HALVINGS = 40


class Workspace(NamedTuple):
    """Memory for the problems of fewer dimensions, of at most m rows."""

    plane: FloatArray  # (m, 2) rows within a plane
    plane_bound: FloatArray  # (m,)
    line: FloatArray  # (m,) rows along a line
    line_bound: FloatArray  # (m,)
    relaxed: FloatArray  # (m,) relaxed bounds


def new_workspace(rows: int) -> Workspace:
    """Return memory for problems of at most `rows` rows."""
    return Workspace(np.zeros((rows, 2)), *(np.zeros(rows) for _ in range(4)))


@kernel
def nearest_feasible_point(
    target: FloatArray,
    rows: FloatArray,
    bound: FloatArray,
    count: int,
    work: Workspace,
    out: FloatArray,
) -> bool:
    """Write the point x nearest to a target with rows @ x >= bound; return True if it exists.

    Args:
        target: (3,).
        rows: (m, 3) of unit length.
        bound: (m,).
        count: the number of rows that are used.
        work: memory for that many rows.
        out: (3,) x; undefined if no point satisfies every row.
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
    """Return the point nearest to the plane's origin that satisfies its rows, and if it exists."""
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
    """Return the point nearest to the line's origin that satisfies its rows, and if it exists."""
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
    """Write the point nearest to a target among those that violate rows the least.

    The first `hard` rows are satisfied. The largest violation of the others is minimized by
    bisection; the result is the nearest point with that violation.

    Args:
        target: (3,).
        rows: (m, 3) of unit length.
        bound: (m,).
        hard: the number of hard constraints, which must be feasible.
        count: the number of all rows that are used.
        work: memory for that many rows.
        out: (3,) the point.

    Returns:
        The largest violation, 0 if all rows are satisfied.
    """
    if nearest_feasible_point(target, rows, bound, count, work, out):
        return 0.0
    nearest_feasible_point(target, rows, bound, hard, work, out)
    enough, short = 0.0, 0.0
    for i in range(count):
        work.relaxed[i] = bound[i]
        met = rows[i, 0] * out[0] + rows[i, 1] * out[1] + rows[i, 2] * out[2]
        enough = max(enough, bound[i] - met)
    for _ in range(_HALVINGS):
        eased = 0.5 * (short + enough)
        for i in range(hard, count):
            work.relaxed[i] = bound[i] - eased
        if nearest_feasible_point(target, rows, work.relaxed, count, work, out):
            enough = eased
        else:
            short = eased
    for i in range(hard, count):
        work.relaxed[i] = bound[i] - enough
    nearest_feasible_point(target, rows, work.relaxed, count, work, out)
    return enough


LIMITS = 6  # Rows of the limits on acceleration, which come first
WALLS = 6  # Rows of the arena's walls
ESCAPE = 0.3  # Time in which drones that are too close must be separated, s
BRAKING = 0.6 * ACCELERATION_LIMIT / SPEED_LIMIT
"""Largest speed toward a wall over the distance to it, 1/s: braking at this rate from the speed
limit takes 0.6 of the largest acceleration."""
TYPES = len(VEHICLES)
"""Length of the one-hot code of a vehicle type."""


class Barrier(NamedTuple):
    """The parameters `swarm_envs.agents.safety.Safety` for kernels."""

    margin: float
    horizon: float
    response: float
    rate: float
    share: float
    stretch: float
    aside: float
    walls: bool


class BarrierWorkspace(NamedTuple):
    """Memory of one drone's problem."""

    rows: FloatArray  # Normals of the half-spaces
    bound: FloatArray  # Their bounds
    target: FloatArray  # Desired acceleration
    out: FloatArray  # Filtered acceleration
    work: Workspace  # Memory of the solver


@kernel
def velocity_barrier(
    x: tuple[float, float, float],
    v: tuple[float, float, float],
    reach: float,
    horizon: float,
) -> tuple[float, float, float, float]:
    """Return the direction away from the velocity obstacle and the barrier h.

    Args:
        x: the other drone's position relative to the drone, m.
        v: the drone's velocity relative to the other, m/s.
        reach: the distance D to keep, m.
        horizon: the time T for which it is kept, s. Drones that are closer than D must be D apart
            after `ESCAPE`.

    Returns:
        The gradient of h with respect to v, a unit vector, and h, m/s.
    """
    square = x[0] * x[0] + x[1] * x[1] + x[2] * x[2]
    if 1e-12 < square <= reach * reach:
        away = np.sqrt(square)
        parting = -(x[0] * v[0] + x[1] * v[1] + x[2] * v[2]) / away
        return -x[0] / away, -x[1] / away, -x[2] / away, parting - (reach - away) / ESCAPE
    time = horizon if square > reach * reach else ESCAPE
    w0, w1, w2 = v[0] - x[0] / time, v[1] - x[1] / time, v[2] - x[2] / time
    size = np.sqrt(w0 * w0 + w1 * w1 + w2 * w2)
    ahead = w0 * x[0] + w1 * x[1] + w2 * x[2]
    radius = reach / time
    if square > reach * reach and not (ahead < 0.0 and ahead * ahead > reach**2 * size**2):
        along = x[0] * v[0] + x[1] * v[1] + x[2] * v[2]
        c0 = x[1] * v[2] - x[2] * v[1]
        c1 = x[2] * v[0] - x[0] * v[2]
        c2 = x[0] * v[1] - x[1] * v[0]
        cross = c0 * c0 + c1 * c1 + c2 * c2
        speed = v[0] * v[0] + v[1] * v[1] + v[2] * v[2]
        c = speed - cross / (square - reach * reach)
        t = (along + np.sqrt(max(along * along - square * c, 0.0))) / square
        w0, w1, w2 = v[0] - t * x[0], v[1] - t * x[1], v[2] - t * x[2]
        size = np.sqrt(w0 * w0 + w1 * w1 + w2 * w2)
        radius = reach * t
    if size < 1e-9:
        size = np.sqrt(square)
        return -x[0] / size, -x[1] / size, -x[2] / size, -radius
    return w0 / size, w1 / size, w2 / size, size - radius


@kernel
def step_aside(
    x: tuple[float, float, float], v: tuple[float, float, float], aside: float
) -> tuple[float, float, float]:
    """Return another drone's position shifted to the left, so that both drones pass on the right.

    The shift is horizontal and perpendicular to the relative velocity. For the other drone of the
    pair it has the opposite sign.
    """
    s0, s1 = v[1] + 1e-3 * v[2], -v[0]
    size = np.sqrt(s0 * s0 + s1 * s1)
    if size < 1e-9:
        return x
    return x[0] - aside * s0 / size, x[1] - aside * s1 / size, x[2]


@kernel
def filter_accelerations(
    observed: Float32Array,
    desired: Float32Array,
    barrier: Barrier,
    places: ObservationColumns,
    ratios: FloatArray,
    radii: FloatArray,
    arena: FloatArray,
    scratch: BarrierWorkspace,
    out: Float32Array,
    broken: FloatArray,
) -> None:
    """Write the nearest safe accelerations of drones.

    Args:
        observed: (R, row width) observation rows.
        desired: (R, 3) desired actions, in units of 5 m/s^2.
        barrier: the parameters of the filter.
        places: the columns of the rows.
        ratios: (types,) largest thrust over weight.
        radii: (types,) m.
        arena: (2, 3) corners, m.
        scratch: memory.
        out: (R, 3) the actions, in units of 5 m/s^2.
        broken: (R,) the largest violation of an inequality, m/s^2; 0 for none.
    """
    hard: Any = np.int64(LIMITS)  # Numba would compile a literal as a type of its own
    for r in range(observed.shape[0]):
        row, count = observed[r], _write_limits(scratch.rows, scratch.bound)
        kind = _type_of(row, places.type)
        own, radius = _acceleration(row, places, ratios[kind]), radii[kind]
        if barrier.walls:
            count = _write_walls(row, own, radius, barrier, places, arena, count, scratch)
        count = _write_obstacles(row, own, radius, barrier, places, count, scratch)
        count = _write_neighbors(row, own, radius, barrier, places, radii, count, scratch)
        for k in range(3):
            scratch.target[k] = ACCELERATION_LIMIT * desired[r, k]
        broken[r] = least_broken(
            scratch.target, scratch.rows, scratch.bound, hard, count, scratch.work, scratch.out
        )
        for k in range(3):
            given = scratch.out[k] / ACCELERATION_LIMIT
            out[r, k] = min(max(given, -1.0), 1.0)


@kernel
def _write_limits(rows: FloatArray, bound: FloatArray) -> int:
    for k in range(LIMITS):
        for axis in range(3):
            rows[k, axis] = 0.0
        rows[k, k // 2] = 1.0 if k % 2 == 0 else -1.0
        bound[k] = -ACCELERATION_LIMIT
    return LIMITS


@kernel
def _type_of(row: Float32Array, first: int) -> int:
    """Return the index of the vehicle type whose one-hot code begins at a column."""
    found = 0
    for k in range(TYPES):
        if row[first + k] > 0.5:
            found = k
    return found


@kernel
def _acceleration(
    row: Float32Array, places: ObservationColumns, ratio: float
) -> tuple[float, float, float]:
    """Return a drone's current acceleration by thrust and gravity, m/s^2."""
    lift, attitude = GRAVITY * ratio * row[places.thrust], places.attitude
    return lift * row[attitude + 2], lift * row[attitude + 5], lift * row[attitude + 8] - GRAVITY


@kernel
def _write_walls(
    row: Float32Array,
    own: tuple[float, float, float],
    radius: float,
    barrier: Barrier,
    places: ObservationColumns,
    arena: FloatArray,
    count: int,
    scratch: BarrierWorkspace,
) -> int:
    """Add the rows of the walls: with distance d and speed s, the barrier is BRAKING d - s."""
    delay = barrier.response
    for k in range(WALLS):
        axis, side = k // 2, 1.0 if k % 2 == 0 else -1.0
        now = own[0] if axis == 0 else own[1] if axis == 1 else own[2]
        speed = SPEED_LIMIT * row[places.velocity + axis]
        place = row[places.position + axis] + delay * (speed + 0.5 * delay * now)
        away = side * (place - arena[k % 2, axis]) - radius - 0.5 * barrier.margin
        for other in range(3):
            scratch.rows[count, other] = 0.0
        scratch.rows[count, axis] = side
        leaving = side * (speed + delay * now)
        scratch.bound[count] = -barrier.rate * (leaving + BRAKING * away)
        count += 1
    return count


@kernel
def _write_obstacles(
    row: Float32Array,
    own: tuple[float, float, float],
    radius: float,
    barrier: Barrier,
    places: ObservationColumns,
    count: int,
    scratch: BarrierWorkspace,
) -> int:
    """Add the rows of obstacles, each as a wall through its nearest point with the full margin."""
    delay = barrier.response
    for m in range(places.num_obstacles):
        first = places.obstacles + 4 * m
        square = row[first] ** 2 + row[first + 1] ** 2 + row[first + 2] ** 2
        if row[first + 3] < 0.5 or square < 1e-12:
            continue
        away, leaving, now = np.sqrt(square), 0.0, 0.0
        for axis in range(3):
            side = -row[first + axis] / away
            scratch.rows[count, axis] = side
            leaving += side * SPEED_LIMIT * row[places.velocity + axis]
            now += side * (own[0] if axis == 0 else own[1] if axis == 1 else own[2])
        away += delay * (leaving + 0.5 * delay * now) - radius - barrier.margin
        leaving += delay * now
        scratch.bound[count] = -barrier.rate * (leaving + BRAKING * away)
        count += 1
    return count


@kernel
def _write_neighbors(
    row: Float32Array,
    own: tuple[float, float, float],
    radius: float,
    barrier: Barrier,
    places: ObservationColumns,
    radii: FloatArray,
    count: int,
    scratch: BarrierWorkspace,
) -> int:
    (a0, a1, a2), delay, flat = own, barrier.response, 1.0 / barrier.stretch
    for n in range(places.num_neighbors):
        first = places.neighbors + n * places.neighbor_width
        if row[first + places.neighbor_width - 1] < 0.5:
            continue
        reach = radius + radii[_type_of(row, first + 9)] + barrier.margin
        r0 = SPEED_LIMIT * row[first + 3]
        r1 = SPEED_LIMIT * row[first + 4]
        r2 = SPEED_LIMIT * row[first + 5]
        v = (delay * a0 - r0, delay * a1 - r1, flat * (delay * a2 - r2))
        x = (
            row[first] + delay * (r0 - 0.5 * delay * a0),
            row[first + 1] + delay * (r1 - 0.5 * delay * a1),
            flat * (row[first + 2] + delay * (r2 - 0.5 * delay * a2)),
        )
        x = step_aside(x, v, barrier.aside)
        n0, n1, n2, h = velocity_barrier(x, v, reach, barrier.horizon)
        n2 *= flat
        size = np.sqrt(n0 * n0 + n1 * n1 + n2 * n2)
        scratch.rows[count, 0] = n0 / size
        scratch.rows[count, 1] = n1 / size
        scratch.rows[count, 2] = n2 / size
        scratch.bound[count] = -barrier.rate * barrier.share * h / size
        count += 1
    return count
