"""What a policy network is told of an observation row: the same numbers, made easy to learn from.

A row of `swarm_envs.envs.observation` holds everything that a drone senses. A small network learns
faster when it need not find out by itself how near is near, or where two straight ways meet.
"""

from __future__ import annotations

from functools import cache
from typing import NamedTuple

import numpy as np

from swarm_envs.compiled import kernel
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


_ZERO, _LITTLE, _TWO, _CUT = (np.float32(value) for value in (0.0, 1e-6, 2.0, GOAL_REACH))
_SPEED, _HORIZON = np.float32(SPEED_LIMIT), np.float32(AHEAD)
_REACH, _FOLD = np.float32(OTHERS_GOAL), np.float32(NEAR)


class _Places(NamedTuple):
    """Where in a row begins what features are made of."""

    position: int
    velocity: int
    attitude: int
    thrust: int
    setpoint_offset: int
    type: int
    neighbors: int
    """Of the first neighbour."""
    goal: int
    time_left: int


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
    flat = np.ascontiguousarray(rows, np.float32).reshape(-1, rows.shape[-1])
    own, neighbor = (width + typed * len(TYPES) for width in (OWN_WIDTH, NEIGHBOR_WIDTH))
    made: Float32Array = np.empty((len(flat), own + num_neighbors * neighbor), np.float32)
    nearness: Float32Array = np.empty((2, len(flat), num_neighbors), np.float32)
    _write(flat, _places(num_neighbors), typed, made, nearness)
    if num_neighbors:
        around = made[:, own:].reshape(len(flat), num_neighbors, neighbor)
        np.exp(nearness, out=nearness)
        for where, near in zip(_NEARNESS, nearness, strict=True):
            np.multiply(near, around[..., _MASK], out=around[..., where])
    return made.reshape(*rows.shape[:-1], made.shape[-1])


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


_NEARNESS, _MASK = (3, 11), 16
"""Where a neighbour's features have nearness, now and at the closest approach, and its mask."""


@kernel
def _write(
    rows: Float32Array, at: _Places, typed: bool, made: Float32Array, nearness: Float32Array
) -> None:
    """Write features of rows, all but nearness, of which the exponents are written.

    The exponential is left to numpy, whose digits trained policies have seen.

    Args:
        rows: (R, width).
        at: where they have what.
        typed: whether types are told.
        made: (R, width) features, written.
        nearness: (2, R, K) -distance / 0.4 m, now and at the closest approach, written.
    """
    types = len(TYPES) if typed else 0
    own, width, seen = OWN_WIDTH + types, NEIGHBOR_WIDTH + types, 10 + len(TYPES)
    for r in range(len(rows)):
        _write_own(rows[r], at, types, made[r])
        for j in range(nearness.shape[2]):
            start, end = at.neighbors + j * seen, own + j * width
            near = nearness[:, r, j]
            _write_neighbor(rows[r, start : start + seen], types, made[r, end:], near)


@kernel
def _write_own(row: Float32Array, at: _Places, types: int, made: Float32Array) -> None:
    """Write what a row tells of the drone itself."""
    square = _ZERO
    for k in range(3):
        square += row[at.goal + k] * row[at.goal + k]
    distance = np.sqrt(square)
    for k in range(3):
        made[k] = row[at.goal + k] / max(distance, _CUT)
        made[4 + k] = row[at.velocity + k]
        made[7 + k] = row[at.attitude + 2 + 3 * k]
        made[11 + k] = row[at.setpoint_offset + k]
        made[14 + k] = row[at.position + k] / _TWO
    made[3], made[10], made[17] = distance, row[at.thrust], row[at.time_left]
    for k in range(types):
        made[OWN_WIDTH + k] = row[at.type + k]


@kernel
def _write_neighbor(
    row: Float32Array, types: int, made: Float32Array, nearness: Float32Array
) -> None:
    """Write what the fields of a neighbour (width,) tell, and the exponents (2,) of nearness."""
    mask = row[len(row) - 1]
    square = approach = motion = goal = _ZERO
    for k in range(3):
        velocity = row[3 + k] * _SPEED
        square += row[k] * row[k]
        approach += row[k] * velocity
        motion += velocity * velocity
        goal += row[6 + k] * row[6 + k]
    distance, approach = np.sqrt(square), -approach
    time = min(max(approach / max(motion, _LITTLE), _ZERO), _HORIZON)
    reach, least = max(np.sqrt(goal), _REACH), _ZERO
    for k in range(3):
        closest = row[k] + time * (row[3 + k] * _SPEED)
        least += closest * closest
        made[k] = row[k] * mask
        made[4 + k] = row[3 + k] * mask
        made[8 + k] = closest * mask
        made[12 + k] = row[6 + k] / reach * mask
    nearness[0], nearness[1] = -distance / _FOLD, -np.sqrt(least) / _FOLD
    made[7] = time / _HORIZON * mask
    made[15] = approach / max(distance, _LITTLE) / _SPEED * mask
    made[_MASK] = mask * mask
    for k in range(types):
        made[NEIGHBOR_WIDTH + k] = row[9 + k] * mask


@cache
def _places(num_neighbors: int) -> _Places:
    starts = {field.name: field.where.start for field in observation_layout(num_neighbors)}
    return _Places(
        position=starts["self.position"],
        velocity=starts["self.velocity"],
        attitude=starts["self.attitude"],
        thrust=starts["self.thrust"],
        setpoint_offset=starts["self.setpoint_offset"],
        type=starts["self.type"],
        neighbors=starts.get("neighbor_0.position", 0),
        goal=starts["task.goal"],
        time_left=starts["task.time_left"],
    )
