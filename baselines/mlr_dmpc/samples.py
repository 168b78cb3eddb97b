"""Trajectories at the instants that rounds ask for, computed once each."""

from __future__ import annotations

from weakref import WeakKeyDictionary

import numpy as np

from swarm_envs.baselines.mlr_dmpc.config import MlrDmpcConfig
from swarm_envs.baselines.mlr_dmpc.trajectory import Trajectory
from swarm_envs.state import FloatArray

_POSITIONS: WeakKeyDictionary[Trajectory, tuple[float, FloatArray]] = WeakKeyDictionary()
_STATES: WeakKeyDictionary[Trajectory, tuple[float, FloatArray]] = WeakKeyDictionary()


def sampled(trajectory: Trajectory, start_round: int, config: MlrDmpcConfig) -> FloatArray:
    """Positions (S, 3) at the collision samples t + T_c, t + 2 T_c, ... of a round's start t, m."""
    step, count = config.collision_sampling_s, config.num_samples
    known = _POSITIONS.get(trajectory)
    if known is None or known[0] != step:
        flown = trajectory.positions(step * np.arange(count + 1, dtype=np.float64))
        known = step, np.concatenate([flown, np.repeat(flown[-1:], count, axis=0)])
        _POSITIONS[trajectory] = known
    age = (start_round - trajectory.identity.start_round) * config.samples_per_round
    first = min(age, count) + 1
    return known[1][first : first + count]


def state_at(trajectory: Trajectory, round_: int, config: MlrDmpcConfig) -> FloatArray:
    """State (3, 3), position, velocity and acceleration, at the start of a round."""
    known = _STATES.get(trajectory)
    if known is None or known[0] != config.round_s:
        times = config.round_s * np.arange(config.horizon_rounds + 1, dtype=np.float64)
        known = config.round_s, trajectory.states(times)
        _STATES[trajectory] = known
    age = round_ - trajectory.identity.start_round
    return known[1][min(age, config.horizon_rounds)]


def end_position(trajectory: Trajectory, config: MlrDmpcConfig) -> FloatArray:
    """Position (3,) at which it comes to rest, m."""
    start = trajectory.identity.start_round
    return state_at(trajectory, start + config.horizon_rounds, config)[0]


def is_at_rest(trajectory: Trajectory, round_: int, config: MlrDmpcConfig) -> bool:
    """Whether it has ended by the start of a round."""
    if not trajectory.jerk.any() and not trajectory.state[1:].any():
        return True
    return round_ - trajectory.identity.start_round >= config.horizon_rounds


def least_distances(one: FloatArray, others: FloatArray, config: MlrDmpcConfig) -> FloatArray:
    """Least scaled distances (C,) of positions (S, 3) from others (C, S, 3), m."""
    apart = (others - one) * config.inverse_scaling
    return np.sqrt(np.einsum("csi,csi->cs", apart, apart).min(axis=1))
