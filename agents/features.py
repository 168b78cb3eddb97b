"""What a policy network is told of an observation row: the same numbers, made easy to learn from.

A row of `swarm_envs.envs.observation` holds everything that a drone senses. A small network learns
faster when it need not find out by itself how near is near, or where two straight ways meet.
"""

from __future__ import annotations

from functools import cache
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from swarm_envs.compiled import borrowing_kernel
from swarm_envs.envs.observation import Float32Array, observation_layout, observation_width
from swarm_envs.tasks.base import SPEED_LIMIT
from swarm_envs.vehicles import VEHICLES

FEATURES = "goal-and-closest-approach-1"
"""Name of this choice of features: files of policies say by it what their numbers are."""
TYPED = "goal-and-closest-approach-typed-1"
"""The same with the types of vehicles: its own after its own numbers, a neighbour's after its."""
TYPES = tuple(VEHICLES)
"""In the order of their one-hot code."""

GOAL_REACH = 0.5
"""Beyond this distance the goal's vector is a direction, m."""
NEAR = 0.4
"""Length over which nearness falls by e, m."""
AHEAD = 2.0
"""How far ahead closest approaches are looked for, s."""
OTHERS_GOAL = 1.0
"""A neighbour's way to its goal is seen up to this length, m."""
OWN_WIDTH, NEIGHBOR_WIDTH = 18, 17
"""Numbers told of a drone itself, and of each neighbour, whose mask is the last; types follow."""


_ZERO, _LITTLE = np.float32(0.0), np.float32(1e-6)
_SPEED, _HORIZON = np.float32(SPEED_LIMIT), np.float32(AHEAD)
_REACH, _FOLD = np.float32(OTHERS_GOAL), np.float32(NEAR)


class _Places(NamedTuple):
    """Where a row has what features are made of."""

    position: slice
    velocity: slice
    attitude: slice
    thrust: slice
    setpoint_offset: slice
    goal: slice
    time_left: slice
    type: slice
    neighbors: slice
    """Of all of them: K times the width of one."""


def features(rows: Float32Array, num_neighbors: int, typed: bool = False) -> Float32Array:
    """Features of flat observation rows without obstacles.

    Of the drone (18): the vector to its goal, over 0.5 m and cut there; its distance, m; velocity
    over 2 m/s; the direction of its thrust, and its share of the largest; the controller's
    set-point relative to the drone, m; position, over 2 m; time left.
    Of each neighbour (17): relative position, m; exp(-d / 0.4 m); relative velocity over 2 m/s; of
    the closest approach, if both fly straight on: the time until then over 2 s, which is as far as
    it is looked for, the relative position then, m, and exp(-distance / 0.4 m); the vector from
    the neighbour to its goal, cut at 1 m; speed at which it comes nearer, over 2 m/s; mask. All
    zero where there is no neighbour. Types are one-hot, `TYPES` in order.

    Args:
        rows: (..., width) as `observation="flat"` gives them, `num_obstacles=0`.
        num_neighbors: K.
        typed: tell the drone's own type after its numbers, and each neighbour's after its.

    Returns:
        (..., 18 + 17 K, with types 21 + 20 K) float32.

    Raises:
        ValueError: rows have another width.
    """
    check_width(rows, num_neighbors)
    places = _places(num_neighbors)
    goal = rows[..., places.goal]
    distance = _length(goal)
    attitude = rows[..., places.attitude]
    own: list[npt.NDArray[Any]] = [
        goal / np.maximum(distance, GOAL_REACH),
        distance,
        rows[..., places.velocity],
        attitude[..., 2::3],
        rows[..., places.thrust],
        rows[..., places.setpoint_offset],
        rows[..., places.position] / 2.0,
        rows[..., places.time_left],
    ]
    if typed:
        own.append(rows[..., places.type])
    before = rows.shape[:-1]
    if num_neighbors:
        seen = rows[..., places.neighbors].reshape(*before, num_neighbors, -1)
        own.append(_neighbor_features(seen, typed).reshape(*before, -1))
    made: Float32Array = np.concatenate(own, axis=-1, dtype=np.float32)
    return made


