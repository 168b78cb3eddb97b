"""Formations to learn from: any shape after any other, at several spacings.

Places are mostly drawn rather than matched, so that straight ways cross: what fails there are
collisions, as in swaps. What also has to be learned is that a drone below others sinks.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from swarm_envs.state import FloatArray
from swarm_envs.tasks.base import Task
from swarm_envs.tasks.formation import FormationTask, nearest_places
from swarm_envs.tasks.mission import Placement
from swarm_envs.tasks.motion import REST, Motion
from swarm_envs.tasks.placing import check_range
from swarm_envs.training.rl.config import TrainConfig


@dataclass(frozen=True)
class PracticeFormation(FormationTask):
    """One change of shape, from any of `shapes` to any, the same included; no reference."""

    nearest_share: float = 0.2
    """share of episodes in which places are matched to drones, as with labels='nearest'"""
    stretch: tuple[float, float] = (0.8, 1.0)
    """range from which the spacing of both shapes is drawn, over the task's own"""

    def __post_init__(self) -> None:
        """Refuse a share that is none, and shapes that are not stretched but blown up."""
        super().__post_init__()
        check_range("PracticeFormation.stretch", self.stretch)
        if not 0.0 <= self.nearest_share <= 1.0 or self.stretch[1] > 1.0:
            raise ValueError(
                f"PracticeFormation.nearest_share is {self.nearest_share} and stretch "
                f"{self.stretch}, but must lie in [0, 1]"
            )

    @property
    def num_stages(self) -> int:
        """One: practice is short."""
        return 1

    @property
    def motion(self) -> Motion:
        """Rest at the places."""
        return Motion(REST)

    def draw(
        self,
        rng: np.random.Generator,
        start: FloatArray | None = None,
        goal: FloatArray | None = None,
    ) -> Placement:
        """Draw two shapes, their turn and spacing, who starts where and who goes where."""
        count, n = len(self.places), len(self.team)
        stretch, angle = rng.uniform(*self.stretch), rng.uniform(*self.turn_rad)
        middle = (self.arena[0] + self.arena[1]) / 2
        c, s = np.cos(angle), np.sin(angle)
        turn = stretch * np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
        before, after = (
            middle + (self.places[k] - middle) @ turn for k in rng.integers(count, size=2)
        )
        matched = rng.random() < self.nearest_share
        here = before[rng.permutation(n)] if start is None else start
        order = nearest_places(here, after) if matched else rng.permutation(n)
        return Placement(here, after[order][None] if goal is None else goal[None])


def practise_formation(task: Task, config: TrainConfig) -> Task:
    """What training flies for a formation: as with swaps, unless hard starts are not wanted."""
    if not config.hard_starts:
        return task
    return PracticeFormation(team=task.team, reward_weights=task.reward_weights)
