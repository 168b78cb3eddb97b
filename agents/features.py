"""Features: the inputs of a policy network, computed from an observation row.

A row of `swarm_envs.envs.observation` has everything that a drone observes. A small network learns
faster from distances, directions and predicted closest approaches than from the row itself.
Positions are relative to the controller's set-point, which is exact even if the measured position
is noisy, so that features of the goal have no noise.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from typing import Any, NamedTuple

import numpy as np

from swarm_envs.compiled import kernel, part
from swarm_envs.envs.observation import Float32Array, observation_layout, observation_width
from swarm_envs.tasks.base import SPEED_LIMIT
from swarm_envs.vehicles import VEHICLES

__all__ = ["MASK", "TYPES", "FeatureSizes", "feature_sizes", "features_of"]

TYPES = tuple(VEHICLES)
"""Vehicle types in the order of their one-hot code."""

GOAL_REACH = 0.5  # Length to which the vector to the goal is clipped, m
REFERENCE_REACH = 0.2  # Length to which the vector to the reference is clipped, m
NEAR = 0.4  # Length over which the feature of proximity falls by a factor of e, m
AHEAD = 2.0  # Time horizon of closest approaches, s
OTHERS_GOAL = 1.0  # Length to which vectors to a neighbor's goal and to obstacles are clipped, m
APART = 2.0  # Length to which the vector between two goals is clipped, m
BESIDE = 0.2  # Horizontal distance over which the feature of downwash falls by a factor of e, m
ABOVE = 0.5  # Height at which a neighbor counts as fully above or below, m
OWN_WIDTH, NEIGHBOR_WIDTH, OBSTACLE_WIDTH = 31, 25, 5
"""Numbers of features of a drone, a neighbor and an obstacle, without loads and forces."""
LOAD_WIDTH, FORCE_WIDTH, SETPOINT_WIDTH = 3, 3, 6
"""Number of further features of loads, predicted forces and derivatives of set-points."""
MASK = 16  # Index of a neighbor's mask among its features
_SETPOINT, _TYPE, _REFERENCE = 11, 18, 21  # Indices among the drone's own features
_NEIGHBOR_TYPE, _NEIGHBOR_REST = 17, 20  # Indices among a neighbor's features
_LITTLE = 1e-6


class ObservationColumns(NamedTuple):
    """The first columns of fields of a flat observation row, for kernels."""

    position: int
    velocity: int
    attitude: int
    thrust: int
    setpoint_offset: int
    type: int
    goal: int
    reference_position: int
    reference_velocity: int  # The reference's acceleration follows
    time_left: int
    neighbors: int  # First column of the nearest neighbor; 0 if none is observed
    neighbor_width: int  # Number of columns of a neighbor
    num_neighbors: int  # Number of neighbors
    obstacles: int
    """First column of the nearest obstacle, which has an offset (3), m, and a mask; 0 if none is
    observed."""
    num_obstacles: int  # Number of obstacles
    num_extra: int  # Number of columns of load, force and set-point, which follow the type
    setpoint_velocity: int  # 0 if it is not observed


def observation_columns(fields: Mapping[str, slice]) -> ObservationColumns:
    """Return the columns of a flat observation row from the slices of its fields by name."""
    own = ("position", "velocity", "attitude", "thrust", "setpoint_offset", "type")
    task = ("goal", "reference_position", "reference_velocity", "time_left")
    starts = {name: fields[f"self.{name}"].start for name in own}
    starts |= {name: fields[f"task.{name}"].start for name in task}
    nearest = [where for name, where in fields.items() if name.startswith("neighbor_0.")]
    first, width = (nearest[0].start, nearest[-1].stop - nearest[0].start) if nearest else (0, 0)
    count = sum(name.endswith(".mask") and name.startswith("neighbor_") for name in fields)
    starts |= {"neighbors": first, "neighbor_width": width, "num_neighbors": count}
    stands = [where.start for name, where in fields.items() if name.startswith("obstacle_")]
    starts |= {"obstacles": min(stands, default=0), "num_obstacles": len(stands) // 2}
    last = max(where.stop for name, where in fields.items() if name.startswith("self."))
    setpoint = fields.get("self.setpoint_velocity", slice(0, 0)).start
    return ObservationColumns(
        **starts, num_extra=last - fields["self.type"].stop, setpoint_velocity=setpoint
    )


class FeatureSizes(NamedTuple):
    """The numbers of features: those of the drone itself, followed by those of K neighbors."""

    num_neighbors: int
    """K."""
    own: int
    """The number of features of the drone itself and of obstacles."""
    neighbor: int
    """The number of features of each neighbor, whose mask has the index `MASK`."""

    @property
    def width(self) -> int:
        """The number of all features."""
        return self.own + self.neighbor * self.num_neighbors

    def split(self, values: Float32Array) -> tuple[Float32Array, Float32Array]:
        """Split features (..., width) into (..., own) and those of neighbors (..., K, neighbor)."""
        shape = (*values.shape[:-1], self.num_neighbors, self.neighbor)
        return values[..., : self.own], values[..., self.own :].reshape(shape)


def feature_sizes(
    num_neighbors: int,
    num_obstacles: int = 0,
    load: bool = False,
    force: bool = False,
    setpoint: bool = False,
) -> FeatureSizes:
    """Return the numbers of features; the arguments are those of `features_of`."""
    extra = LOAD_WIDTH * load + FORCE_WIDTH * force + SETPOINT_WIDTH * setpoint
    own = OWN_WIDTH + extra + OBSTACLE_WIDTH * num_obstacles
    return FeatureSizes(num_neighbors, own, NEIGHBOR_WIDTH + LOAD_WIDTH * load)


def features_of(
    rows: Float32Array,
    num_neighbors: int,
    num_obstacles: int = 0,
    load: bool = False,
    force: bool = False,
    setpoint: bool = False,
) -> Float32Array:
    """Return the features of flat observation rows.

    Positions are relative to the controller's set-point, or to the drone if there is none. "Over"
    denotes division, and a vector is clipped by scaling it to a length.

    - Of the drone (31): the vector to its goal over 0.5 m, clipped to length 1; its distance, m;
      velocity over 2 m/s; the direction of its thrust; thrust over the largest thrust; the
      set-point relative to the drone, m; position of the set-point over 2 m; time left; one-hot
      type; the vector to its reference over 0.2 m, clipped to length 1; its distance, m; the
      reference's velocity over 2 m/s and acceleration over 5 m/s^2. With load (3): thrust margin,
      mass ratio and charge. With force (3): the prediction over the weight. With set-point (6): its
      velocity over 2 m/s and acceleration over 5 m/s^2; the velocities of neighbors are then
      relative to it instead of the drone.
    - Of each obstacle (5): the vector to it, clipped to 1 m; exp(-distance / 0.4 m); mask.
    - Of each neighbor (25): relative position, m; exp(-distance / 0.4 m); relative velocity over
      2 m/s; for the closest approach with constant velocities within 2 s: the time until then over
      2 s, the relative position then, m, and exp(-distance / 0.4 m); the vector from the neighbor
      to its goal, clipped to 1 m; the speed of approach over 2 m/s; mask; one-hot type; the vector
      from the drone's goal to the neighbor's goal over 2 m, clipped to length 1;
      exp(-h / 0.2 m) of the horizontal distance h, and this times the height above the drone over
      0.5 m, clipped to [-1, 1]. With load (3): the neighbor's.

    All features of a missing neighbor or obstacle are zero.

    Args:
        rows: (..., width) rows of `observation="flat"`.
        num_neighbors: K.
        num_obstacles: M.
        load: True if rows have loads.
        force: True if rows have predicted forces.
        setpoint: True if rows have derivatives of set-points.

    Returns:
        (..., 31 + 3 load + 3 force + 6 setpoint + 5 M + K (25 + 3 load)) float32.

    Raises:
        ValueError: rows have another width.
    """
    form = num_neighbors, num_obstacles, load, force, setpoint
    expected, sizes = observation_width(*form), feature_sizes(*form)
    if rows.shape[-1] != expected:
        raise ValueError(
            f"observation rows have {rows.shape[-1]} numbers, but those with num_neighbors="
            f"{num_neighbors}, num_obstacles={num_obstacles}, observe_load={bool(load)}, "
            f"observe_force={bool(force)} and observe_setpoint={bool(setpoint)} have {expected}"
        )
    flat = np.ascontiguousarray(rows, np.float32).reshape(-1, expected)
    made: Float32Array = np.zeros((len(flat), sizes.width), np.float32)
    _write(flat, _columns(*form), sizes, made)
    return made.reshape(*rows.shape[:-1], sizes.width)


@cache
def _columns(*form: Any) -> ObservationColumns:
    return observation_columns({field.name: field.where for field in observation_layout(*form)})


@kernel
def _write(
    rows: Float32Array, at: ObservationColumns, sizes: FeatureSizes, made: Float32Array
) -> None:
    """Write the features (R, width) of rows to an array of zeros."""
    for r in range(len(rows)):
        row, out = rows[r], made[r]
        _write_own(row, at, out)
        begin = OWN_WIDTH + at.num_extra
        for m in range(at.num_obstacles):
            start, end = at.obstacles + 4 * m, begin + OBSTACLE_WIDTH * m
            if row[start + 3] > 0.0:
                _write_obstacle(row, at, row[start : start + 4], out[end : end + OBSTACLE_WIDTH])
        for k in range(at.num_neighbors):
            start, end = at.neighbors + k * at.neighbor_width, sizes.own + k * sizes.neighbor
            seen = row[start : start + at.neighbor_width]
            if seen[-1] > 0.0:
                _write_neighbor(row, at, seen, out[end : end + sizes.neighbor])


@part
def _length(x: float, y: float, z: float) -> float:
    return np.sqrt(x * x + y * y + z * z)


@part
def _from_setpoint(
    vector: Float32Array, row: Float32Array, at: ObservationColumns
) -> tuple[float, float, float]:
    """Convert a vector (3,) from the drone to a vector from its set-point, m."""
    offset = row[at.setpoint_offset :]
    return vector[0] - offset[0], vector[1] - offset[1], vector[2] - offset[2]


@part
def _write_direction(x: float, y: float, z: float, reach: float, out: Float32Array) -> float:
    """Write a vector over a length, clipped to length 1; return its own length, m."""
    distance = _length(x, y, z)
    scale = 1.0 / max(distance, reach)
    out[0], out[1], out[2] = x * scale, y * scale, z * scale
    return distance


@part
def _write_own(row: Float32Array, at: ObservationColumns, out: Float32Array) -> None:
    """Write the features of the drone itself."""
    offset = row[at.setpoint_offset : at.setpoint_offset + 3]
    x, y, z = _from_setpoint(row[at.goal :], row, at)
    out[3] = _write_direction(x, y, z, GOAL_REACH, out[:3])
    x, y, z = _from_setpoint(row[at.reference_position :], row, at)
    out[_REFERENCE + 3] = _write_direction(x, y, z, REFERENCE_REACH, out[_REFERENCE:])
    for k in range(3):
        out[4 + k] = row[at.velocity + k]
        out[7 + k] = row[at.attitude + 2 + 3 * k]
        out[_SETPOINT + k] = offset[k]
        out[14 + k] = (row[at.position + k] + offset[k]) / 2.0
        out[_TYPE + k] = row[at.type + k]
    out[10], out[17] = row[at.thrust], row[at.time_left]
    for k in range(6):
        out[_REFERENCE + 4 + k] = row[at.reference_velocity + k]
    for k in range(at.num_extra):
        out[OWN_WIDTH + k] = row[at.type + 3 + k]


@part
def _write_obstacle(
    row: Float32Array, at: ObservationColumns, seen: Float32Array, out: Float32Array
) -> None:
    """Write the features of an obstacle from its columns (4,)."""
    x, y, z = _from_setpoint(seen, row, at)
    distance = _write_direction(x, y, z, OTHERS_GOAL, out[:3])
    out[3], out[4] = np.exp(-distance / NEAR), 1.0


@part
def _write_neighbor(
    row: Float32Array, at: ObservationColumns, seen: Float32Array, out: Float32Array
) -> None:
    """Write the features of a neighbor from its columns (width,)."""
    x, y, z = _from_setpoint(seen, row, at)
    u, v, w = seen[3], seen[4], seen[5]
    if at.setpoint_velocity > 0:
        own, setpoint = row[at.velocity :], row[at.setpoint_velocity :]
        u, v, w = u + own[0] - setpoint[0], v + own[1] - setpoint[1], w + own[2] - setpoint[2]
    out[4], out[5], out[6] = u, v, w
    u, v, w = u * SPEED_LIMIT, v * SPEED_LIMIT, w * SPEED_LIMIT
    distance, approach = _length(x, y, z), -(x * u + y * v + z * w)
    time = min(max(approach / max(u * u + v * v + w * w, _LITTLE), 0.0), AHEAD)
    closest_x, closest_y, closest_z = x + time * u, y + time * v, z + time * w
    out[0], out[1], out[2] = x, y, z
    out[3] = np.exp(-distance / NEAR)
    out[7] = time / AHEAD
    out[8], out[9], out[10] = closest_x, closest_y, closest_z
    out[11] = np.exp(-_length(closest_x, closest_y, closest_z) / NEAR)
    _write_direction(seen[6], seen[7], seen[8], OTHERS_GOAL, out[12:])
    out[15] = approach / max(distance, _LITTLE) / SPEED_LIMIT
    out[MASK] = 1.0
    for k in range(3):
        out[_NEIGHBOR_TYPE + k] = seen[9 + k]
    goal = row[at.goal : at.goal + 3]
    apart_x, apart_y = seen[0] + seen[6] - goal[0], seen[1] + seen[7] - goal[1]
    _write_direction(apart_x, apart_y, seen[2] + seen[8] - goal[2], APART, out[_NEIGHBOR_REST:])
    beside = np.exp(-np.sqrt(x * x + y * y) / BESIDE)
    out[23], out[24] = beside, beside * min(max(z / ABOVE, -1.0), 1.0)
    for k in range(at.neighbor_width - 13):
        out[NEIGHBOR_WIDTH + k] = seen[12 + k]
