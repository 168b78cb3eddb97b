"""Ways out of deadlocks (Appendix B.1): who makes room for whom, and where to.

The paper starts when the whole swarm is still. Here a drone that is still, with its plan at an end
away from its target, is enough, so that one knot does not wait for drones that fly elsewhere.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from swarm_envs.baselines.mlr_dmpc.config import MlrDmpcConfig
from swarm_envs.baselines.mlr_dmpc.deadlock import deadlocked
from swarm_envs.state import BoolArray, FloatArray, IntArray

NOBODY = -1
"""Stands for the drone that is made room for where there is none."""


class Detours(NamedTuple):
    """Who makes room at present."""

    for_whom: IntArray
    """(N,) the drone that each makes room for, itself if it steps aside, or `NOBODY`."""
    targets: FloatArray
    """(N, 3) where each flies meanwhile, m; meaningless for those who make no room."""
    since: IntArray
    """(N,) round at which each last began to make room."""

    def current(self, targets: FloatArray) -> FloatArray:
        """Where each drone flies now (N, 3), m: to its target (N, 3), unless it makes room."""
        return np.where((self.for_whom == NOBODY)[:, None], targets, self.targets)


class Snapshot(NamedTuple):
    """What the planner knows of a swarm."""

    positions: FloatArray
    """(N, 3) now, m."""
    velocities: FloatArray
    """(N, 3) now, m/s."""
    ends: FloatArray
    """(N, 3) where the plans end, m."""
    targets: FloatArray
    """(N, 3) own targets, m."""


def no_detours(n: int) -> Detours:
    """Nobody makes room."""
    return Detours(np.full(n, NOBODY), np.zeros((n, 3)), np.full(n, -(10**6)))


def next_detours(
    detours: Detours,
    swarm: Snapshot,
    round_index: int,
    config: MlrDmpcConfig,
    rng: np.random.Generator,
) -> Detours:
    """Who makes room from now on: some stop, some begin. A pure function of its arguments.

    Drone i makes room for the nearest drone j that is stuck, no nearer to its target than i, within
    range, and that i is in the way of or moves towards. It flies sideways of j's way. A stuck drone
    that finds nobody steps aside itself. Who rests at its target stays there.

    Args:
        detours: who makes room so far.
        swarm: the swarm now.
        round_index: the round.
        config: speeds, ranges and times of detours.
        rng: for directions and noise; draws alike for every drone, whoever needs them.
    """
    noise = rng.normal(size=(len(swarm.positions), 3))
    speeds = np.linalg.norm(swarm.velocities, axis=1)
    stuck = deadlocked(swarm.ends, speeds, swarm.targets, config)
    age = round_index - detours.since
    keep = (detours.for_whom != NOBODY) & (age < config.detour_rounds)
    yields = _yields(swarm, stuck & ~keep, config)
    free = ~keep & (age >= config.detour_rounds + config.detour_pause_rounds)
    for_whom = np.where(yields.any(axis=1), _nearest(swarm, yields, config), NOBODY)
    served = np.isin(np.arange(len(stuck)), for_whom[free]) | np.isin(
        np.arange(len(stuck)), detours.for_whom[keep]
    )
    alone = stuck & (for_whom == NOBODY) & ~served
    for_whom[alone] = np.flatnonzero(alone)
    begins = free & (for_whom != NOBODY)
    places = _places(swarm, for_whom, noise, config)
    return Detours(
        np.where(begins, for_whom, np.where(keep, detours.for_whom, NOBODY)),
        np.where(begins[:, None], places, detours.targets),
        np.where(begins, round_index, detours.since),
    )


def _yields(swarm: Snapshot, stuck: BoolArray, config: MlrDmpcConfig) -> BoolArray:
    """(N, N) whether row i should make room for column j."""
    position, left = swarm.positions, swarm.targets - swarm.positions
    distance = np.linalg.norm(left, axis=1)
    between = position[:, None] - position
    gap = np.linalg.norm(between, axis=-1)
    ahead = np.einsum("ijk,jk->ij", between, left) > 0.5 * gap * distance
    closing = np.einsum("ijk,ik->ij", between, swarm.velocities) < 0.0
    meets = np.einsum("ijk,ik->ij", between, left) < -0.5 * gap * distance[:, None]
    at_home = distance <= 0.9 * config.distance_m
    out = stuck & (gap < config.detour_range_m) & (ahead | closing | meets)
    out &= (distance[:, None] <= distance) & ~at_home[:, None]
    tie = distance[:, None] == distance
    index = np.arange(len(distance))
    out &= ~tie | (index[:, None] < index)
    return out


def _nearest(swarm: Snapshot, allowed: BoolArray, config: MlrDmpcConfig) -> IntArray:
    """(N,) the nearest column that is allowed."""
    gap = np.linalg.norm(swarm.positions[:, None] - swarm.positions, axis=-1)
    return np.argmin(np.where(allowed, gap, np.inf), axis=1)


def _places(
    swarm: Snapshot, for_whom: IntArray, noise: FloatArray, config: MlrDmpcConfig
) -> FloatArray:
    """(N, 3) where to make room: away from the other, beside its way, m."""
    other = np.maximum(for_whom, 0)
    way = _unit(swarm.targets[other] - swarm.positions[other])
    away = _unit(swarm.positions - swarm.positions[other])
    side = away + 0.5 * noise
    side -= np.sum(side * way, axis=1, keepdims=True) * way
    step = config.detour_step_m * _unit(_unit(side) + 0.5 * away)
    lower, upper = np.array(config.box)
    return np.clip(
        swarm.positions + step + config.detour_noise_m * noise, lower + 0.05, upper - 0.05
    )


def _unit(vectors: FloatArray) -> FloatArray:
    """Vectors (N, 3) of length one, or zero where they were."""
    length = np.linalg.norm(vectors, axis=1, keepdims=True)
    return vectors / np.maximum(length, 1e-9)
