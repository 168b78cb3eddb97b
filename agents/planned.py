"""What agents share that plan the team's way to every set of goals, and then fly the plan."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import Any, Generic, Protocol, TypeVar

import numpy as np

from swarm_envs.agents.protocol import Actions, Observations
from swarm_envs.envs.parallel import SwarmParallelEnv
from swarm_envs.envs.view import View
from swarm_envs.tasks.base import Task
from swarm_envs.tasks.motion import ORBITS
from swarm_envs.trajectories import Reference


class Flyable(Protocol):
    """A plan that says where everyone should be."""

    def reference(self, time: float) -> Reference:
        """Where the drones should be at a time since the start, s: arrays (N, 3)."""


P = TypeVar("P", bound=Flyable)


class PlannedAgent(ABC, Generic[P]):
    """Plans when goals are set, and emits the plan's set-points.

    Args:
        requires: options of the environment.
    """

    privileged = True

    def __init__(self, requires: Mapping[str, Any]) -> None:
        self.requires = requires
        self.plans: list[P] = []
        """The episode's plans, one for each set of goals."""
        self._agents: list[str] = []
        self._task: Task | None = None
        self._goals, self._began, self._seed = np.zeros((0, 3)), 0.0, 0

    @abstractmethod
    def plan(self, task: Task, view: View, seed: int) -> P:
        """The way from the set-points of this moment to the goals."""

    def check(self, task: Task) -> None:
        """Refuse a task to which there is no plan.

        Raises:
            ValueError: goals that circle.
        """
        if task.motion.kind == ORBITS:
            raise ValueError(
                f"{type(self).__name__} plans to goals at rest, but those of {task.name} circle; "
                "use swap or formation, or the agent 'tracking-compensated'"
            )

    def reset(self, env: SwarmParallelEnv, seed: int) -> None:
        """Plan the way to the first goals; the seed is that of the planner.

        Raises:
            ValueError: there is no plan for such a task, or for these starts and goals.
        """
        task = env.core.task
        self.check(task)
        self._agents, self._task, self._seed, self.plans = list(env.agents), task, seed, []
        self._plan(env.view)

    def act(self, observations: Observations, view: View | None) -> Actions:
        """Position, velocity, acceleration and jerk of the plan; no yaw.

        Raises:
            ValueError: there is no view, without which goals are unknown.
        """
        if view is None:
            raise ValueError(
                f"{type(self).__name__} is privileged: pass env.view as the view, for its goals"
            )
        if not np.array_equal(view.goals, self._goals):
            self._plan(view)
        reference = self.plans[-1].reference(view.time - self._began)
        rows = np.concatenate([*reference, np.zeros((len(self._agents), 2))], axis=1)
        return dict(zip(self._agents, rows, strict=True))

    def _plan(self, view: View) -> None:
        assert self._task is not None
        self._goals, self._began = view.goals.copy(), view.time
        self.plans.append(self.plan(self._task, view, self._seed))
