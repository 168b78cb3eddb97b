"""Define your own task and reward: drones fly to a line, upright.

Fly it, evaluate agents and train:

    python examples/own_task.py
    swarm-envs fly --task examples/own_task.py:LineTask --agent fast-line --out flight
    swarm-envs evaluate --task examples/own_task.py:LineTask --agent fast-line orca --episodes 64
    swarm-envs train --task examples/own_task.py:LineTask --algo ppo --out runs/line
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

import swarm_envs
from swarm_envs.agents import fly_episode, load
from swarm_envs.tables import World
from swarm_envs.tasks.base import Placement, Task
from swarm_envs.tasks.rewards import REWARD_WEIGHTS

Array = npt.NDArray[np.float64]
WEIGHTS = {**REWARD_WEIGHTS, "upright": 0.1}


@swarm_envs.register_task
@dataclass(frozen=True)
class LineTask(Task):
    """Fly from a circle to a line."""

    spacing_m: float = 0.5
    """Distance between neighbors on the line, m."""

    default_weights = WEIGHTS

    def draw(self, rng: np.random.Generator, start: Any = None, goal: Any = None) -> Placement:
        """Sample the starts and goals."""
        n = len(self.team)
        angle = rng.uniform(0.0, 2 * np.pi) + 2 * np.pi * np.arange(n) / n
        circle = np.stack([np.cos(angle), np.sin(angle), np.ones(n)], axis=1)
        along = self.spacing_m * (np.argsort(np.argsort(circle[:, 1])) - (n - 1) / 2)
        line = np.stack([np.zeros(n), along, np.ones(n)], axis=1)
        return Placement(circle if start is None else start, (line if goal is None else goal)[None])

    def reward_terms(self, world: World) -> dict[str, Array]:
        """Return the cosine of each drone's tilt (E, N), times the duration of a decision in s."""
        decision_s = world.environments["time"] / world.environments["decisions"]
        x, y = np.moveaxis(world.drones["quaternion"], -1, 0)[:2]
        return {"upright": decision_s[:, None] * (1.0 - 2.0 * (x**2 + y**2))}


def main() -> None:
    """Fly an episode, and print its success and the return of the first drone."""
    agent = load("fast-line")
    env = swarm_envs.make(LineTask, num_drones=5, **agent.requires)
    metrics = fly_episode(env, agent, seed=0)
    print("success:", metrics["success"], "after", metrics["time_to_goal_s"], "s")
    env.close()


if __name__ == "__main__":
    main()
