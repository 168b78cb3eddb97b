"""Reference trajectories of the nominal system, a triple integrator: pieces of constant jerk.

They are sampled once at the instants that rounds ask for; `closest_distances` is exact between.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from swarm_envs.baselines.mlr_dmpc.mlr_dmpc_config import MlrDmpcConfig
from swarm_envs.compiled import kernel
from swarm_envs.state import FloatArray

NOBODY = 255
"""Stands for the compute unit of a trajectory that none has planned: the hover at the start."""


class Identity(NamedTuple):
    """What tells trajectories of a drone apart (the metadata of Sec. 4.2.1)."""

    start_round: int  # Round at whose beginning the trajectory starts
    compute_unit: int  # Who planned it

    @property
    def number(self) -> int:
        """Both as one integer, in the same order."""
        return self.start_round << 8 | self.compute_unit

    @staticmethod
    def of(number: int) -> Identity:
        """The identity that has a number."""
        return Identity(number >> 8, number & 255)


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
        for name in ("state", "jerk"):
            rounded = np.array(getattr(self, name), dtype=np.float32).astype(np.float64)
            rounded.flags.writeable = False
            object.__setattr__(self, name, rounded)

    def states(self, times: FloatArray) -> FloatArray:
        """States (T, 3, 3) at times (T,) since its start, s; past the end the last place."""
        at = np.asarray(times, dtype=np.float64)
        return _states(self.state, self.jerk, self.input_sampling_s, at)

    def positions(self, times: FloatArray) -> FloatArray:
        """Positions (T, 3), m, at times (T,) since its start, s."""
        return self.states(times)[:, 0]


@kernel
def _states(state: FloatArray, jerk: FloatArray, step: float, times: FloatArray) -> FloatArray:
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


@lru_cache(maxsize=4096)
def _all_positions(trajectory: Trajectory, step: float, count: int) -> FloatArray:
    """Positions (2 count + 1, 3) at 0, step, ... since its start, at rest after count steps."""
    flown = trajectory.positions(step * np.arange(count + 1, dtype=np.float64))
    return np.concatenate([flown, np.repeat(flown[-1:], count, axis=0)])


def all_positions_from(
    trajectories: Sequence[Trajectory], start_round: int, config: MlrDmpcConfig
) -> FloatArray:
    """Positions (C, S + 1, 3) of several at t, t + T_c, ... of a round's start t, m."""
    out = np.empty((len(trajectories), config.num_samples + 1, 3))
    step, count, parts = config.collision_sampling_s, config.num_samples, config.samples_per_round
    for path, one in zip(out, trajectories, strict=True):
        first = min((start_round - one.identity.start_round) * parts, count)
        path[:] = _all_positions(one, step, count)[first : first + count + 1]
    return out


def sampled_positions(
    trajectory: Trajectory, start_round: int, config: MlrDmpcConfig
) -> FloatArray:
    """Positions (S, 3) at the collision samples t + T_c, t + 2 T_c, ... of a round's start t, m."""
    return all_positions_from([trajectory], start_round, config)[0, 1:]


@lru_cache(maxsize=4096)
def states_by_round(trajectory: Trajectory, round_s: float, rounds: int) -> FloatArray:
    """States (H + 1, 3, 3) at the starts of rounds from its own on."""
    return trajectory.states(round_s * np.arange(rounds + 1, dtype=np.float64))


def state_at(trajectory: Trajectory, round_: int, config: MlrDmpcConfig) -> FloatArray:
    """State (3, 3), position, velocity and acceleration, at the start of a round."""
    age = round_ - trajectory.identity.start_round
    states = states_by_round(trajectory, config.round_s, config.horizon_rounds)
    return states[min(age, config.horizon_rounds)]


def end_position(trajectory: Trajectory, config: MlrDmpcConfig) -> FloatArray:
    """Position (3,) at which it comes to rest, m."""
    start = trajectory.identity.start_round
    return state_at(trajectory, start + config.horizon_rounds, config)[0]


def is_at_rest(trajectory: Trajectory, round_: int, config: MlrDmpcConfig) -> bool:
    """Whether it has ended by the start of a round."""
    if not trajectory.jerk.any() and not trajectory.state[1:].any():
        return True
    return round_ - trajectory.identity.start_round >= config.horizon_rounds


@kernel
def least_distances(one: FloatArray, others: FloatArray, shrink: FloatArray) -> FloatArray:
    """Least distances (C,) of positions (S, 3) from others (C, S, 3), by axis times `shrink`, m."""
    out = np.empty(len(others))
    for c in range(len(others)):
        least = np.inf
        for s in range(len(one)):
            square = 0.0
            for i in range(3):
                square += ((others[c, s, i] - one[s, i]) * shrink[i]) ** 2
            least = min(least, square)
        out[c] = np.sqrt(least)
    return out


_PARTS = 8


def closest_distances(
    states: FloatArray, jerks: FloatArray, duration_s: float, shrink: FloatArray
) -> FloatArray:
    """Least scaled distance (N, N) of each pair over all intervals, inf on the diagonal, m.

    Within an interval of constant jerk the squared distance is a polynomial of degree six; it is
    least at an end or at a root of its derivative. `states` (R, N, 3, 3) are those at the start of
    each interval, NaN for who is not in the air; `shrink` (3,) is the diagonal of the inverse of
    Theta.
    """
    count = states.shape[1]
    out = np.full((count, count), np.inf)
    scaled = np.concatenate([states, jerks[:, :, None]], axis=2) * shrink
    factors = np.array([1.0, 1.0, 0.5, 1.0 / 6.0])[:, None]
    powers = np.linspace(0.0, duration_s, _PARTS + 1)[:, None] ** np.arange(4)
    for i in range(count - 1):
        terms = (scaled[:, i + 1 :] - scaled[:, i, None]) * factors
        points = np.einsum("tk,rjkx->rjtx", powers, terms)
        sampled = np.sqrt((points * points).sum(axis=-1)).min(axis=-1)
        sampled = np.where(np.isnan(sampled), np.inf, sampled)
        lengths = np.linalg.norm(terms, axis=-1)
        speed = lengths[..., 1:] @ (np.arange(1, 4) * duration_s ** np.arange(3))
        # Nowhere are they nearer than this; roots are sought only where it could matter.
        bound = sampled - speed * duration_s / (2 * _PARTS)
        best = sampled.min(axis=0)
        for r, k in np.argwhere(bound < best):
            if bound[r, k] < best[k]:
                best[k] = min(best[k], _least_length(terms[r, k], duration_s))
        out[i, i + 1 :] = out[i + 1 :, i] = best
    return out


def _least_length(terms: FloatArray, duration_s: float) -> float:
    """Least length of a cubic curve with coefficients (4, 3) over an interval from 0."""
    square = np.sum([np.convolve(terms[:, x], terms[:, x]) for x in range(3)], axis=0)
    slope = square[1:] * np.arange(1, 7)
    size = np.abs(slope).max(initial=0.0)
    slope[np.abs(slope) < 1e-14 * size] = 0.0  # a tiny leading coefficient makes huge roots
    roots = np.roots(slope[::-1])
    real = roots.real[np.abs(roots.imag) < 1e-6]
    times = np.concatenate([[0.0, duration_s], np.clip(real, 0.0, duration_s)])
    points = (times[:, None] ** np.arange(4)) @ terms
    return float(np.sqrt((points * points).sum(axis=1).min()))
