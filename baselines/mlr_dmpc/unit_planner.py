"""The planner of a compute unit: priorities (Appendix A, in 8 bit), detours and trajectories.

A drone at rest is in a deadlock if contacts with others balance its pull to the target (Chen et al.
2024, Theorem 1 and eq. (13), as in the paper's Appendix A.4): at rest, by the optimality conditions
of program (13) of DMPC-Swarm, the pull is balanced by a sum of repelling contact forces.

Other drones then make room (Appendix B.1). In the paper, this starts when the whole swarm is at
rest. Here, it starts when a drone is at rest and its plan ends away from its target, so that a
deadlock need not wait for drones that fly elsewhere.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.spatial import cKDTree

from swarm_envs.baselines.mlr_dmpc.avoidance_planes import HalfSpaces, Neighbors
from swarm_envs.baselines.mlr_dmpc.mlr_dmpc_config import MlrDmpcConfig
from swarm_envs.baselines.mlr_dmpc.trajectory import Trajectory, states_by_round
from swarm_envs.baselines.mlr_dmpc.trajectory_qp import Planned, plan_trajectory
from swarm_envs.state import BoolArray, FloatArray, IntArray

_WALLS = np.concatenate([np.eye(3), -np.eye(3)])  # Inward normals of the faces of the box


def deadlocked(
    ends: FloatArray, speeds: FloatArray, targets: FloatArray, config: MlrDmpcConfig
) -> BoolArray:
    """Return (N,) True for drones in a deadlock, by ends of plans (N, 3) and speeds (N,).

    A drone is in a deadlock if it is slower than `deadlock_speed`, its plan ends farther than
    `deadlock_m` from its target, and repelling contact forces balance the pull of its target up to
    `deadlock_residual` of it. Drones at rest within `contact_factor` times the distance, and walls
    of the box, are in contact.
    """
    still, pull = speeds <= config.deadlock_speed, targets - ends
    length, distance = np.linalg.norm(pull, axis=1), config.sampled_distance_m
    scaled, resting = ends * config.inverse_scaling, np.flatnonzero(still)
    found = cKDTree(scaled[resting]).query_pairs(
        config.contact_factor * distance, output_type="ndarray"
    )
    pairs = np.concatenate([resting[found], resting[found[:, ::-1]]])
    low, high = np.array(config.box)
    near_m = (config.contact_factor - 1.0) * distance
    walls = np.concatenate([ends - low, high - ends], axis=1) <= near_m
    touches = np.isin(np.arange(len(ends)), pairs) | walls.any(axis=1)
    out = still & (length > config.deadlock_m) & touches
    for i in np.flatnonzero(out).tolist():
        others = pairs[pairs[:, 0] == i, 1]
        contacts = (scaled[i] - scaled[others]) * config.inverse_scaling, _WALLS[walls[i]]
        left = unbalanced(pull[i] / length[i], np.concatenate(contacts))
        out[i] = left <= config.deadlock_residual
    return out


def unbalanced(pull: FloatArray, contacts: FloatArray) -> float:
    """Return the residual of a pull (3,) against non-negative forces along contacts (K, 3)."""
    from scipy.optimize import nnls

    lengths = np.linalg.norm(contacts, axis=1)
    along = lengths > 1e-9  # Equal ends have no direction of contact
    if not along.any():
        return float(np.linalg.norm(pull))
    return float(nnls((contacts[along] / lengths[along, None]).T, -pull)[1])


NOBODY = -1  # In `_Detours.for_whom`, for a drone that makes no room


class _Detours(NamedTuple):
    """The drones that make room at present."""

    # (N,) the drone that each makes room for, itself if it steps aside, or `NOBODY`
    for_whom: IntArray
    # (N, 3) the targets of detours, m; meaningless for drones that make no room
    targets: FloatArray
    since: IntArray  # (N,) the round at which each last began to make room

    def current(self, targets: FloatArray) -> FloatArray:
        """Return the present targets (N, 3), m, for own targets (N, 3)."""
        return np.where((self.for_whom == NOBODY)[:, None], targets, self.targets)


class SwarmSnapshot(NamedTuple):
    """The state of the swarm that the planner uses."""

    positions: FloatArray  # (N, 3) when round k + 1 begins, m
    velocities: FloatArray  # (N, 3) when round k + 1 begins, m/s
    ends: FloatArray  # (N, 3) the ends of the plans, m
    targets: FloatArray  # (N, 3) own targets, m


def no_detours(n: int) -> _Detours:
    """Return detours in which no drone makes room."""
    return _Detours(np.full(n, NOBODY), np.zeros((n, 3)), np.full(n, -(10**6)))


def next_detours(
    detours: _Detours,
    swarm: SwarmSnapshot,
    round_index: int,
    config: MlrDmpcConfig,
    rng: np.random.Generator,
) -> _Detours:
    """Return the detours from now on; a pure function of its arguments and the generator's state.

    Drone i makes room for the nearest drone j in a deadlock that is within range and no nearer to
    its target than i, if i is ahead of j, approaches it, or must pass it. It moves to the side of
    j's path until j's plan ends at its target, but for at most `detour_rounds`; with fixed planes,
    for all of them. In App. B.1 it does so until the deadlock resolves or these conditions end, and
    moves away from j, with noise; here it moves beside j's path. If no drone makes room for one in
    a deadlock, it steps aside itself. Drones near their targets stay there. The same number of
    draws is made for every drone, needed or not.
    """
    noise = rng.normal(size=(len(swarm.positions), 3))
    speeds = np.linalg.norm(swarm.velocities, axis=1)
    stuck = deadlocked(swarm.ends, speeds, swarm.targets, config)
    age = round_index - detours.since
    keep = (detours.for_whom != NOBODY) & (age < config.detour_rounds)
    if config.planes == "relinearised":
        left = np.linalg.norm(swarm.targets - swarm.ends, axis=1)
        keep &= left[detours.for_whom] > config.deadlock_m
    free = ~keep & (age >= config.detour_rounds + config.detour_pause_rounds)
    for_whom = _whom(swarm, stuck & ~keep, config)
    served = np.isin(np.arange(len(stuck)), for_whom[free]) | np.isin(
        np.arange(len(stuck)), detours.for_whom[keep]
    )
    alone = stuck & (for_whom == NOBODY) & ~served
    for_whom[alone] = np.flatnonzero(alone)
    begins = free & (for_whom != NOBODY)
    places = _places(swarm, for_whom, noise, config)
    return _Detours(
        np.where(begins, for_whom, np.where(keep, detours.for_whom, NOBODY)),
        np.where(begins[:, None], places, detours.targets),
        np.where(begins, round_index, detours.since),
    )


def _whom(swarm: SwarmSnapshot, stuck: BoolArray, config: MlrDmpcConfig) -> IntArray:
    """Return (N,) the nearest of the stuck (N,) that each should make room for, or `NOBODY`."""
    index, others = np.arange(len(stuck)), np.flatnonzero(stuck)
    if not len(others):
        return np.full(len(stuck), NOBODY)
    position, left = swarm.positions, swarm.targets - swarm.positions
    distance = np.linalg.norm(left, axis=1)
    between = position[:, None] - position[others]
    gap = np.linalg.norm(between, axis=-1)
    ahead = np.einsum("ijk,jk->ij", between, left[others]) > 0.5 * gap * distance[others]
    closing = np.einsum("ijk,ik->ij", between, swarm.velocities) < 0.0
    passes = np.einsum("ijk,ik->ij", between, left) < -0.5 * gap * distance[:, None]
    at_target = distance <= 0.9 * config.sampled_distance_m
    allowed = (gap < config.detour_range_m) & (ahead | closing | passes)
    allowed &= (distance[:, None] <= distance[others]) & ~at_target[:, None]
    allowed &= (distance[:, None] != distance[others]) | (index[:, None] < others)
    nearest = others[np.argmin(np.where(allowed, gap, np.inf), axis=1)]
    return np.where(allowed.any(axis=1), nearest, NOBODY)


def _places(
    swarm: SwarmSnapshot, for_whom: IntArray, noise: FloatArray, config: MlrDmpcConfig
) -> FloatArray:
    """Return the targets (N, 3) of detours: away from the other drone, beside its path, m."""
    other = np.maximum(for_whom, 0)
    ahead = _unit(swarm.targets[other] - swarm.positions[other])
    away = _unit(swarm.positions - swarm.positions[other])
    side = away + 0.5 * noise
    side -= np.sum(side * ahead, axis=1, keepdims=True) * ahead
    step = config.detour_step_m * _unit(_unit(side) + 0.5 * away)
    lower, upper = np.array(config.box)
    return np.clip(
        swarm.positions + step + config.detour_noise_m * noise, lower + 0.05, upper - 0.05
    )


def _unit(vectors: FloatArray) -> FloatArray:
    """Return vectors (N, 3) of length one; zero stays zero."""
    length = np.linalg.norm(vectors, axis=1, keepdims=True)
    return vectors / np.maximum(length, 1e-9)


JUST_PLANNED = 0  # Priority of a drone that has just been planned, which overrides all others
DEADLOCKED = 1  # Priority of a drone in a deadlock
_LEAST, _MOST = 2, 254
REINITIALISED = 255  # Priority of a drone whose trajectory restarts
_FINEST, _COARSEST = 1e-4, 30.0
_AGE_ROUNDS = 4  # Rounds that `WT` adds to ages

Levels = npt.NDArray[np.int64]  # (N,) priorities as messages carry them, 8 bit


def _urgency(
    distances: FloatArray, ages: IntArray, num_units: int, config: MlrDmpcConfig
) -> FloatArray:
    """Return urgencies (N,), the event triggers (A1)-(A3): `RR` age, `DT` distance, `HT` both.

    `WT` is between `HT` and `DT`: ages count four rounds more, so that a drone whose plan still
    ends far from its target is planned again before all others had their turn. Distances (N,) from
    the target, m, are divided by the box's diagonal; ages (N,), the rounds since a drone was last
    planned, by N / M.
    """
    share = distances / float(np.linalg.norm(np.subtract(*config.box)))
    turns = ages * num_units / len(ages)
    weighted = share * (turns + _AGE_ROUNDS * num_units / len(ages))
    return {"WT": weighted, "RR": turns, "DT": share, "HT": share * turns}[config.trigger]


def prio_consensus(own: Levels, others: Iterable[Mapping[int, int]]) -> Levels:
    """Return the joint priorities (N,): prioConsensus of Algorithm 1, (11), the largest.

    They are zero if any unit sends zero (Appendix A): that drone was just planned.
    """
    joint = own.copy()
    zero = own == JUST_PLANNED
    for theirs in others:
        for drone, level in theirs.items():
            joint[drone] = max(joint[drone], level)
            zero[drone] |= level == JUST_PLANNED
    joint[zero] = JUST_PLANNED
    return joint


def rank_by_priority(priorities: Levels, round_: int) -> list[int]:
    """Return drones by priority, highest first: selectUAV of Algorithm 1.

    The first M are A_ET(k), which may be planned; selectUAV takes number (k + w) mod M of them. The
    order of ties rotates with the round, so that no drone is always last.
    """
    count = len(priorities)
    turn = (np.arange(count) - round_) % count
    return [int(i) for i in np.lexsort((turn, -priorities))]


Obstacles = Callable[[Trajectory, int], HalfSpaces | None]
"""A function from a drone's present trajectory and the first round of its plan to half-spaces."""


