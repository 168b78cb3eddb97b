"""Observations: one flat row of numbers for each drone, with a documented layout.

A row is `[self | K neighbors, nearest first | M obstacles, nearest first | task]`. Its length does
not depend on the size of the team, so that one policy controls any number of drones. Quantities
are in the world frame, except body rates.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from gymnasium import spaces

from swarm_envs.compiled import kernel, part
from swarm_envs.neighbors import nearest, nearest_sorted, sort_along_x
from swarm_envs.noise import normal
from swarm_envs.physics.contact import nearest_point
from swarm_envs.physics.rigid_body import rotation_entries
from swarm_envs.physics.step import SETPOINTS
from swarm_envs.state import BoolArray, FloatArray, IntArray
from swarm_envs.tables import Record, Records
from swarm_envs.tasks.base import ACCELERATION_LIMIT, SPEED_LIMIT
from swarm_envs.vehicles import GRAVITY, SMALL, VEHICLES

__all__ = [
    "Float32Array",
    "ObservationField",
    "observation_layout",
    "observation_space",
    "observation_width",
    "shaper",
]

Float32Array = npt.NDArray[np.float32]
"""An array of observations."""

_SMALL_MASS = SMALL.mass
RATE_SCALE = 10.0  # Body rates are observed in units of this, rad/s


class ObservationField(NamedTuple):
    """A field of an observation row."""

    name: str
    """The name, such as `self.velocity` or `neighbor_0.position`."""
    where: slice
    """The field's columns in the row."""
    unit: str
    """The unit of the quantity; empty if it has none."""
    scale: float
    """The factor from the observed number to the quantity."""


_Entries = tuple[tuple[str, int, str, float], ...]
# Trained policies store names and units of their layout, and refuse others: change no word here

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
_LOAD: _Entries = (
    ("thrust_margin", 1, "of the weight", 1.0),
    ("mass_ratio", 1, "of a small drone", 1.0),
    ("battery", 1, "of full", 1.0),
)
_FORCE: _Entries = (("force", 3, "of the weight", 1.0),)
_SETPOINT: _Entries = (
    ("setpoint_velocity", 3, "m/s", SPEED_LIMIT),
    ("setpoint_acceleration", 3, "m/s^2", ACCELERATION_LIMIT),
)
_OBSTACLE: _Entries = (("offset", 3, "m", 1.0), ("mask", 1, "", 1.0))
_TASK: _Entries = (
    ("goal", 3, "m", 1.0),
    ("reference_position", 3, "m", 1.0),
    ("reference_velocity", 3, "m/s", SPEED_LIMIT),
    ("reference_acceleration", 3, "m/s^2", ACCELERATION_LIMIT),
    ("time_left", 1, "of the clock", 1.0),
)


@cache
def observation_layout(
    num_neighbors: int,
    num_obstacles: int = 0,
    load: bool = False,
    force: bool = False,
    setpoint: bool = False,
) -> tuple[ObservationField, ...]:
    """Return the fields of an observation row in order.

    `self.position` is absolute. `self.attitude` is the rotation matrix from body to world, row by
    row. `self.body_rate` is in the body frame. `self.setpoint_offset` is the vector from the drone
    to the controller's set-point (zero for `ctbr` and `rotors`). Positions and velocities of
    neighbors, and positions of the task, are relative to the drone; a neighbor's `goal` is relative
    to that neighbor. With fewer than K neighbors, `mask` and all other fields of the missing ones
    are 0. `obstacle_k.offset` is the vector from the drone to the nearest point of an obstacle, for
    the M nearest obstacles. In a task without a reference, the reference rests at the goal; that of
    a stacked swap never moves vertically.

    With `load`, a drone and its neighbors have three more fields: `thrust_margin`, the largest
    thrust at this charge over the weight, less 1; `mass_ratio`, the mass over 34 g; `battery`, the
    charge. The mass is the controller's nominal one. With `force`, `self.force` is the aerodynamic
    force on the drone that a model predicts, over its weight, in the world frame. With `setpoint`,
    there are the velocity and acceleration of the controller's set-point, which are exact where the
    drone's own are measured with noise; `ctbr` and `rotors` have no set-point.
    """
    extra = (_LOAD if load else ()) + (_FORCE if force else ()) + (_SETPOINT if setpoint else ())
    neighbor = (*_NEIGHBOR[:-1], *(_LOAD if load else ()), _NEIGHBOR[-1])
    groups: list[tuple[str, _Entries]] = [("self", _SELF + extra)]
    groups += [(f"neighbor_{k}", neighbor) for k in range(num_neighbors)]
    groups += [(f"obstacle_{k}", _OBSTACLE) for k in range(num_obstacles)]
    groups += [("task", _TASK)]
    fields, start = [], 0
    for group, entries in groups:
        for name, width, unit, scale in entries:
            fields.append(
                ObservationField(f"{group}.{name}", slice(start, start + width), unit, scale)
            )
            start += width
    return tuple(fields)


