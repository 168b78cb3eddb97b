"""How every compute unit plans: priorities (Appendix A, in 8 bit), detours and trajectories."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from swarm_envs.baselines.mlr_dmpc.avoidance_planes import HalfSpaces, Neighbors, no_neighbors
from swarm_envs.baselines.mlr_dmpc.deadlock import (
    SwarmSnapshot,
    deadlocked,
    next_detours,
    no_detours,
)
from swarm_envs.baselines.mlr_dmpc.mlr_dmpc_config import MlrDmpcConfig
from swarm_envs.baselines.mlr_dmpc.trajectory import (
    Trajectory,
    end_position,
    sampled_positions,
    state_at,
)
from swarm_envs.baselines.mlr_dmpc.trajectory_qp import Planned, plan_trajectory
from swarm_envs.state import FloatArray, IntArray

TRIGGERS = ("HT", "RR", "DT")
"""The paper's rules of who is planned next: hybrid, round robin, distance."""
MEASURES = ("end", "next")
"""From where distances to the target count: the plan's end, or the next round's position."""

JUST_PLANNED = 0
"""Priority of a drone that has just been planned: it wins over the maximum."""
DEADLOCKED = 1
"""Priority of a drone in a deadlock."""
_LEAST, _MOST = 2, 254
REINITIALISED = 255
"""Priority of a drone whose trajectory begins anew."""
_FINEST, _COARSEST = 1e-4, 30.0

Levels = npt.NDArray[np.int64]
"""(N,) priorities as messages carry them, 8 bit."""


def _urgency(
    trigger: str, distances: FloatArray, ages: IntArray, num_units: int, config: MlrDmpcConfig
) -> FloatArray:
    """(N,) what priorities are made of, (A1)-(A3): `RR` age, `DT` distance, `HT` their product.

    Distances (N,) from the target, m, count as a share of the box's diagonal; ages (N,), rounds
    since a drone was last planned, as a share of N / M.
    """
    share = distances / float(np.linalg.norm(np.subtract(*config.box)))
    turns = ages * num_units / len(ages)
    return {"RR": turns, "DT": share, "HT": share * turns}[trigger]


def _levels(urgencies: FloatArray) -> Levels:
    """(N,) urgencies in 8 bit, from 2 to 254, finer where they are small; the order is kept."""
    scale = math.log1p(_COARSEST / _FINEST)
    share = np.minimum(np.log1p(urgencies / _FINEST) / scale, 1.0)
    return np.asarray(_LEAST + np.rint(share * (_MOST - _LEAST)), dtype=np.int64)


def consensus(own: Levels, others: Iterable[Mapping[int, int]]) -> Levels:
    """(N,) priorities of all units as one, (11): the largest, but zero where any says zero."""
    joint = own.copy()
    zero = own == JUST_PLANNED
    for theirs in others:
        for drone, level in theirs.items():
            joint[drone] = max(joint[drone], level)
            zero[drone] |= level == JUST_PLANNED
    joint[zero] = JUST_PLANNED
    return joint


def rank_by_priority(priorities: Levels, round_: int) -> list[int]:
    """Drones by priority, highest first; ties go round, so that nobody always comes last."""
    count = len(priorities)
    turn = (np.arange(count) - round_) % count
    return [int(i) for i in np.lexsort((turn, -priorities))]


Obstacles = Callable[[Trajectory, int], HalfSpaces | None]
"""Half-spaces for a drone that flies a trajectory and is planned from the start of a round on."""


class OtherTrajectory(NamedTuple):
    """A trajectory to keep clear of."""

    drone: int
    """Whose."""
    trajectory: Trajectory
    """What it may fly."""
    concurrent: bool
    """Whether it may be planned anew in the same round."""


@dataclass(frozen=True, kw_only=True)
class PlanningOptions:
    """How compute units plan."""

    config: MlrDmpcConfig
    """Parameters."""
    num_drones: int
    """N."""
    num_units: int
    """M."""
    trigger: str = "HT"
    """`HT`, `RR` or `DT`."""
    measure: str = "end"
    """Distances are from the `end` of the newest trajectory, or the `next` round's position."""
    solver: str = "daqp"
    """Of the programs."""
    seed: int = 0
    """Of detours' noise, alike for all units."""
    obstacles: Obstacles | None = None
    """Further half-spaces."""


class Planner:
    """Plans for one compute unit; remembers who makes room for whom."""

    def __init__(self, options: PlanningOptions) -> None:
        self.options = options
        self._detours = no_detours(options.num_drones)

    def prioritise(
        self, trajectories: Sequence[Trajectory | None], targets: FloatArray, round_: int
    ) -> Levels:
        """Priorities (N,) for plans that start in round k + 1; also decides who makes room.

        By each drone's newest candidate; one without counts as at its target (N, 3).
        """
        options, config = self.options, self.options.config
        swarm, ages = _snapshot(trajectories, targets, round_, config)
        rng = np.random.default_rng((options.seed, round_))
        self._detours = next_detours(self._detours, swarm, round_, config, rng)
        self._targets = self._detours.current(targets)
        points = swarm.ends if options.measure == "end" else swarm.positions
        distances = np.linalg.norm(self._targets - points, axis=1)
        urgencies = _urgency(options.trigger, distances, ages, options.num_units, config)
        out = _levels(urgencies)
        speeds = np.linalg.norm(swarm.velocities, axis=1)
        out[deadlocked(swarm.ends, speeds, self._targets, config)] = DEADLOCKED
        return out

    def plan(
        self,
        drone: int,
        own: Trajectory,
        others: Sequence[OtherTrajectory],
        unit: int,
        round_: int,
        planes: Sequence[HalfSpaces] = (),
    ) -> Planned:
        """Plan anew for a drone that flies `own`, from round k + 1 on.

        `others`: all that other drones may fly. `planes`: further half-spaces.
        """
        options, start = self.options, round_ + 1
        neighbors = no_neighbors(options.config)
        if others:
            neighbors = Neighbors(
                np.stack([sampled_positions(r.trajectory, start, options.config) for r in others]),
                np.array([r.drone for r in others], dtype=np.int64),
                np.array([r.concurrent for r in others], dtype=bool),
            )
        walls = None if options.obstacles is None else options.obstacles(own, start)
        return plan_trajectory(
            own,
            start,
            unit,
            neighbors,
            self._targets[drone],
            options.config,
            options.solver,
            planes if walls is None else [*planes, walls],
        )


def _snapshot(
    trajectories: Sequence[Trajectory | None],
    targets: FloatArray,
    round_: int,
    config: MlrDmpcConfig,
) -> tuple[SwarmSnapshot, np.ndarray[tuple[int], np.dtype[np.int64]]]:
    count = len(trajectories)
    states = np.zeros((count, 3, 3))
    states[:, 0] = targets
    ends = targets.copy()
    ages = np.zeros(count, dtype=np.int64)
    for i, trajectory in enumerate(trajectories):
        if trajectory is not None:
            start = trajectory.identity.start_round
            states[i] = state_at(trajectory, max(round_ + 1, start), config)
            ends[i] = end_position(trajectory, config)
            ages[i] = round_ + 1 - start
    return SwarmSnapshot(states[:, 0], states[:, 1], ends, targets), ages
