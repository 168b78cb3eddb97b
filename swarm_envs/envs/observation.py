"""Observations: what each drone senses, as one flat row of numbers with a documented layout.

A row is `[self | K neighbours, nearest first | M obstacles, nearest first | task]`. Its length does
not depend on the size of the team: one policy flies any number of drones. World frame throughout.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from swarm_envs.compiled import borrowing_kernel, kernel
from swarm_envs.control.state import Setpoint
from swarm_envs.physics.obstacles import nearest_point
from swarm_envs.physics.rigid_body import rotation_entries
from swarm_envs.state import BoolArray, FloatArray, IntArray, Parameters, SwarmState
from swarm_envs.tasks.base import ACCELERATION_LIMIT, SPEED_LIMIT
from swarm_envs.trajectories import Reference
from swarm_envs.vehicles import VEHICLES, Team

Float32Array = npt.NDArray[np.float32]

RATE_SCALE = 10.0
"""Body rates are observed in units of this, rad/s."""


class Field(NamedTuple):
    """One named piece of an observation row."""

    name: str
    """What it is, such as `self.velocity` or `neighbor_0.position`."""
    where: slice
    """Where it stands in the row."""
    unit: str
    """Unit of the quantity; empty if it has none."""
    scale: float
    """The quantity is the observed number times this."""


_Entries = tuple[tuple[str, int, str, float], ...]

_SELF: _Entries = (
    ("position", 3, "m", 1.0),
    ("velocity", 3, "m/s", SPEED_LIMIT),
    ("attitude", 9, "", 1.0),
    ("body_rate", 3, "rad/s", RATE_SCALE),
    ("thrust", 1, "of maximum", 1.0),
    ("setpoint_offset", 3, "m", 1.0),
    ("type", len(VEHICLES), "one-hot", 1.0),
)
_NEIGHBOR: _Entries = (
    ("position", 3, "m", 1.0),
    ("velocity", 3, "m/s", SPEED_LIMIT),
    ("goal", 3, "m", 1.0),
    ("type", len(VEHICLES), "one-hot", 1.0),
    ("mask", 1, "", 1.0),
)
_OBSTACLE: _Entries = (
    ("offset", 3, "m", 1.0),
    ("mask", 1, "", 1.0),
)
_TASK: _Entries = (
    ("goal", 3, "m", 1.0),
    ("reference_position", 3, "m", 1.0),
    ("reference_velocity", 3, "m/s", SPEED_LIMIT),
    ("reference_acceleration", 3, "m/s^2", ACCELERATION_LIMIT),
    ("time_left", 1, "of the clock", 1.0),
)
_NEIGHBOR_WIDTH = sum(width for _, width, _, _ in _NEIGHBOR)


def observation_layout(num_neighbors: int, num_obstacles: int = 0) -> tuple[Field, ...]:
    """The fields of an observation row in order.

    `self.position` is absolute; `self.attitude` the rotation matrix from body to world, row by
    row; `self.body_rate` in the body frame; `self.setpoint_offset` from the drone to the
    controller's set-point (zero for `rotors`). Neighbours' and task positions are relative to the
    drone, a neighbour's velocity too; its `goal` is relative to itself. Where there are fewer than
    K neighbours, `mask` is 0 and the rest zero. `obstacle_k.offset` leads from the drone to the
    nearest point of an obstacle, for the nearest M of them; with M = 0 there are no such fields.
    Where a task gives no reference, it rests at the
    goal; that of a stacked swap never moves vertically.
    """
    groups: list[tuple[str, _Entries]] = [("self", _SELF)]
    groups += [(f"neighbor_{k}", _NEIGHBOR) for k in range(num_neighbors)]
    groups += [(f"obstacle_{k}", _OBSTACLE) for k in range(num_obstacles)]
    groups += [("task", _TASK)]
    fields, start = [], 0
    for group, entries in groups:
        for name, width, unit, scale in entries:
            fields.append(Field(f"{group}.{name}", slice(start, start + width), unit, scale))
            start += width
    return tuple(fields)


def observation_width(num_neighbors: int, num_obstacles: int = 0) -> int:
    """Length of an observation row."""
    return observation_layout(num_neighbors, num_obstacles)[-1].where.stop


def type_codes(team: Team) -> FloatArray:
    """One-hot (N, types) code of each vehicle, in the order of `VEHICLES`; zeros for others."""
    tokens = list(VEHICLES)
    code = np.zeros((len(team), len(tokens)))
    for i, vehicle in enumerate(team):
        if vehicle.token in tokens:
            code[i, tokens.index(vehicle.token)] = 1.0
    return code


@borrowing_kernel
def nearest(e: int, i: int, position: FloatArray, order: IntArray, distance: FloatArray) -> int:
    """List the nearest other drones of drone `i`, nearest first; return how many there are.

    Args:
        e: the environment.
        i: the drone.
        position: (E, N, 3) m.
        order: (K,) indices, written.
        distance: (K,) squared distances, m^2, written.
    """
    found = 0
    for j in range(position.shape[1]):
        if j == i:
            continue
        d = 0.0
        for k in range(3):
            d += (position[e, j, k] - position[e, i, k]) ** 2
        place = found
        while place > 0 and distance[place - 1] > d:
            place -= 1
        if place < order.shape[0]:
            found = min(found + 1, order.shape[0])
            for k in range(found - 1, place, -1):
                order[k], distance[k] = order[k - 1], distance[k - 1]
            order[place], distance[place] = j, d
    return found


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


@kernel
def write_observations(
    state: SwarmState,
    parameters: Parameters,
    setpoint: Setpoint,
    direct: bool,
    goal: FloatArray,
    reference: Reference,
    time_left: FloatArray,
    code: FloatArray,
    num_neighbors: int,
    obstacles: FloatArray,
    num_obstacles: int,
    mask: BoolArray,
    out: Float32Array,
) -> None:
    """Write the observation rows of every environment in the mask.

    Args:
        state: of the swarm.
        parameters: of the drones.
        setpoint: of the controller.
        direct: whether there is no controller, so that set-points mean nothing.
        goal: (E, N, 3) m.
        reference: arrays (E, N, 3).
        time_left: (E,) share of the clock.
        code: (N, types) one-hot types.
        num_neighbors: K.
        obstacles: (M', 7) rows of `swarm_envs.physics.obstacles`.
        num_obstacles: M.
        mask: (E,) environments to write.
        out: (E, N, width) rows.
    """
    order, distance = np.empty(num_neighbors, np.int64), np.empty(num_neighbors)
    width = 10 + code.shape[1]
    for e in range(out.shape[0]):
        if not mask[e]:
            continue
        for i in range(out.shape[1]):
            row = out[e, i]
            start = write_self(e, i, state, parameters, setpoint, direct, code, row)
            found = nearest(e, i, state.position, order, distance)
            for k in range(num_neighbors):
                if k < found:
                    write_neighbor(e, i, order[k], state, goal, code, row[start:])
                else:
                    row[start : start + width] = 0.0
                start += width
            if num_obstacles > 0:
                seen = write_obstacles(e, i, state.position, obstacles, num_obstacles, row[start:])
                start += seen
            write_task(e, i, state, goal, reference, time_left[e], row[start:])
