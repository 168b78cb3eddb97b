"""Agents that need no thought: they show that a loop works, and what doing nothing is worth."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any

import numpy as np

from swarm_envs.agents.protocol import Actions, Observations
from swarm_envs.envs.observation import Float32Array
from swarm_envs.envs.parallel import SwarmParallelEnv
from swarm_envs.envs.view import View
from swarm_envs.tasks.base import ACCELERATION_LIMIT, SPEED_LIMIT


class HoverAgent:
    """Stays where it starts: asks for no acceleration."""

    requires: Mapping[str, Any] = MappingProxyType({"action": "acceleration"})
    privileged = False

    def reset(self, env: SwarmParallelEnv, seed: int) -> None:
        """Nothing to prepare."""

    def act(self, observations: Observations, view: View | None) -> Actions:
        """Zeros for every drone."""
        return {agent: np.zeros(3, dtype=np.float32) for agent in observations}


class RandomAgent:
    """Draws every number evenly from [-1, 1]: in a space for which that is all there is."""

    requires: Mapping[str, Any] = MappingProxyType({})
    privileged = False

    def __init__(self) -> None:
        self._rng = np.random.default_rng(0)
        self._width = 0

    def reset(self, env: SwarmParallelEnv, seed: int) -> None:
        """Begin the draws that the seed stands for.

        Raises:
            ValueError: actions have no bounds, as set-points in SI.
        """
        space = env.action_space(env.possible_agents[0])
        if not space.is_bounded():
            raise ValueError(
                f"RandomAgent needs bounded actions, but action={env.core.config.action!r} has "
                "none; make the environment with action='acceleration'"
            )
        self._rng, self._width = np.random.default_rng(seed), int(space.shape[0])

    def act(self, observations: Observations, view: View | None) -> Actions:
        """New draws for every drone."""
        return {
            agent: self._rng.uniform(-1.0, 1.0, self._width).astype(np.float32)
            for agent in observations
        }


class StraightLineAgent:
    """Flies straight at its goal, whoever is in the way: a PD law on what it observes of itself.

    What any policy that avoids others must beat. The acceleration asked for is
    4 / s^2 (goal - position) - 4 / s velocity, the way to the goal cut at 1 m.
    """

    requires: Mapping[str, Any] = MappingProxyType(
        {"action": "acceleration", "observation": "flat", "decision_rate": 48}
    )
    privileged = False

    def __init__(self) -> None:
        self._goal = self._velocity = slice(0)

    def reset(self, env: SwarmParallelEnv, seed: int) -> None:
        """Note where observations have goal and velocity."""
        places = {field.name: field.where for field in env.observation_layout}
        self._goal, self._velocity = places["task.goal"], places["self.velocity"]

    def act(self, observations: Observations, view: View | None) -> Actions:
        """The acceleration of every drone, cut at what the environment allows."""
        actions = self.act_batch(np.stack(list(observations.values())))
        return dict(zip(observations, actions, strict=True))

    def act_batch(self, rows: Float32Array) -> Float32Array:
        """Actions (..., 3) for observation rows (..., row width)."""
        way, velocity = rows[..., self._goal], SPEED_LIMIT * rows[..., self._velocity]
        distance = np.sqrt(np.square(way).sum(axis=-1, keepdims=True))
        asked = 4.0 * way / np.maximum(distance, 1.0) - 4.0 * velocity
        size = np.abs(asked).max(axis=-1, keepdims=True) / ACCELERATION_LIMIT
        actions: Float32Array = (asked / ACCELERATION_LIMIT / np.maximum(size, 1.0)).astype(
            np.float32
        )
        return actions