def observation_width(num_neighbors: int, *more: Any) -> int:
    """Return the length of an observation row; arguments as for `observation_layout`."""
    return observation_layout(num_neighbors, *more)[-1].where.stop


FORMS = ("flat", "dict")  # Names of the forms

Observation = Any  # The observation of one drone: a float32 row, or a dictionary of float32 arrays

_SETS = {"neighbors": ("neighbor_", "mask"), "obstacles": ("obstacle_", "obstacle_mask")}
"""Repeated groups of fields: the prefix of their names, and the name of their mask."""


def observation_space(
    form: str, num_neighbors: int, num_obstacles: int = 0, *more: bool
) -> spaces.Space[Any]:
    """Return the space of one drone's observation: a Box, or a Dict of Boxes.

    The dictionary has `self` (width,), `neighbors` (K, width), nearest first, `mask` (K,), 1 where
    there is a neighbor, and `task` (width,). If obstacles are observed, it also has `obstacles`
    (M, 3) and `obstacle_mask` (M,). See `observation_layout` for the fields.
    """
    row = np.zeros(observation_width(num_neighbors, num_obstacles, *more), np.float32)
    if form == "flat":
        return _box(row)
    parts = shaper(form, num_neighbors, num_obstacles, *more)(row)
    return spaces.Dict({name: _box(part, "mask" in name) for name, part in parts.items()})


def shaper(
    form: str, num_neighbors: int, num_obstacles: int = 0, *more: bool
) -> Callable[[Float32Array], Observation]:
    """Return a function from rows (..., width) to observations of a form, which are views."""
    if form == "flat":
        return lambda rows: rows
    layout = observation_layout(num_neighbors, num_obstacles, *more)
    own, task = _span("self.", layout), _span("task.", layout)
    counts = {"neighbors": num_neighbors, "obstacles": num_obstacles}
    one = observation_layout(1, 1, *more)
    spans = {
        name: (_span(_SETS[name][0], layout), _span(_SETS[name][0], one))
        for name, count in counts.items()
        if count or name == "neighbors"
    }

    def shape(rows: Float32Array) -> Observation:
        parts = {"self": rows[..., own], "task": rows[..., task]}
        for name, (where, member) in spans.items():
            width = member.stop - member.start - 1  # without the mask, which is last
            group = rows[..., where].reshape(*rows.shape[:-1], counts[name], width + 1)
            parts[name], parts[_SETS[name][1]] = group[..., :width], group[..., width]
        return parts

    return shape


def _span(prefix: str, layout: tuple[ObservationField, ...]) -> slice:
    """Return the columns of all fields with a prefix; an empty slice if there are none."""
    found = [field.where for field in layout if field.name.startswith(prefix)]
    return slice(found[0].start, found[-1].stop) if found else slice(0, 0)


def _box(part: Float32Array, mask: bool = False) -> spaces.Box:
    low, high = (0.0, 1.0) if mask else (-np.inf, np.inf)
    return spaces.Box(low, high, part.shape, np.float32)


_PER_DRONE = 12  # Random numbers for the noise of a drone in a decision


