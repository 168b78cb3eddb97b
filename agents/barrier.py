"""What keeps drones apart, as inequalities on one drone's acceleration: a barrier of velocities.

Two drones that fly on as they do come closer than a distance D within a time T if their relative
velocity lies in the truncated cone of van den Berg et al. (ORCA, 2011). The barrier h is how far
outside it lies, m/s, and negative inside; a drone's acceleration must keep dh/dt >= -rate h, of
which each of the two takes half. Positions and velocities are predicted over the time that a drone
takes to respond, and heights may count less than widths: downwash reaches far down.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from swarm_envs.agents.nearest import Workspace, least_broken
from swarm_envs.compiled import kernel
from swarm_envs.envs.observation import Float32Array
from swarm_envs.state import FloatArray
from swarm_envs.tasks.base import ACCELERATION_LIMIT, SPEED_LIMIT
from swarm_envs.vehicles import GRAVITY, VEHICLES

LIMITS = 6
"""Rows of the limits on acceleration, which come first."""
WALLS = 6
"""Rows of the arena's walls."""
ESCAPE = 0.3
"""Time in which drones that are closer than they should be are to be apart again, s."""
BRAKING = 0.6 * ACCELERATION_LIMIT / SPEED_LIMIT
"""Speed towards a wall over the distance to it, 1/s: to slow down like this from the largest speed
takes 0.6 of the largest acceleration."""
TYPES = len(VEHICLES)
"""Length of the code of a type."""


class Barrier(NamedTuple):
    """What the kernels are told; `swarm_envs.agents.safety.Safety` says what each is for."""

    margin: float
    """Distance beyond the sum of radii, m."""
    horizon: float
    """How far ahead it is kept, s."""
    response: float
    """Time until a drone does what it is told, s."""
    rate: float
    """Share of h that may be used up a second, 1/s."""
    share: float
    """Of each evasion, the part that is this drone's."""
    stretch: float
    """By how much less heights count than widths."""
    aside: float
    """How far to the left neighbours are taken to be, m."""
    walls: bool
    """Whether walls count."""


class Places(NamedTuple):
    """Where an observation row has what is needed."""

    position: int
    """First column of the own position."""
    velocity: int
    """First column of the own velocity."""
    attitude: int
    """First column of the own attitude."""
    thrust: int
    """Column of the own thrust."""
    type: int
    """First column of the own type."""
    neighbors: int
    """First column of the nearest neighbour."""
    neighbor_width: int
    """Columns of a neighbour."""
    num_neighbors: int
    """Neighbours that a row has."""


class Scratch(NamedTuple):
    """Memory of one drone's problem."""

    rows: FloatArray
    """Normals of the half-spaces."""
    bound: FloatArray
    """Their bounds."""
    target: FloatArray
    """What is asked for."""
    out: FloatArray
    """What is done."""
    work: Workspace
    """Memory of the solver."""


@kernel
def velocity_barrier(
    x: tuple[float, float, float],
    v: tuple[float, float, float],
    reach: float,
    horizon: float,
) -> tuple[float, float, float, float]:
    """How far a relative velocity is from collision, and the direction that leads away.

    Args:
        x: the other's position relative to one's own, m.
        v: one's own velocity relative to the other, m/s.
        reach: distance D to keep, m.
        horizon: T, for which it is to be kept, s.

    Returns:
        The unit vector along which v leaves the cone, or goes deeper into what is outside, and h.
    """
    square = x[0] * x[0] + x[1] * x[1] + x[2] * x[2]
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
    """See another drone a little to the left, so that both of a pair pass on the right.

    The side is horizontal and at right angles to the relative velocity; where that is vertical,
    along x. Seen from the other it is the opposite one.
    """
    s0, s1 = v[1] + 1e-3 * v[2], -v[0]
    size = np.sqrt(s0 * s0 + s1 * s1)
    if size < 1e-9:
        return x
    return x[0] - aside * s0 / size, x[1] - aside * s1 / size, x[2]


@kernel
def filter_accelerations(
    observed: Float32Array,
    asked: Float32Array,
    barrier: Barrier,
    places: Places,
    ratios: FloatArray,
    radii: FloatArray,
    arena: FloatArray,
    scratch: Scratch,
    out: Float32Array,
    broken: FloatArray,
) -> None:
    """Write the nearest safe accelerations of drones.

    Args:
        observed: (R, row width) observation rows.
        asked: (R, 3) actions, over 5 m/s^2.
        barrier: what is kept.
        places: of the rows.
        ratios: (types,) largest thrust over weight.
        radii: (types,) m.
        arena: (2, 3) corners, m.
        scratch: memory.
        out: (R, 3) where to write actions, over 5 m/s^2.
        broken: (R,) by how much the worst row is broken, m/s^2; 0 if none is.
    """
    for r in range(observed.shape[0]):
        count = _write_limits(scratch.rows, scratch.bound)
        if barrier.walls:
            count = _write_walls(observed[r], barrier, places, ratios, radii, arena, count, scratch)
        count = _write_neighbors(observed[r], barrier, places, ratios, radii, count, scratch)
        for k in range(3):
            scratch.target[k] = ACCELERATION_LIMIT * asked[r, k]
        broken[r] = least_broken(
            scratch.target, scratch.rows, scratch.bound, LIMITS, count, scratch.work, scratch.out
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
    """Index of the type whose code, one-hot, begins there."""
    found = 0
    for k in range(TYPES):
        if row[first + k] > 0.5:
            found = k
    return found


@kernel
def _acceleration(row: Float32Array, places: Places, ratio: float) -> tuple[float, float, float]:
    """What a drone's thrust and weight give it now, m/s^2."""
    lift, attitude = GRAVITY * ratio * row[places.thrust], places.attitude
    return lift * row[attitude + 2], lift * row[attitude + 5], lift * row[attitude + 8] - GRAVITY


@kernel
def _write_walls(
    row: Float32Array,
    barrier: Barrier,
    places: Places,
    ratios: FloatArray,
    radii: FloatArray,
    arena: FloatArray,
    count: int,
    scratch: Scratch,
) -> int:
    """A wall at distance d, towards which the speed is s: the barrier is BRAKING d - s."""
    kind, delay = _type_of(row, places.type), barrier.response
    own = _acceleration(row, places, ratios[kind])
    for k in range(WALLS):
        axis, side = k // 2, 1.0 if k % 2 == 0 else -1.0
        now = own[0] if axis == 0 else own[1] if axis == 1 else own[2]
        speed = SPEED_LIMIT * row[places.velocity + axis]
        place = row[places.position + axis] + delay * (speed + 0.5 * delay * now)
        away = side * (place - arena[k % 2, axis]) - radii[kind] - 0.5 * barrier.margin
        for other in range(3):
            scratch.rows[count, other] = 0.0
        scratch.rows[count, axis] = side
        leaving = side * (speed + delay * now)
        scratch.bound[count] = -barrier.rate * (leaving + BRAKING * away)
        count += 1
    return count


@kernel
def _write_neighbors(
    row: Float32Array,
    barrier: Barrier,
    places: Places,
    ratios: FloatArray,
    radii: FloatArray,
    count: int,
    scratch: Scratch,
) -> int:
    kind = _type_of(row, places.type)
    a0, a1, a2 = _acceleration(row, places, ratios[kind])
    delay, flat = barrier.response, 1.0 / barrier.stretch
    for n in range(places.num_neighbors):
        first = places.neighbors + n * places.neighbor_width
        if row[first + places.neighbor_width - 1] < 0.5:
            continue
        reach = radii[kind] + radii[_type_of(row, first + 9)] + barrier.margin
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