@dataclass(frozen=True, kw_only=True)
class PlanningOptions:
    """The options of all compute units' planners."""

    config: MlrDmpcConfig
    """The parameters."""
    num_drones: int
    """The number N of drones."""
    num_units: int
    """The number M of compute units."""
    seed: int = 0
    """The seed of the noise of detours, the same for all units."""
    obstacles: Obstacles | None = None
    """The half-spaces of obstacles, or None."""


class Planner:
    """The planner of one compute unit, which stores the present detours."""

    def __init__(self, options: PlanningOptions) -> None:
        self.options = options
        self._detours = no_detours(options.num_drones)

    def prioritise(
        self, trajectories: Sequence[Trajectory | None], targets: FloatArray, round_: int
    ) -> Levels:
        """Return priorities (N,) for plans from round k + 1 on: calcPrio of Algorithm 1.

        They follow from the newest candidates. The detours are updated too.
        """
        options, config = self.options, self.options.config
        swarm, ages = _snapshot(trajectories, targets, round_, config)
        rng = np.random.default_rng((options.seed, round_))
        self._detours = next_detours(self._detours, swarm, round_, config, rng)
        self._targets = self._detours.current(targets)
        points = swarm.ends if config.measure == "end" else swarm.positions
        distances = np.linalg.norm(self._targets - points, axis=1)
        urgencies = _urgency(distances, ages, options.num_units, config)
        # 8 bit, from 2 to 254, with finer steps for small urgencies; the order is kept.
        share = np.minimum(np.log1p(urgencies / _FINEST) / math.log1p(_COARSEST / _FINEST), 1.0)
        out = np.asarray(_LEAST + np.rint(share * (_MOST - _LEAST)), dtype=np.int64)
        speeds = np.linalg.norm(swarm.velocities, axis=1)
        out[deadlocked(swarm.ends, speeds, self._targets, config)] = DEADLOCKED
        return out

    def plan(
        self,
        drone: int,
        own: Trajectory,
        neighbors: Neighbors,
        unit: int,
        round_: int,
        planes: Sequence[HalfSpaces] = (),
    ) -> Planned:
        """Plan from round k + 1 on for a drone that flies `own`, as `plan_trajectory` does."""
        options, start = self.options, round_ + 1
        walls = None if options.obstacles is None else options.obstacles(own, start)
        return plan_trajectory(
            own,
            start,
            unit,
            neighbors,
            self._targets[drone],
            options.config,
            planes if walls is None else [*planes, walls],
        )


def _snapshot(
    trajectories: Sequence[Trajectory | None],
    targets: FloatArray,
    round_: int,
    config: MlrDmpcConfig,
) -> tuple[SwarmSnapshot, IntArray]:
    count = len(trajectories)
    states = np.zeros((count, 3, 3))
    states[:, 0] = targets
    ends = targets.copy()
    ages = np.zeros(count, dtype=np.int64)
    for i, trajectory in enumerate(trajectories):
        if trajectory is not None:
            start = trajectory.identity.start_round
            flown = states_by_round(trajectory, config.round_s, config.horizon_rounds)
            states[i] = flown[min(max(round_ + 1 - start, 0), config.horizon_rounds)]
            ends[i] = flown[-1, 0]
            ages[i] = round_ + 1 - start
    return SwarmSnapshot(states[:, 0], states[:, 1], ends, targets), ages
