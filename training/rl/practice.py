"""The environments of training: features for observations, and a tally of how episodes end."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt
from gymnasium import spaces
from stable_baselines3.common.vec_env import VecEnvWrapper

from swarm_envs.agents.feature_sets import FEATURE_SETS, FeatureForm
from swarm_envs.envs.blueprints import batch_of
from swarm_envs.envs.options import Blueprint
from swarm_envs.training.rl.config import TrainConfig
from swarm_envs.training.rl.recipes import RECIPES, completed, told_in
from swarm_envs.training.rl.side_by_side import SideBySide
from swarm_envs.training.shared_policy import SharedPolicyVecEnv
from swarm_envs.vehicles import Team

Infos = list[dict[str, Any]]


def practice_blueprint(config: TrainConfig, task: str, team: Team) -> Blueprint:
    """What a team trains in: what the recipe practises, with a short clock.

    Raises:
        ValueError: the task has no recipe, or an option has an impossible value.
    """
    recipe, config = RECIPES[task], completed(config, task)
    given = {**recipe.reward_weights, "crash": -config.crash}
    weights = {name: weight * config.reward_scale for name, weight in given.items()}
    found = batch_of(
        task,
        **recipe.layouts[str(config.layout)],
        team=team,
        reward_weights=weights,
        interactions=config.interactions,
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
    """

    def __init__(self, config: TrainConfig, task: str) -> None:
        share = config.environments // len(config.teams)
        self.flown = [
            SharedPolicyVecEnv(practice_blueprint(config, task, team), share)
            for team in config.teams
        ]
        self.drones = SideBySide(self.flown)
        self.drones.seed(config.seed)
        self._set, self._neighbors = FEATURE_SETS[told_in(config, task)], config.num_neighbors
        width = self._set.width(self._neighbors)
        super().__init__(self.drones, spaces.Box(-np.inf, np.inf, (width,), np.float32))
        self.clear()

    @property
    def form(self) -> FeatureForm:
        """Where features have what."""
        return self._set.form

    def weigh(self, weights: Mapping[str, float]) -> None:
        """Set weights of reward terms in every team's environments."""
        for flown in self.flown:
            flown.core.set_reward_weights(weights)

    def clear(self) -> None:
        """Begin to count anew."""
        self.episodes = self.successes = self.collisions = 0

    def told(self, rows: npt.NDArray[np.float32]) -> npt.NDArray[np.float32]:
        """What the network is told of observation rows (..., width)."""
        return self._set.make(rows, self._neighbors)

    def count(self, metrics: Mapping[str, Any]) -> None:
        """Count how an episode has ended."""
        self.episodes += 1
        self.successes += metrics["success"]
        self.collisions += metrics["collided_drones"] > 0

    def reset(self) -> npt.NDArray[np.float32]:
        """Begin new episodes everywhere."""
        return self.told(self.drones.reset())

    def step_wait(
        self,
    ) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.float32], npt.NDArray[np.bool_], Infos]:
        """Fly to the next decision, and count what has ended."""
        rows, rewards, ended, infos = self.drones.step_wait()
        over = np.flatnonzero(ended)
        if len(over):
            last = np.stack([infos[k]["terminal_observation"] for k in over])
            for k, row in zip(over, self.told(last), strict=True):
                infos[k]["terminal_observation"] = row
            ends = [infos[k]["episode_metrics"] for k in over]
            for metrics in {id(metrics): metrics for metrics in ends}.values():  # one a team
                self.count(metrics)
        return self.told(rows), rewards, ended, infos
