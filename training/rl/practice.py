"""The environments of training: features for observations, and a tally of how episodes end."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt
from gymnasium import spaces
from stable_baselines3.common.vec_env import VecEnvWrapper

from swarm_envs.agents.feature_sets import FEATURE_SETS, TYPES
from swarm_envs.envs.options import Blueprint, batch_of
from swarm_envs.training.rl.config import TrainConfig
from swarm_envs.training.rl.recipes import RECIPES, completed
from swarm_envs.training.rl.side_by_side import SideBySide
from swarm_envs.training.shared_policy import SharedPolicyVecEnv

Infos = list[dict[str, Any]]
"""What a step adds for each sub-environment."""


def practice_blueprint(config: TrainConfig, task: str, team: Mapping[str, Any]) -> Blueprint:
    """What a team trains in: what the recipe practises, with a short clock.

    Args:
        config: of the run.
        task: its versioned name.
        team: one of `config.teams`.

    Raises:
        ValueError: the task has no recipe, or an option has an impossible value.
    """
    recipe, config = RECIPES[task], completed(config, task)
    given = {**recipe.reward_weights, "crash": -config.crash}
    weights = {name: weight * config.reward_scale for name, weight in given.items()}
    found = batch_of(
        task,
        **recipe.layouts[str(config.layout)],
        **team,
        reward_weights=weights,
        interactions=config.interactions,
        action=config.action,
        decision_rate=config.decision_rate,
        force_rate=config.force_rate,
        num_neighbors=config.num_neighbors,
        horizon_s=config.horizon_s,
        threads=config.threads,
    )
    return found._replace(task=recipe.practice(found.task, config))


class Practice(VecEnvWrapper):  # type: ignore[misc]  # SB3's base has no types here
    """Drones that learn: every row as its features, ends of episodes counted.

    Args:
        config: of the run.
        task: its versioned name.

    Raises:
        ValueError: an option has an impossible value.
    """

    def __init__(self, config: TrainConfig, task: str) -> None:
        blueprints = [practice_blueprint(config, task, team) for team in config.teams]
        share = config.environments // len(blueprints)
        parts = [SharedPolicyVecEnv(found, share) for found in blueprints]
        drones = SideBySide(parts)
        drones.seed(config.seed)
        self.cores = [part.core for part in parts]
        present = {vehicle.token for found in blueprints for vehicle in found.task.team}
        flown = tuple(token for token in TYPES if token in present)
        recipe, self._neighbors = RECIPES[task], config.num_neighbors
        self.features = recipe.features_of_types if len(flown) > 1 else recipe.features
        self.sizes = FEATURE_SETS[self.features].sizes(self._neighbors)
        self.types = flown if self.sizes.typed else ()
        if config.per_type and len(flown) < 2:
            raise ValueError(
                f"--per-type needs vehicles of several types, but all here are {flown[0]}; name a "
                "team such as --team SSLL"
            )
        super().__init__(drones, spaces.Box(-np.inf, np.inf, (self.sizes.width,), np.float32))
        self.clear()

    def weigh(self, weights: Mapping[str, float]) -> None:
        """Set weights of reward terms in every team's environments."""
        for core in self.cores:
            core.set_reward_weights(weights)

    def clear(self) -> None:
        """Begin to count anew."""
        self.episodes = self.successes = self.collisions = 0

    def told(self, rows: npt.NDArray[np.float32]) -> npt.NDArray[np.float32]:
        """What the network is told of observation rows (..., width)."""
        return FEATURE_SETS[self.features].make(rows, self._neighbors)

    def count(self, metrics: Mapping[str, Any]) -> None:
        """Count how an episode has ended."""
        self.episodes += 1
        self.successes += metrics["success"]
        self.collisions += metrics["collided_drones"] > 0

    def reset(self) -> npt.NDArray[np.float32]:
        """Begin new episodes everywhere."""
        return self.told(self.venv.reset())

    def step_wait(
        self,
    ) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.float32], npt.NDArray[np.bool_], Infos]:
        """Fly to the next decision, and count what has ended."""
        rows, rewards, ended, infos = self.venv.step_wait()
        over = np.flatnonzero(ended).tolist()
        if not over:
            return self.told(rows), rewards, ended, infos
        last = [infos[k]["terminal_observation"] for k in over]
        told = self.told(np.concatenate([rows, last]))
        for k, row in zip(over, told[len(rows) :], strict=True):
            infos[k]["terminal_observation"] = row
        ends = [infos[k]["episode_metrics"] for k in over]
        for metrics in {id(metrics): metrics for metrics in ends}.values():  # one a team
            self.count(metrics)
        return told[: len(rows)], rewards, ended, infos