def check_width(rows: Float32Array, num_neighbors: int) -> None:
    """Refuse rows that are not those of K neighbours and no obstacle.

    Raises:
        ValueError: they have another width.
    """
    wanted = observation_width(num_neighbors)
    if rows.shape[-1] != wanted:
        raise ValueError(
            f"observation rows have {rows.shape[-1]} numbers, but those with num_neighbors="
            f"{num_neighbors} and num_obstacles=0 have {wanted}"
        )


def _neighbor_features(neighbors: Float32Array, typed: bool) -> Float32Array:
    """(..., K, 17 or with types 20) of (..., K, width) fields of neighbours."""
    before = neighbors.shape[:-1]
    flat = np.ascontiguousarray(neighbors).reshape(-1, neighbors.shape[-1])
    width = NEIGHBOR_WIDTH + (len(TYPES) if typed else 0)
    made: Float32Array = np.empty((len(flat), width), np.float32)
    nearness: Float32Array = np.empty((2, len(flat)), np.float32)
    _write_neighbors(flat, made, nearness)
    made[:, _NEARNESS] = (np.exp(nearness, out=nearness) * flat[:, -1]).T
    return made.reshape(*before, width)


_NEARNESS = [3, 11]
"""Where a neighbour's features have nearness, now and at the closest approach."""


@borrowing_kernel
def _write_neighbors(neighbors: Float32Array, made: Float32Array, nearness: Float32Array) -> None:
    """Write features of neighbours, all but nearness, of which the exponents are written.

    The exponential is left to numpy, whose digits trained policies have seen.

    Args:
        neighbors: (R, width) fields of neighbours.
        made: (R, 17, or more for types) features, written.
        nearness: (2, R) -distance / 0.4 m, now and at the closest approach, written.
    """
    types = made.shape[1] - NEIGHBOR_WIDTH
    for r in range(len(neighbors)):
        mask = neighbors[r, -1]
        square = approach = motion = goal = _ZERO
        for k in range(3):
            velocity = neighbors[r, 3 + k] * _SPEED
            square += neighbors[r, k] * neighbors[r, k]
            approach += neighbors[r, k] * velocity
            motion += velocity * velocity
            goal += neighbors[r, 6 + k] * neighbors[r, 6 + k]
        distance, approach = np.sqrt(square), -approach
        time = min(max(approach / max(motion, _LITTLE), _ZERO), _HORIZON)
        reach, least = max(np.sqrt(goal), _REACH), _ZERO
        for k in range(3):
            closest = neighbors[r, k] + time * (neighbors[r, 3 + k] * _SPEED)
            least += closest * closest
            made[r, k] = neighbors[r, k] * mask
            made[r, 4 + k] = neighbors[r, 3 + k] * mask
            made[r, 8 + k] = closest * mask
            made[r, 12 + k] = neighbors[r, 6 + k] / reach * mask
        nearness[0, r], nearness[1, r] = -distance / _FOLD, -np.sqrt(least) / _FOLD
        made[r, 7] = time / _HORIZON * mask
        made[r, 15] = approach / max(distance, _LITTLE) / _SPEED * mask
        made[r, 16] = mask * mask
        for k in range(types):
            made[r, 17 + k] = neighbors[r, 9 + k] * mask


def _length(vectors: Float32Array) -> Float32Array:
    length: Float32Array = np.sqrt(np.square(vectors).sum(axis=-1, keepdims=True))
    return length


@cache
def _places(num_neighbors: int) -> _Places:
    found = {field.name: field.where for field in observation_layout(num_neighbors)}
    around = [where for name, where in found.items() if name.startswith("neighbor_")]
    whole = slice(around[0].start, around[-1].stop) if around else slice(0, 0)
    return _Places(
        position=found["self.position"],
        velocity=found["self.velocity"],
        attitude=found["self.attitude"],
        thrust=found["self.thrust"],
        setpoint_offset=found["self.setpoint_offset"],
        goal=found["task.goal"],
        time_left=found["task.time_left"],
        type=found["self.type"],
        neighbors=whole,
    )
