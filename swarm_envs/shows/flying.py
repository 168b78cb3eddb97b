"""A show flown by the tracking controller in an environment with forces: a task and its pilot."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from swarm_envs.agents import record_episode
from swarm_envs.control.config import ControllerConfig, Indi
from swarm_envs.envs.config import EnvConfig
from swarm_envs.envs.parallel import SwarmParallelEnv
from swarm_envs.envs.view import View
from swarm_envs.shows.choreography import Choreography
from swarm_envs.state import FloatArray
from swarm_envs.tasks.base import Placement, Success, Task
from swarm_envs.tasks.motion import Motion
from swarm_envs.tasks.swap import REWARD_WEIGHTS
from swarm_envs.vehicles import parse_team
from swarm_envs.viewing.record import Recording

__all__ = ["fly_show"]

_MARGIN_M = 2.0


@dataclass(frozen=True, eq=False)
class ShowTask(Task):
    """The paths of a show; its goals are where it ends."""

    paths: Choreography  # Where they should be at any time
    success: Success = Success()

    name = "show"
    default_weights = REWARD_WEIGHTS

    @property
    def arena(self) -> FloatArray:
        """Corners (2, 3) around all paths, m."""
        points = self.paths.points.reshape(-1, 3)
        low, high = points.min(axis=0) - _MARGIN_M, points.max(axis=0) + _MARGIN_M
        return np.array([[low[0], low[1], 0.0], high])

    @property
    def motion(self) -> Motion:
        """The goals rest."""
        return Motion()

    @property
    def episode_s(self) -> float:
        """Of the show, s."""
        return self.paths.duration_s

    def draw(
        self,
        rng: np.random.Generator,
        start: FloatArray | None = None,
        goal: FloatArray | None = None,
    ) -> Placement:
        """Begin and end of the paths.

        Raises:
            ValueError: a start or a goal is given.
        """
        if start is not None or goal is not None:
            raise ValueError("a start or goal is given, but those of a show are its paths'")
        points = self.paths.points
        return Placement(points[0, 0].copy(), points[-1, -1][None].copy())


class ShowPilot:
    """Gives the controller the paths as set-points; the controller is adaptive (INDI)."""

    privileged = True

    def __init__(self) -> None:
        controller = ControllerConfig(adaptation=Indi())
        self.requires: Mapping[str, Any] = {
            "action": "setpoint", "controller": controller, "decision_rate": 20,
        }  # fmt: skip
        self._paths: Choreography
        self._agents: list[str] = []

    def reset(self, env: SwarmParallelEnv, seed: int) -> None:
        """Take the paths of the task.

        Raises:
            ValueError: the task is no show.
        """
        task = env.core.task
        if not isinstance(task, ShowTask):
            raise ValueError(f"a show's pilot flies a ShowTask, not {task.name}")
        self._paths, self._agents = task.paths, list(env.possible_agents)

    def act(self, observations: Any, view: View | None) -> dict[str, Any]:
        """Position, velocity, acceleration and jerk of the paths; no yaw."""
        assert view is not None
        reference = self._paths.reference(view.time)
        rows = np.concatenate([*reference, np.zeros((len(self._agents), 2))], axis=1)
        return dict(zip(self._agents, rows, strict=True))


def fly_show(
    paths: Choreography,
    world: str = "hall",
    seed: int = 0,
    watch: Callable[[SwarmParallelEnv], None] | None = None,
) -> tuple[Recording, dict[str, Any]]:
    """Fly the paths with small drones, and say how near they came to each other.

    Args:
        paths: of N drones.
        world: `hall`, with random force, noise and delay, or `ideal`; the force is `learned`.
        seed: of the hall.
        watch: called after the reset and after every decision.

    Returns:
        The flight, and facts of it: `contacts`, `clearance_m` (least distance of two bodies),
        `worst_error_m` and `flown_s`.
    """
    pilot, task = ShowPilot(), ShowTask(parse_team("S" * paths.points.shape[2]), paths)
    config = EnvConfig(
        physics="batch", world=world, end_on_success=False, num_neighbors=0, **pilot.requires
    )
    env = SwarmParallelEnv(task, config)
    try:
        flight = record_episode(env, pilot, seed, watch=watch, name="show")
    finally:
        env.close()
    metrics, diameter = flight.about.metrics, task.team[0].diameter
    apart = metrics["minimum_separation_m"]
    wanted = paths.positions(flight.time)
    touched = (flight.contact_drone >= 0) | flight.contact_floor | flight.contact_wall
    return flight, {
        "contacts": int(touched.sum()),
        "clearance_m": None if apart is None else apart - diameter,
        "worst_error_m": float(np.linalg.norm(flight.position - wanted, axis=-1).max()),
        "flown_s": float(flight.time[-1]),
    }
