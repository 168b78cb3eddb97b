"""Writing observation rows: the kernels behind the layout of `swarm_envs.envs.observation`."""

from __future__ import annotations

import numpy as np

from swarm_envs.compiled import borrowing_kernel
from swarm_envs.control.state import Setpoint
from swarm_envs.envs.observation import RATE_SCALE, Float32Array
from swarm_envs.neighbors import FEW, nearest, sort_along_x
from swarm_envs.physics.obstacles import nearest_point
from swarm_envs.physics.rigid_body import rotation_entries
from swarm_envs.state import BoolArray, FloatArray, IntArray, Parameters, SwarmState
from swarm_envs.tasks.base import ACCELERATION_LIMIT, SPEED_LIMIT
from swarm_envs.trajectories import Reference


@borrowing_kernel
def write_self(
    e: int,
    i: int,
    state: SwarmState,
    parameters: Parameters,
    setpoint: Setpoint,
    direct: bool,
    code: FloatArray,
    row: Float32Array,
) -> int:
    """Write the `self` fields of drone `i`; return where they end."""
    p, v, q = state.position, state.velocity, state.quaternion
    w, f = state.angular_velocity, state.rotor_thrust
    r = rotation_entries(q[e, i, 0], q[e, i, 1], q[e, i, 2], q[e, i, 3])
    for k in range(3):
        row[k] = p[e, i, k]
        row[3 + k] = v[e, i, k] / SPEED_LIMIT
        row[19 + k] = 0.0 if direct else setpoint.position[e, i, k] - p[e, i, k]
    for k in range(9):
        row[6 + k] = r[k]
    x, y, z = w[e, i, 0] / RATE_SCALE, w[e, i, 1] / RATE_SCALE, w[e, i, 2] / RATE_SCALE
    row[15] = r[0] * x + r[3] * y + r[6] * z
    row[16] = r[1] * x + r[4] * y + r[7] * z
    row[17] = r[2] * x + r[5] * y + r[8] * z
    total = f[e, i, 0] + f[e, i, 1] + f[e, i, 2] + f[e, i, 3]
    row[18] = total / (4.0 * parameters.max_rotor_thrust[e, i])
    for k in range(code.shape[1]):
        row[22 + k] = code[i, k]
    return 22 + code.shape[1]


@borrowing_kernel
def write_neighbor(
    e: int,
    i: int,
    j: int,
    state: SwarmState,
    goal: FloatArray,
    code: FloatArray,
    row: Float32Array,
) -> None:
    """Write the fields of neighbour `j` as seen from drone `i`."""
    p, v = state.position, state.velocity
    for k in range(3):
        row[k] = p[e, j, k] - p[e, i, k]
        row[3 + k] = (v[e, j, k] - v[e, i, k]) / SPEED_LIMIT
        row[6 + k] = goal[e, j, k] - p[e, j, k]
    for k in range(code.shape[1]):
        row[9 + k] = code[j, k]
    row[9 + code.shape[1]] = 1.0


@borrowing_kernel
def write_obstacles(
    e: int, i: int, position: FloatArray, obstacles: FloatArray, places: int, row: Float32Array
) -> int:
    """Write the fields of the obstacles nearest to drone `i`; return where they end."""
    x, y, z = position[e, i, 0], position[e, i, 1], position[e, i, 2]
    for k in range(4 * places):
        row[k] = 0.0
    reached = -1.0
    last = -1
    for place in range(min(places, obstacles.shape[0])):
        nearest_square, chosen = np.inf, -1
        for m in range(obstacles.shape[0]):
            dx, dy, dz = nearest_point(obstacles, m, x, y, z)
            square = dx * dx + dy * dy + dz * dz
            later = square > reached or (square == reached and m > last)
            if later and square < nearest_square:
                nearest_square, chosen = square, m
        reached, last = nearest_square, chosen
        k = 4 * place
        row[k], row[k + 1], row[k + 2] = nearest_point(obstacles, chosen, x, y, z)
        row[k + 3] = 1.0
    return 4 * places


@borrowing_kernel
def write_task(
    e: int,
    i: int,
    state: SwarmState,
    goal: FloatArray,
    reference: Reference,
    time_left: float,
    row: Float32Array,
) -> None:
    """Write the `task` fields of drone `i`."""
    p = state.position
    for k in range(3):
        row[k] = goal[e, i, k] - p[e, i, k]
        row[3 + k] = reference.position[e, i, k] - p[e, i, k]
        row[6 + k] = reference.velocity[e, i, k] / SPEED_LIMIT
        row[9 + k] = reference.acceleration[e, i, k] / ACCELERATION_LIMIT
    row[12] = time_left


@borrowing_kernel
def write_observations(
    first: int,
    last: int,
    mask: BoolArray,
    out: Float32Array,
    state: SwarmState,
    parameters: Parameters,
    setpoint: Setpoint,
    direct: bool,
    goal: FloatArray,
    reference: Reference,
    time: FloatArray,
    horizon_s: float,
    code: FloatArray,
    order: IntArray,
    obstacles: FloatArray,
    num_obstacles: int,
    others: IntArray,
    square: FloatArray,
) -> None:
    """Write the observation rows of the environments first to last - 1 that are in the mask.

    Args:
        first: the first environment to look at.
        last: one past the last.
        mask: (E,) environments to write.
        out: (E, N, width) rows.
        state: of the swarm.
        parameters: of the drones.
        setpoint: of the controller.
        direct: whether there is no controller, so that set-points mean nothing.
        goal: (E, N, 3) m.
        reference: arrays (E, N, 3).
        time: (E,) s.
        horizon_s: the clock, s.
        code: (E, N, types) one-hot types.
        order: (E, N) any permutation of the drones, sorted in place where they are many.
        obstacles: (M', 7) rows of `swarm_envs.physics.obstacles`.
        num_obstacles: M.
        others: (K,) scratch: for so many neighbours.
        square: (K,) scratch.
    """
    many, width = out.shape[1] > FEW, 10 + code.shape[2]
    for e in range(first, last):
        if not mask[e]:
            continue
        types, position = code[e], state.position[e]
        time_left = max(1.0 - time[e] / horizon_s, 0.0)
        if many:
            sort_along_x(position, order[e])
        for place in range(out.shape[1]):
            i = order[e, place] if many else place
            row = out[e, i]
            start = write_self(e, i, state, parameters, setpoint, direct, types, row)
            found = nearest(i, place if many else -1, position, order[e], others, square)
            for k in range(others.shape[0]):
                if k < found:
                    write_neighbor(e, i, others[k], state, goal, types, row[start:])
                else:
                    row[start : start + width] = 0.0
                start += width
            if num_obstacles > 0:
                seen = write_obstacles(e, i, state.position, obstacles, num_obstacles, row[start:])
                start += seen
            write_task(e, i, state, goal, reference, time_left, row[start:])
