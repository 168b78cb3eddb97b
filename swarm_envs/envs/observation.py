"""Observations: what each drone senses, as one flat row of numbers with a documented layout.

A row is `[self | K neighbours, nearest first | M obstacles, nearest first | task]`. Its length does
not depend on the size of the team: one policy flies any number of drones. World frame throughout.
"""

from __future__ import annotations

from functools import cache
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from swarm_envs.state import FloatArray
from swarm_envs.tasks.base import ACCELERATION_LIMIT, SPEED_LIMIT
from swarm_envs.vehicles import VEHICLES, Team

Float32Array = npt.NDArray[np.float32]
"""An array of observed numbers."""

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


@cache
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
