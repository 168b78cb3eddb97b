"""Train your own network by PPO of Stable-Baselines3: the same layers encode each neighbor.

Train it, fly it from Python, and evaluate it on the command line (pip install 'swarm-envs[train]'):

    python examples/own_network.py --steps 1000000
    swarm-envs evaluate --agent examples/own_network.py:Trained roundabout --episodes 64
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch
from stable_baselines3 import PPO
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
from torch import Tensor, nn

import swarm_envs
from swarm_envs.agents import fly_episode, from_model
from swarm_envs.envs.observation import observation_layout
from swarm_envs.envs.parallel import SwarmParallelEnv
from swarm_envs.training import SharedPolicyVecEnv

FILE, NEIGHBORS = Path("own_network.zip"), 3


class Pooled(BaseFeaturesExtractor):
    """The row of a drone, and the maximum over neighbors of each encoded feature."""

    def __init__(self, space: Any, features: int = 32) -> None:
        super().__init__(space, space.shape[0] + features)
        fields = [f for f in observation_layout(NEIGHBORS) if f.name.startswith("neighbor_")]
        self.where = slice(fields[0].where.start, fields[-1].where.stop)
        width = (self.where.stop - self.where.start) // NEIGHBORS
        self.encode = nn.Sequential(nn.Linear(width, 64), nn.ReLU(), nn.Linear(64, features))

    def forward(self, rows: Tensor) -> Tensor:
        """Return features (B, row width + 32) of observation rows (B, row width)."""
        neighbors = rows[:, self.where].reshape(len(rows), NEIGHBORS, -1)
        return torch.cat([rows, self.encode(neighbors).amax(dim=1)], dim=1)


NETWORK = {"features_extractor_class": Pooled, "log_std_init": -0.5}


class Trained:
    """The trained model as an agent, for the command line."""

    requires: Mapping[str, Any] = {"decision_rate": 10, "num_neighbors": NEIGHBORS}
    privileged = False

    def __init__(self) -> None:
        self.model = PPO.load(FILE, device="cpu", custom_objects={"policy_kwargs": NETWORK})

    def reset(self, env: SwarmParallelEnv, seed: int) -> None:
        """Begin an episode."""
        self._agent = from_model(self.model, env)

    def act(self, observations: Any, view: Any) -> Any:
        """Return an action for each drone."""
        return self._agent.act(observations, view)


def main(arguments: list[str] | None = None) -> None:
    """Train, and fly an episode."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--steps", type=int, default=1_000_000, help="decisions of single drones")
    parser.add_argument("--envs", type=int, default=64, help="number of teams in the batch")
    given = parser.parse_args(arguments)
    torch.set_num_threads(1)  # several times as fast for small networks
    env = SharedPolicyVecEnv("swap_v1", given.envs, seed=0, horizon_s=3.5, **Trained.requires)
    fast = {"n_steps": 32, "batch_size": 1024, "n_epochs": 5, "gamma": 0.98, "learning_rate": 1e-3}
    model = PPO("MlpPolicy", env, policy_kwargs=NETWORK, seed=0, device="cpu", **fast)
    model.learn(given.steps)
    model.save(FILE)
    eval_env = swarm_envs.make("swap_v1", physics="batch", **Trained.requires)
    print("success:", fly_episode(eval_env, Trained(), seed=0)["success"])


if __name__ == "__main__":
    main()
