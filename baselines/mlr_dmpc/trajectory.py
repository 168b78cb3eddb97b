"""Reference trajectories of the nominal system, a triple integrator: pieces of constant jerk."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from swarm_envs.compiled import kernel
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
    """A plan as it is sent, (12): a state and jerks. After its end the drone rests where that is.

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
        at = np.asarray(times, dtype=np.float64)
        return _states(self.state, self.jerk, self.input_sampling_s, at)

    def positions(self, times: FloatArray) -> FloatArray:
        """Positions (T, 3), m, at times (T,) since its start, s."""
        return self.states(times)[:, 0]


@kernel
def _states(state: FloatArray, jerk: FloatArray, step: float, times: FloatArray) -> FloatArray:
    """What `Trajectory.states` says."""
    intervals = jerk.shape[0]
    knots = np.empty((intervals + 1, 3, 3))
    knots[0] = state
    for k in range(intervals):
        _advance(knots[k], jerk[k], step, knots[k + 1])
    out = np.empty((times.shape[0], 3, 3))
    end = intervals * step
    for t in range(times.shape[0]):
        if times[t] >= end - 1e-9:
            out[t], out[t, 0] = 0.0, knots[intervals, 0]
        else:
            k = max(int(times[t] / step + 1e-9), 0)
            _advance(knots[k], jerk[k], times[t] - k * step, out[t])
    return out


@kernel
def _advance(state: FloatArray, jerk: FloatArray, time: float, out: FloatArray) -> None:
    """Write the state (3, 3) that a constant jerk (3,) leads to."""
    for i in range(3):
        position, velocity, acceleration = state[0, i], state[1, i], state[2, i]
        out[2, i] = acceleration + time * jerk[i]
        out[1, i] = velocity + time * (acceleration + time * jerk[i] / 2)
        out[0, i] = position + time * (velocity + time * (acceleration / 2 + time * jerk[i] / 6))


def hover(position: FloatArray, num_inputs: int, input_sampling_s: float) -> Trajectory:
    """The trajectory that rests at a position (3,), m, from round 0 on."""
    state = np.zeros((3, 3))
    state[0] = position
    return Trajectory(Identity(0, NOBODY), state, np.zeros((num_inputs, 3)), input_sampling_s)