@kernel
def sense(
    first: int,
    last: int,
    drones: Records,
    environments: Records,
    settings: Records,
    mask: BoolArray,
    out: Records,
) -> None:
    """Write the state with measurement noise; rotor thrusts and charges are exact.

    Args:
        first: index of the first environment.
        last: one past that of the last.
        drones: (E, N) records: the true state.
        environments: (E,) records; each decision has its own noise.
        settings: (1,) record with the standard deviations per component of position (m), velocity
            (m/s), attitude (rad) and body rate (rad/s).
        mask: (E,) environments to measure.
        out: (E, N) records, written.
    """
    noise, size = settings[0].noise, drones.shape[1]
    for e in range(first, last):
        if not mask[e]:
            continue
        key, scale = environments[e].noise_key, environments[e].noise_scale
        at_position, at_velocity = scale * noise[0], scale * noise[1]
        half, at_rate = 0.5 * scale * noise[2], scale * noise[3]
        for i in range(size):
            at = (environments[e].decisions * size + i) * _PER_DRONE
            d, o = drones[e, i], out[e, i]
            for k in range(3):
                p, v = normal(key, np.uint64(at + k)), normal(key, np.uint64(at + 3 + k))
                w = normal(key, np.uint64(at + 9 + k))
                o.position[k] = d.position[k] + at_position * p
                o.velocity[k] = d.velocity[k] + at_velocity * v
                o.angular_velocity[k] = d.angular_velocity[k] + at_rate * w
            tx = half * normal(key, np.uint64(at + 6))
            ty = half * normal(key, np.uint64(at + 7))
            tz = half * normal(key, np.uint64(at + 8))
            x, y, z, w = d.quaternion[0], d.quaternion[1], d.quaternion[2], d.quaternion[3]
            q = o.quaternion
            q[0] = x + tx * w + ty * z - tz * y
            q[1] = y - tx * z + ty * w + tz * x
            q[2] = z + tx * y - ty * x + tz * w
            q[3] = w - tx * x - ty * y - tz * z
            norm = np.sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3])
            for k in range(4):
                q[k] /= norm
                o.rotor_thrust[k] = d.rotor_thrust[k]
            o.battery, o.rotor_limit = d.battery, d.rotor_limit


@part
def write_self(seen: Record, drone: Record, direct: bool, row: Float32Array) -> int:
    """Write the `self` fields of a drone; return the index after them.

    Args:
        seen: its measured record.
        drone: its true record.
        direct: True if the action mode has no set-point.
        row: written.
    """
    p, v, q, w = seen.position, seen.velocity, seen.quaternion, seen.angular_velocity
    f = seen.rotor_thrust
    r = rotation_entries(q[0], q[1], q[2], q[3])
    for k in range(3):
        row[k] = p[k]
        row[3 + k] = v[k] / SPEED_LIMIT
        row[19 + k] = 0.0 if direct else drone.setpoint_position[k] - p[k]
        row[22 + k] = drone.type_code[k]
    row[6], row[7], row[8], row[9], row[10], row[11], row[12], row[13], row[14] = r
    x, y, z = w[0] / RATE_SCALE, w[1] / RATE_SCALE, w[2] / RATE_SCALE
    row[15] = r[0] * x + r[3] * y + r[6] * z
    row[16] = r[1] * x + r[4] * y + r[7] * z
    row[17] = r[2] * x + r[5] * y + r[8] * z
    row[18] = (f[0] + f[1] + f[2] + f[3]) / (4.0 * drone.max_rotor_thrust)
    return 25


@part
def write_load(seen: Record, drone: Record, row: Float32Array, at: int) -> int:
    """Write thrust margin, mass and charge of a drone from `at` on; return the index after them."""
    row[at] = 4.0 * seen.rotor_limit / (drone.nominal_mass * GRAVITY) - 1.0
    row[at + 1] = drone.nominal_mass / _SMALL_MASS
    row[at + 2] = seen.battery
    return at + 3


@part
def write_setpoint(drone: Record, row: Float32Array, at: int) -> int:
    """Write the set-point's velocity and acceleration from `at` on; return the index after them."""
    for k in range(3):
        row[at + k] = drone.setpoint_velocity[k] / SPEED_LIMIT
        row[at + 3 + k] = drone.setpoint_acceleration[k] / ACCELERATION_LIMIT
    return at + 6


@part
def write_task(seen: Record, drone: Record, row: Float32Array, at: int) -> None:
    """Write a drone's goal and reference, relative to its measured position, from `at` on."""
    for k in range(3):
        row[at + k] = drone.goal[k] - seen.position[k]
        row[at + 3 + k] = drone.reference_position[k] - seen.position[k]
        row[at + 6 + k] = drone.reference_velocity[k] / SPEED_LIMIT
        row[at + 9 + k] = drone.reference_acceleration[k] / ACCELERATION_LIMIT


