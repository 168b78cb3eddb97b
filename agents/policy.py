"""Trained policies as agents: what they were trained for is checked, and numpy is all they need."""

from __future__ import annotations

from collections.abc import Mapping
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np

from swarm_envs.agents.feature_sets import FEATURE_SETS
from swarm_envs.agents.networks import act
from swarm_envs.agents.policy_file import Policy, read_policy
from swarm_envs.agents.protocol import Actions, Observations, check_requirements
from swarm_envs.envs.observation import Float32Array
from swarm_envs.envs.parallel import SwarmParallelEnv
from swarm_envs.envs.view import View

FILE = "policy.safetensors"
"""Name of the policy in the folder of a training run."""
CHECKPOINT = "checkpoint.safetensors"
"""Name of what a killed run goes on from, beside it."""


class PolicyAgent:
    """Every drone flown by one network, each by what it observes itself.

    Args:
        policy: the network and what it was trained for.
    """

    privileged = False

    def __init__(self, policy: Policy) -> None:
        note = policy.note
        self.policy = policy
        self.digest = policy.digest
        self.requires: Mapping[str, Any] = {
            "action": note.action,
            "decision_rate": note.decision_rate,
            "observation": "flat",
            "num_neighbors": note.num_neighbors,
            "num_obstacles": 0,
        }

    @classmethod
    def load(cls, path: Path) -> PolicyAgent:
        """The agent in a file, or in the folder of a training run.

        Raises:
            FileNotFoundError: there is no such file.
            ValueError: it is damaged, a pickle, or of another version; the message says which.
        """
        if (path / CHECKPOINT).is_file() and not (path / FILE).exists():
            raise FileNotFoundError(
                f"the training run in {str(path)!r} has kept no policy yet; the same `swarm-envs "
                "train` goes on with it"
            )
        return cls(read_policy(path / FILE if path.is_dir() else path))

    def reset(self, env: SwarmParallelEnv, seed: int) -> None:
        """Check that this is what the policy was trained for; it draws nothing at random.

        Raises:
            ValueError: another task, action or observation, more or fewer drones, types that it
                was not trained with, or obstacles.
        """
        check_requirements(env, self)
        note, task = self.policy.note, env.core.task
        if task.name != note.task:
            raise ValueError(
                f"this policy was trained for task {note.task!r}, but the environment's is "
                f"{task.name!r}; train one for it by `swarm-envs train`"
            )
        if not note.fewest <= env.core.num_drones <= note.drones:
            raise ValueError(
                f"this policy was trained for teams of {note.teams} drones, but the environment "
                f"has {env.core.num_drones}; train one with such teams too by "
                f"`swarm-envs train --drones {note.drones} {env.core.num_drones}`"
            )
        others = {vehicle.token for vehicle in task.team} - set(note.types)
        if note.types and others:
            raise ValueError(
                f"this policy was trained for vehicles {', '.join(note.types)}, but the team has "
                f"{', '.join(sorted(others))}; train one with them by `swarm-envs train --team`"
            )
        if task.obstacles:
            raise ValueError("this policy was trained without obstacles, and does not see any")

    def act(self, observations: Observations, view: View | None) -> Actions:
        """The mean of what the policy would draw, for every drone."""
        actions = self.act_batch(np.stack(list(observations.values())))
        return dict(zip(observations, actions, strict=True))

    def act_batch(self, rows: Float32Array) -> Float32Array:
        """Actions (..., width) for observation rows (..., row width) of any number of drones.

        Raises:
            ValueError: the rows have another width.
        """
        note = self.policy.note
        values = FEATURE_SETS[note.features].make(rows, note.num_neighbors)
        actions: Float32Array = np.clip(act(self.policy.networks, values, note.sizes), -1.0, 1.0)
        return actions


def _shipped(name: str) -> PolicyAgent:
    weights = resources.files("swarm_envs.agents").joinpath("weights")
    with resources.as_file(weights.joinpath(f"{name}.safetensors")) as path:
        return PolicyAgent.load(path)


def swap_ppo() -> PolicyAgent:
    """The policy that ships for swaps of four drones; see `weights/MODEL_CARD.md`."""
    return _shipped("swap-ppo")


def swap_ppo_8() -> PolicyAgent:
    """The policy that ships for swaps of two to eight drones; see `weights/MODEL_CARD.md`."""
    return _shipped("swap-ppo-8")


def formation_ppo() -> PolicyAgent:
    """The policy that ships for formations of six to eight drones; see `weights/MODEL_CARD.md`."""
    return _shipped("formation-ppo")


def ring_ppo() -> PolicyAgent:
    """The policy that ships for rings of up to five drones; see `weights/MODEL_CARD.md`."""
    return _shipped("ring-ppo")
