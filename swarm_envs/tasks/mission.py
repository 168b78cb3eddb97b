"""An episode as a task draws it, and what is kept of it: starts, goals of every stage, motions."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from swarm_envs.compiled import borrowing_kernel
from swarm_envs.state import BoolArray, FloatArray, IntArray


class Orbit(NamedTuple):
    """Ellipses on which drones circle: center + first cos(angle) + second sin(angle)."""

    center: FloatArray
    """(N, 3) centres, m."""
    first: FloatArray
    """(N, 3) half axes to which angle zero points, m."""
    second: FloatArray
    """(N, 3) half axes to which a quarter turn points, m."""
    rate: FloatArray
    """(N,) angular rates, rad/s."""
    phase: FloatArray
    """(N,) angles at time zero, rad."""


class Placement(NamedTuple):
    """One episode of one environment, as a task draws it."""

    start: FloatArray
    """(N, 3) start positions, m."""
    goals: FloatArray
    """(S, N, 3) goal positions of each stage, m."""
    duration: float = 0.0
    """Seconds that the reference takes from one stage to the next; 0 if it rests at the goals."""
    orbit: Orbit | None = None
    """What the reference circles on, if it does."""


class Mission(NamedTuple):
    """What the task keeps of every environment's episode: arrays that lead with E."""

    start: FloatArray
    """(E, N, 3) start positions, m."""
    goals: FloatArray
    """(E, S, N, 3) goal positions of each stage, m."""
    duration: FloatArray
    """(E,) seconds that the reference takes from one stage to the next; 0 if it rests."""
    orbit: FloatArray
    """(E, N, 3, 3) centre, first and second half axis of the reference's ellipses, m."""
    rate: FloatArray
    """(E, N) angular rates on them, rad/s."""
    phase: FloatArray
    """(E, N) angles at time zero, rad."""
    stage: IntArray
    """(E,) the present stage."""
    goal: FloatArray
    """(E, N, 3) its goal positions, m; where the reference circles, where it is."""
    distance: FloatArray
    """(E, N) distance to the goal at the last decision, m."""
    held: BoolArray
    """(E,) whether the present stage is done."""
    reached: IntArray
    """(E,) how many stages are done."""

    def place(self, e: int, placement: Placement) -> None:
        """Keep a new episode of environment `e`, which `begin_mission` begins."""
        self.start[e], self.goals[e], self.duration[e] = placement[:3]
        if placement.orbit is not None:
            for k in range(3):
                self.orbit[e, :, k] = placement.orbit[k]
            self.rate[e], self.phase[e] = placement.orbit.rate, placement.orbit.phase


@borrowing_kernel
def begin_mission(e: int, mission: Mission) -> None:
    """Enter the first stage of environment `e`, the drones at their starts."""
    mission.stage[e], mission.reached[e], mission.held[e] = 0, 0, False
    for i in range(mission.start.shape[1]):
        square = 0.0
        for k in range(3):
            mission.goal[e, i, k] = mission.goals[e, 0, i, k]
            square += (mission.goal[e, i, k] - mission.start[e, i, k]) ** 2
        mission.distance[e, i] = math.sqrt(square)


def new_mission(num_envs: int, num_drones: int, num_stages: int = 1) -> Mission:
    """A mission whose environments have not begun."""
    shape = (num_envs, num_drones)
    return Mission(
        start=np.zeros((*shape, 3)),
        goals=np.zeros((num_envs, num_stages, num_drones, 3)),
        duration=np.zeros(num_envs),
        orbit=np.zeros((*shape, 3, 3)),
        rate=np.zeros(shape),
        phase=np.zeros(shape),
        stage=np.zeros(num_envs, dtype=np.int64),
        goal=np.zeros((*shape, 3)),
        distance=np.zeros(shape),
        held=np.zeros(num_envs, dtype=np.bool_),
        reached=np.zeros(num_envs, dtype=np.int64),
    )


def mission_of(placement: Placement) -> Mission:
    """The mission of a single environment that begins with a placement."""
    stages, drones, _ = placement.goals.shape
    mission = new_mission(1, drones, stages)
    mission.place(0, placement)
    begin_mission(0, mission)
    return mission
