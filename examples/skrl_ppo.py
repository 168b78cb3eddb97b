"""Train a team as one agent by PPO of skrl, with a batch of teams.

pip install 'swarm-envs[train]' skrl
python examples/skrl_ppo.py --steps 1000
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import gymnasium
import torch
from skrl.agents.torch.ppo import PPO, PPO_CFG
from skrl.envs.wrappers.torch import wrap_env
from skrl.memories.torch import RandomMemory
from skrl.models.torch import DeterministicMixin, GaussianMixin, Model
from skrl.trainers.torch import SequentialTrainer
from skrl.utils import set_seed

import swarm_envs  # noqa: F401  registers its environments


def mlp(inputs: int, outputs: int) -> torch.nn.Sequential:
    """Return a network with two hidden layers of 64 and tanh."""
    linear, tanh = torch.nn.Linear, torch.nn.Tanh()
    return torch.nn.Sequential(linear(inputs, 64), tanh, linear(64, 64), tanh, linear(64, outputs))


class Actor(GaussianMixin, Model):
    """The mean of the team's actions; the deviation does not depend on the state."""

    def __init__(self, **spaces: Any) -> None:
        Model.__init__(self, **spaces)
        GaussianMixin.__init__(self, clip_actions=True)
        self.net = mlp(self.num_observations, self.num_actions)
        self.log_std = torch.nn.Parameter(torch.full((self.num_actions,), -0.5))

    def compute(self, inputs: dict[str, Any], role: str) -> tuple[torch.Tensor, dict[str, Any]]:
        """Return the mean actions for observations."""
        return self.net(inputs["observations"]), {"log_std": self.log_std}


class Critic(DeterministicMixin, Model):
    """The value of the team's observations."""

    def __init__(self, **spaces: Any) -> None:
        Model.__init__(self, **spaces)
        DeterministicMixin.__init__(self)
        self.net = mlp(self.num_observations, 1)

    def compute(self, inputs: dict[str, Any], role: str) -> tuple[torch.Tensor, dict[str, Any]]:
        """Return the values of observations."""
        return self.net(inputs["observations"]), {}


def main(arguments: list[str] | None = None) -> PPO:
    """Train, and return the agent."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--steps", type=int, default=1_000, help="number of decisions of each team")
    parser.add_argument("--envs", type=int, default=64, help="number of teams in the batch")
    parser.add_argument("--out", type=Path, default=Path("runs/skrl"), help="folder of event files")
    given = parser.parse_args(arguments)
    set_seed(0)
    env = wrap_env(
        gymnasium.make_vec(
            "swarm_envs/Swap-v1",
            num_envs=given.envs,
            num_drones=4,
            action="acceleration",
            decision_rate=10,
            horizon_s=3.5,
        ),
        wrapper="gymnasium",
    )
    spaces = {
        "observation_space": env.observation_space,
        "state_space": env.state_space,
        "action_space": env.action_space,
        "device": env.device,
    }
    config = PPO_CFG(
        rollouts=32,
        learning_epochs=5,
        mini_batches=2,
        discount_factor=0.98,
        experiment={"directory": str(given.out), "checkpoint_interval": 0},
    )
    agent = PPO(
        models={"policy": Actor(**spaces), "value": Critic(**spaces)},
        memory=RandomMemory(memory_size=32, num_envs=env.num_envs, device=env.device),
        cfg=config,
        **spaces,
    )
    trainer = {"timesteps": given.steps, "headless": True, "close_environment_at_exit": False}
    SequentialTrainer(env=env, agents=agent, cfg=trainer).train()
    env.close()
    return agent


if __name__ == "__main__":
    main()
