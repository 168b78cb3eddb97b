"""Reference trajectories of the nominal system: a triple integrator with piecewise constant jerk."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from swarm_envs.state import FloatArray

NOBODY = 255
"""Stands for the compute unit of a trajectory that none has planned: the hover at the start."""


class Identity(NamedTuple):
    """What tells trajectories of a drone apart (the metadata of Sec. 4.2.1)."""

    start_round: int
    """Round at whose beginning the trajectory starts."""
    compute_unit: int
    """Who planned it."""


@dataclass(frozen=True, eq=False)
class Trajectory:
    """A plan as it is sent, (12): a state and jerks. After its end the drone rests at its last point.

    State and jerk are rounded to float32, as messages carry them, before anything is checked: what
    is flown is what was sent.

    Args:
        identity: start and author.
        state: (3, 3) position, velocity and acceleration at the start, m and s.
        jerk: (h_s, 3) of each interval, m/s^3.
        input_sampling_s: duration of an interval (T_s), s.
    """

    identity: Identity
    state: FloatArray
    jerk: FloatArray
    input_sampling_s: float

    def __post_init__(self) -> None:
        """Round to what a message carries, and freeze."""
        for name in ("state", "jerk"):
            rounded = np.array(getattr(self, name), dtype=np.float32).astype(np.float64)
            rounded.flags.writeable = False
            object.__setattr__(self, name, rounded)

    @property
    def duration_s(self) -> float:
        """From its start to where it rests, s."""
        return len(self.jerk) * self.input_sampling_s

    def states(self, times: FloatArray) -> FloatArray:
        """States (T, 3, 3), position, velocity and acceleration, at times (T,) since its start, s.

        Past the end: the last position, at rest.
        """
        knots = self._knots
        time = np.minimum(times, self.duration_s)
        interval = np.minimum(time / self.input_sampling_s + 1e-9, len(self.jerk) - 1).astype(int)
        since = (time - interval * self.input_sampling_s)[:, None]
        position, velocity, acceleration = np.moveaxis(knots[interval], 1, 0)
        jerk = self.jerk[interval]
        out = np.stack(
            [
                position + since * (velocity + since * (acceleration / 2 + since * jerk / 6)),
                velocity + since * (acceleration + since * jerk / 2),
                acceleration + since * jerk,
            ],
            axis=1,
        )
        out[times >= self.duration_s - 1e-9, 1:] = 0.0
        return out

    def positions(self, times: FloatArray) -> FloatArray:
        """Positions (T, 3), m, at times (T,) since its start, s."""
        return self.states(times)[:, 0]

    @cached_property
    def _knots(self) -> FloatArray:
        """States (h_s + 1, 3, 3) where the jerk changes."""
        dt = self.input_sampling_s
        knots = np.empty((len(self.jerk) + 1, 3, 3))
        knots[0] = self.state
        position, velocity, acceleration = np.moveaxis(knots, 1, 0)
        acceleration[1:] = self.state[2] + dt * np.cumsum(self.jerk, axis=0)
        change = dt * acceleration[:-1] + dt**2 / 2 * self.jerk
        velocity[1:] = self.state[1] + np.cumsum(change, axis=0)
        way = dt * velocity[:-1] + dt**2 / 2 * acceleration[:-1] + dt**3 / 6 * self.jerk
        position[1:] = self.state[0] + np.cumsum(way, axis=0)
        return knots


def hover(position: FloatArray, num_inputs: int, input_sampling_s: float) -> Trajectory:
    """The trajectory that rests at a position (3,), m, from round 0 on."""
    state = np.zeros((3, 3))
    state[0] = position
    return Trajectory(Identity(0, NOBODY), state, np.zeros((num_inputs, 3)), input_sampling_s)
