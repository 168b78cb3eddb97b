"""The environments of training: features for observations, and a tally of how episodes end."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt
from gymnasium import spaces
from stable_baselines3.common.vec_env import VecEnvWrapper

from swarm_envs.agents.features import FeatureSizes, features
from swarm_envs.envs.blueprints import batch_of
from swarm_envs.envs.options import Blueprint
from swarm_envs.tasks.swap import REWARD_WEIGHTS
from swarm_envs.training.rl.config import TrainConfig
from swarm_envs.training.rl.side_by_side import SideBySide
from swarm_envs.training.rl.starts import PracticeSwap
from swarm_envs.training.shared_policy import SharedPolicyVecEnv
from swarm_envs.vehicles import Team

Infos = list[dict[str, Any]]


def practice_blueprint(config: TrainConfig, task: str, team: Team) -> Blueprint:
    """What a team trains in: the task with a short clock and, if wanted, hard starts.

    Raises:
        ValueError: an option has an impossible value.
    """
    given = {**REWARD_WEIGHTS, "crash": -config.crash}
    weights = {name: weight * config.reward_scale for name, weight in given.items()}
    found = batch_of(
        task,
        team=team,
        layout=config.layout,
        reward_weights=weights,
        interactions=config.interactions,
        decision_rate=config.decision_rate,
        force_rate=config.force_rate,
        num_neighbors=config.num_neighbors,
        horizon_s=config.horizon_s,
        threads=config.threads,
    )
    if config.layout == "random" and config.hard_starts:
        practice = PracticeSwap(team=found.task.team, reward_weights=found.task.reward_weights)
        return found._replace(task=practice)
    return found


class Practice(VecEnvWrapper):  # type: ignore[misc]  # SB3's base has no types here
    """Drones that learn: every row as its features, ends of episodes counted.

    Args:
        config: of the run.
        task: its versioned name.
    """

    def __init__(self, config: TrainConfig, task: str) -> None:
        share = config.environments // len(config.teams)
        self._flown = [
            SharedPolicyVecEnv(practice_blueprint(config, task, team), share)
            for team in config.teams
        ]
        self.drones = SideBySide(self._flown)
        self.drones.seed(config.seed)
        self.sizes = FeatureSizes(config.num_neighbors, len(config.types) > 1)
        space = spaces.Box(-np.inf, np.inf, (self.sizes.width,), np.float32)
        super().__init__(self.drones, space)
        self.clear()

    def weigh(self, weights: Mapping[str, float]) -> None:
        """Set weights of reward terms in every team's environments."""
        for flown in self._flown:
            flown.core.set_reward_weights(weights)

    def clear(self) -> None:
        """Begin to count anew."""
        self.episodes = self.successes = self.collisions = 0

    def reset(self) -> npt.NDArray[np.float32]:
        """Begin new episodes everywhere."""
        return features(self.drones.reset(), *self.sizes)

    def step_wait(
        self,
    ) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.float32], npt.NDArray[np.bool_], Infos]:
        """Fly to the next decision, and count what has ended."""
        rows, rewards, ended, infos = self.drones.step_wait()
        over = np.flatnonzero(ended)
        if len(over):
            last = np.stack([infos[k]["terminal_observation"] for k in over])
            for k, row in zip(over, features(last, *self.sizes), strict=True):
                infos[k]["terminal_observation"] = row
            told = [infos[k]["episode_metrics"] for k in over]
            for metrics in {id(metrics): metrics for metrics in told}.values():  # one a team
                self.episodes += 1
                self.successes += metrics["success"]
                self.collisions += metrics["collided_drones"] > 0
        return features(rows, *self.sizes), rewards, ended, infos