@part
def write_neighbor(
    own: Record, other: Record, drone: Record, load: bool, row: Float32Array, at: int
) -> None:
    """Write the fields of a drone's neighbor.

    Args:
        own: the drone's measured record.
        other: the neighbor's measured record.
        drone: the neighbor's true record.
        load: True to include thrust margin, mass and charge.
        row: written.
        at: index of the first field.
    """
    for k in range(3):
        row[at + k] = other.position[k] - own.position[k]
        row[at + 3 + k] = (other.velocity[k] - own.velocity[k]) / SPEED_LIMIT
        row[at + 6 + k] = drone.goal[k] - other.position[k]
        row[at + 9 + k] = drone.type_code[k]
    end = at + 12
    if load:
        end = write_load(other, drone, row, end)
    row[end] = 1.0


@part
def write_obstacles(
    x: float, y: float, z: float, obstacles: FloatArray, places: int, row: Float32Array
) -> int:
    """Write the fields of the obstacles nearest to a point, m; return the index after them.

    Fields of missing obstacles are left unchanged.
    """
    reached: float = -1.0
    last: Any = np.int64(-1)
    for place in range(min(places, obstacles.shape[0])):
        nearest_square = np.inf
        chosen: Any = np.int64(-1)  # numba would compile a literal as a type of its own
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


@kernel
def write_observations(
    first: int,
    last: int,
    mask: BoolArray,
    out: Float32Array,
    num_obstacles: int,
    load: bool,
    force: FloatArray,
    setpoint: bool,
    seen: Records,
    columns: FloatArray,
    drones: Records,
    environments: Records,
    settings: Records,
    order: IntArray | None,
    obstacles: FloatArray | None,
    others: IntArray,
    square: FloatArray,
) -> None:
    """Write the observation rows of the environments first to last - 1 that are in the mask.

    Args:
        first: index of the first environment.
        last: one past that of the last.
        mask: (E,) environments to write.
        out: (E, N, width) rows.
        num_obstacles: M.
        load: True to include thrust margins, masses and charges.
        force: (E, N, 3) predicted forces, N; (0, N, 3) if they are not observed.
        setpoint: True to include the set-point's velocity and acceleration.
        seen: (E, N) measured records of the drones.
        columns: (E, N, columns) the memory of `seen` as floats; the first three are positions.
        drones: (E, N) true records.
        environments: (E,) records.
        settings: (1,) record.
        order: (E, N) any permutation of the drones, which is sorted in place; None in small teams.
        obstacles: (M', 7) rows of `swarm_envs.physics.contact`; None if M is 0.
        others: (K,) scratch; gives the number of neighbors.
        square: (K,) scratch.
    """
    direct, width = settings[0].level != SETPOINTS, 16 if load else 13
    for e in range(first, last):
        if not mask[e]:
            continue
        position = columns[e]
        time_left = max(1.0 - environments[e].time / settings[0].horizon_s, 0.0)
        if order is not None:
            sort_along_x(position, order[e])
        for place in range(out.shape[1]):
            i = place
            if order is not None:
                i = order[e, place]
            row, own, d = out[e, i], seen[e, i], drones[e, i]
            for c in range(out.shape[2]):  # fields of missing neighbors and obstacles stay zero
                row[c] = 0.0
            if d.active + d.crashed == 0.0:  # it ended in an earlier decision
                continue
            start = write_self(own, d, direct, row)
            if load:
                start = write_load(own, d, row, start)
            if len(force) > 0:
                for k in range(3):
                    row[start + k] = force[e, i, k] / (d.nominal_mass * GRAVITY)
                start += 3
            if setpoint:
                start = write_setpoint(d, row, start)
            if order is not None:
                team = drones[e]
                found = nearest_sorted(i, place, position, team, order[e], others, square)
            else:
                found = nearest(i, position, drones[e], others, square)
            for k in range(found):
                j = others[k]
                write_neighbor(own, seen[e, j], drones[e, j], load, row, start + width * k)
            start += width * others.shape[0]
            if obstacles is not None:
                p = own.position
                place_of = row[start : start + 4 * num_obstacles]
                start += write_obstacles(p[0], p[1], p[2], obstacles, num_obstacles, place_of)
            write_task(own, d, row, start)
            row[start + 12] = time_left
