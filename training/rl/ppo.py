"""Stable-Baselines3's PPO with parameter sharing: all drones of all teams share one policy."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import torch
from stable_baselines3 import PPO
from torch import Tensor

from swarm_envs.agents.networks import ANY, Network
from swarm_envs.training.rl.config import TrainConfig
from swarm_envs.training.rl.encoders import EncoderSpec, TeamPolicy, networks
from swarm_envs.training.rl.learner import Entry, Watch
from swarm_envs.training.rl.practice import Practice
from swarm_envs.training.rl.rollouts import Rollouts
from swarm_envs.training.rl.schedules import learning_rate, proximity_weight, segment_seed
from swarm_envs.training.rl.tensors import load_optimiser, optimiser_tensors, without_prefix

_POLICY, _OPTIMISER = "policy.", "optimiser."


class PpoLearner:
    """A policy in training by PPO; what its methods are for, see `Learner`.

    Args:
        config: of the run.
        task: its versioned name.
    """

    def __init__(self, config: TrainConfig, task: str) -> None:
        torch.set_num_threads(1)  # matrices are small: more threads wait for each other
        assert config.deviation is not None  # the recipe has one
        self.config = config
        self.rollouts = 0
        self.env = Practice(config, task)
        self.model = PPO(
            TeamPolicy,
            self.env,
            learning_rate=lambda _: learning_rate(config, self.rollouts),
            n_steps=config.rollout,
            batch_size=config.batch_size,
            n_epochs=config.passes,
            gamma=config.discount,
            gae_lambda=config.gae_lambda,
            clip_range=config.clip,
            ent_coef=config.entropy,
            seed=config.seed,
            device="cpu",
            policy_kwargs={
                "spec": encoder_spec(config, self.env),
                "log_std_init": float(np.log(config.deviation)),
            },
        )

    def fly(self, segment: range, watch: Watch | None = None) -> Entry:
        """Train for the rollouts of a segment."""
        config = self.config
        if segment.start == config.first_stage:
            self._begin_second_stage()
        self.model.set_random_seed(segment_seed(config, segment))  # SB3's draws are global
        self.model._last_obs = None  # begin new episodes
        self.env.clear()
        steps = len(segment) * config.rollout_steps
        self.model.num_timesteps = segment.start * config.rollout_steps
        rollouts = Rollouts(self.begin_rollout, watch)
        self.model.learn(steps, callback=rollouts, reset_num_timesteps=False)
        return self._entry()

    def begin_rollout(self, steps: int) -> None:
        """Set what depends on how many steps were flown."""
        self.rollouts = steps // self.config.rollout_steps
        weight = proximity_weight(self.config, self.rollouts)
        self.env.weigh({"proximity": weight})

    def actor(self) -> dict[str, Network]:
        """The networks whose output is the mean action."""
        return networks(self.model.policy)

    def tensors(self) -> dict[str, Tensor]:
        """Weights and Adam's averages."""
        policy = self.model.policy
        tensors = {_POLICY + name: tensor for name, tensor in policy.state_dict().items()}
        return tensors | optimiser_tensors(policy.optimizer, _OPTIMISER)

    def load(self, tensors: Mapping[str, Tensor]) -> None:
        """Take weights and Adam's averages."""
        policy = self.model.policy
        policy.load_state_dict(without_prefix(tensors, _POLICY))
        load_optimiser(policy.optimizer, tensors, _OPTIMISER)

    def close(self) -> None:
        """Free the environments."""
        self.env.close()

    def _begin_second_stage(self) -> None:
        policy = self.model.policy
        with torch.no_grad():
            policy.log_std.clamp_(min=float(np.log(max(self.config.second_deviation, 1e-6))))
        options: dict[str, Any] = dict(policy.optimizer_kwargs)
        policy.optimizer = policy.optimizer_class(
            policy.parameters(), lr=self.config.second_rate, **options
        )

    def _entry(self) -> Entry:
        env, told = self.env, self.model.logger.name_to_value
        ended = max(env.episodes, 1)
        return {
            "step": float(self.model.num_timesteps),
            "success": env.successes / ended,
            "collision": env.collisions / ended,
            "deviation": float(self.model.policy.log_std.detach().exp().mean()),
            "learning_rate": float(told["train/learning_rate"]),
            "kl": float(told["train/approx_kl"]),
            "value_loss": float(told["train/value_loss"]),
        }


def encoder_spec(config: TrainConfig, env: Practice) -> EncoderSpec:
    """The networks that a configuration asks for."""
    return EncoderSpec(
        sizes=env.sizes,
        encoder=config.encoder,
        pooling=config.pooling,
        hidden=config.hidden,
        set_hidden=config.set_hidden,
        neighbor_types=env.types or (ANY,),
        owners=env.types if config.per_type else (ANY,),
    )
