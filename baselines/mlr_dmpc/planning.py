"""What every kind of compute unit does with what it knows: priorities, detours, and plans."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from swarm_envs.baselines.mlr_dmpc.config import MlrDmpcConfig
from swarm_envs.baselines.mlr_dmpc.deadlock import deadlocked
from swarm_envs.baselines.mlr_dmpc.detour import Snapshot, next_detours, no_detours
from swarm_envs.baselines.mlr_dmpc.neighbors import HalfSpaces, Neighbors, no_neighbors
from swarm_envs.baselines.mlr_dmpc.plan import Planned, plan_trajectory
from swarm_envs.baselines.mlr_dmpc.samples import end_position, sampled, state_at
from swarm_envs.baselines.mlr_dmpc.trajectory import Trajectory
from swarm_envs.baselines.mlr_dmpc.triggers import DEADLOCKED, Levels, levels, urgency
from swarm_envs.state import FloatArray

Obstacles = Callable[[Trajectory, int], HalfSpaces | None]
"""Half-spaces for a drone that flies a trajectory and is planned from the start of a round on."""


class Rival(NamedTuple):
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

    def look(
        self, trajectories: Sequence[Trajectory | None], targets: FloatArray, round_: int
    ) -> Levels:
        """Priorities (N,) of a round by what is known; also decides who makes room.

        Args:
            trajectories: the newest candidate of each drone, None where nothing is known: such a
                drone counts as at its target.
            targets: (N, 3) m.
            round_: k; plans start at k + 1.
        """
        options, config = self.options, self.options.config
        swarm, ages = _snapshot(trajectories, targets, round_, config)
        rng = np.random.default_rng((options.seed, round_))
        self._detours = next_detours(self._detours, swarm, round_, config, rng)
        self._targets = self._detours.current(targets)
        points = swarm.ends if options.measure == "end" else swarm.positions
        distances = np.linalg.norm(self._targets - points, axis=1)
        urgencies = urgency(options.trigger, distances, ages, options.num_units, config)
        out = levels(urgencies)
        speeds = np.linalg.norm(swarm.velocities, axis=1)
        out[deadlocked(swarm.ends, speeds, self._targets, config)] = DEADLOCKED
        return out

    def plan(
        self,
        drone: int,
        own: Trajectory,
        rivals: Sequence[Rival],
        unit: int,
        round_: int,
        planes: HalfSpaces | None = None,
    ) -> Planned:
        """Plan anew for a drone.

        Args:
            drone: whom.
            own: what it flies.
            rivals: all that the others may fly.
            unit: the author.
            round_: k; the plan starts at k + 1.
            planes: further half-spaces.
        """
        options, start = self.options, round_ + 1
        neighbors = no_neighbors(options.config)
        if rivals:
            neighbors = Neighbors(
                np.stack([sampled(r.trajectory, start, options.config) for r in rivals]),
                np.array([r.drone for r in rivals], dtype=np.int64),
                np.array([r.concurrent for r in rivals], dtype=bool),
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
            joined(planes, walls),
        )


def joined(one: HalfSpaces | None, other: HalfSpaces | None) -> HalfSpaces | None:
    """The half-spaces of both."""
    if one is None or other is None:
        return one if other is None else other
    return HalfSpaces(*(np.concatenate(pair) for pair in zip(one, other, strict=True)))


def _snapshot(
    trajectories: Sequence[Trajectory | None],
    targets: FloatArray,
    round_: int,
    config: MlrDmpcConfig,
) -> tuple[Snapshot, np.ndarray[tuple[int], np.dtype[np.int64]]]:
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
    return Snapshot(states[:, 0], states[:, 1], ends, targets), ages
