"""Reference trajectories of the nominal system, a triple integrator: pieces of constant jerk.

Samples at the instants of rounds are cached; `closest_distances` is exact between samples too.
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
"""The compute unit of a trajectory that none has planned, such as the hover at the start."""


class Identity(NamedTuple):
    """The identity of a trajectory of a drone (the metadata of Sec. 4.2.1)."""

    start_round: int  # The round at whose beginning the trajectory starts
    compute_unit: int  # The unit that planned it

    @property
    def number(self) -> int:
        """Both as one integer, in the same order."""
        return self.start_round << 8 | self.compute_unit

    @staticmethod
    def of(number: int) -> Identity:
        """Return the identity that has a number."""
        return Identity(number >> 8, number & 255)


@dataclass(frozen=True, eq=False)
class Trajectory:
    """A plan as it is sent, (12): a state and jerks. After that the drone rests at its end.

    State and jerk are rounded to float32, as messages carry them, before the plan is checked, so
    that drones fly exactly the plan that was checked.

    Args:
        identity: The start and the author.
        state: The position, velocity and acceleration (3, 3) at the start, m and s.
        jerk: The jerk (h_s, 3) of each interval, m/s^3.
        input_sampling_s: The duration of an interval (T_s), s.
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
        """Return states (T, 3, 3) at times (T,) since its start, s; at rest past its end."""
        at = np.asarray(times, dtype=np.float64)
        return _states(self.state, self.jerk, self.input_sampling_s, at)

    def positions(self, times: FloatArray) -> FloatArray:
        """Return positions (T, 3), m, at times (T,) since its start, s."""
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
    """Write the state (3, 3) after a time at constant jerk (3,)."""
    for i in range(3):
        position, velocity, acceleration = state[0, i], state[1, i], state[2, i]
        out[2, i] = acceleration + time * jerk[i]
        out[1, i] = velocity + time * (acceleration + time * jerk[i] / 2)
        out[0, i] = position + time * (velocity + time * (acceleration / 2 + time * jerk[i] / 6))


def hover(position: FloatArray, num_inputs: int, input_sampling_s: float) -> Trajectory:
    """Return the trajectory that rests at a position (3,), m, from round 0 on."""
    state = np.zeros((3, 3))
    state[0] = position
    return Trajectory(Identity(0, NOBODY), state, np.zeros((num_inputs, 3)), input_sampling_s)


@lru_cache(maxsize=4096)
def _all_positions(trajectory: Trajectory, step: float, count: int) -> FloatArray:
    """Return positions (2 count + 1, 3) at 0, step, ...; at rest after `count` steps."""
    flown = trajectory.positions(step * np.arange(count + 1, dtype=np.float64))
    return np.concatenate([flown, np.repeat(flown[-1:], count, axis=0)])


def all_positions_from(
    trajectories: Sequence[Trajectory], start_round: int, config: MlrDmpcConfig
) -> FloatArray:
    """Return positions (C, S + 1, 3), m, at t, t + T_c, ... from the start t of a round."""
    out = np.empty((len(trajectories), config.num_samples + 1, 3))
    step, count, parts = config.collision_sampling_s, config.num_samples, config.samples_per_round
    for path, one in zip(out, trajectories, strict=True):
        first = min((start_round - one.identity.start_round) * parts, count)
        path[:] = _all_positions(one, step, count)[first : first + count + 1]
    return out


def sampled_positions(
    trajectory: Trajectory, start_round: int, config: MlrDmpcConfig
) -> FloatArray:
    """Return positions (S, 3), m, at the collision samples from the start of a round."""
    return all_positions_from([trajectory], start_round, config)[0, 1:]


@lru_cache(maxsize=4096)
def states_by_round(trajectory: Trajectory, round_s: float, rounds: int) -> FloatArray:
    """Return states (H + 1, 3, 3) at the starts of rounds from its own on."""
    return trajectory.states(round_s * np.arange(rounds + 1, dtype=np.float64))


def state_at(trajectory: Trajectory, round_: int, config: MlrDmpcConfig) -> FloatArray:
    """Return position, velocity and acceleration (3, 3) at the start of a round."""
    age = round_ - trajectory.identity.start_round
    states = states_by_round(trajectory, config.round_s, config.horizon_rounds)
    return states[min(age, config.horizon_rounds)]


def end_position(trajectory: Trajectory, config: MlrDmpcConfig) -> FloatArray:
    """Return the position (3,) at which a trajectory comes to rest, m."""
    start = trajectory.identity.start_round
    return state_at(trajectory, start + config.horizon_rounds, config)[0]


def is_at_rest(trajectory: Trajectory, round_: int, config: MlrDmpcConfig) -> bool:
    """Return True if a trajectory has ended by the start of a round."""
    if not trajectory.jerk.any() and not trajectory.state[1:].any():
        return True
    return round_ - trajectory.identity.start_round >= config.horizon_rounds


@kernel
def least_distances(one: FloatArray, others: FloatArray, shrink: FloatArray) -> FloatArray:
    """Return the least distances (C,), scaled by `shrink`, of positions (S, 3) from (C, S, 3)."""
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
    """Return the least scaled distance (N, N) of each pair over all intervals, m; diagonal inf.

    Within an interval of constant jerk the squared distance is a polynomial of degree six; it is
    least at an end or at a root of its derivative. `states` (R, N, 3, 3) are those at the start of
    each interval, NaN for drones that are not airborne; `shrink` (3,) is the diagonal of the
    inverse of Theta.
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
        # A lower bound of the distance; roots are computed only where it is below the best.
        bound = sampled - speed * duration_s / (2 * _PARTS)
        best = sampled.min(axis=0)
        for r, k in np.argwhere(bound < best):
            if bound[r, k] < best[k]:
                best[k] = min(best[k], _least_length(terms[r, k], duration_s))
        out[i, i + 1 :] = out[i + 1 :, i] = best
    return out


def _least_length(terms: FloatArray, duration_s: float) -> float:
    """Return the least length of a cubic curve with coefficients (4, 3) over an interval from 0."""
    square = np.sum([np.convolve(terms[:, x], terms[:, x]) for x in range(3)], axis=0)
    slope = square[1:] * np.arange(1, 7)
    size = np.abs(slope).max(initial=0.0)
    slope[np.abs(slope) < 1e-14 * size] = 0.0  # A tiny leading coefficient would give huge roots
    roots = np.roots(slope[::-1])
    real = roots.real[np.abs(roots.imag) < 1e-6]
    times = np.concatenate([[0.0, duration_s], np.clip(real, 0.0, duration_s)])
    points = (times[:, None] ** np.arange(4)) @ terms
    return float(np.sqrt((points * points).sum(axis=1).min()))
