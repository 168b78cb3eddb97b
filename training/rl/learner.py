"""Stable-Baselines3's PPO with parameter sharing, flown in segments that can be repeated.

Every segment begins with new episodes and generators that follow from the run's seed and the
segment's place. So what a checkpoint must hold is weights and Adam's averages: no environment, no
generator; and a run that goes on from one ends as if nothing had happened.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import torch
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback

from swarm_envs.agents.features import FeatureSizes
from swarm_envs.agents.networks import ANY, Network
from swarm_envs.training.rl.config import TrainConfig
from swarm_envs.training.rl.encoders import EncoderSpec, TeamPolicy, networks
from swarm_envs.training.rl.practice import Practice

Entry = dict[str, float]


class Learner:
    """A policy in training.

    Args:
        config: of the run.
        task: its versioned name.
    """

    def __init__(self, config: TrainConfig, task: str) -> None:
        torch.set_num_threads(1)  # matrices are small: more threads wait for each other
        self.config = config
        self.rollouts = 0
        self.env = Practice(config, task)
        self.model = PPO(
            TeamPolicy,
            self.env,
            learning_rate=self._rate,
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
                "spec": encoder_spec(config, self.env.sizes),
                "log_std_init": float(np.log(config.deviation)),
            },
        )

    def fly(self, segment: range, watch: Callable[[Learner], None] | None = None) -> Entry:
        """Train for the rollouts of a segment.

        Args:
            segment: of `TrainConfig.segments`; the one after those that were trained.
            watch: called after every rollout.

        Returns:
            Averages over the segment: `success`, `collision` (of episodes), and where it stands.
        """
        config = self.config
        if segment.start == config.first_stage:
            self._begin_second_stage()
        words = np.random.SeedSequence([config.seed, segment.start]).generate_state(1)
        self.model.set_random_seed(int(words[0]) >> 1)  # SB3 draws from global generators
        self.model._last_obs = None  # begin new episodes
        self.env.clear()
        steps = len(segment) * config.rollout_steps
        self.model.num_timesteps = segment.start * config.rollout_steps
        self.model.learn(steps, callback=_Watch(self, watch), reset_num_timesteps=False)
        return self._entry()

    def weigh(self) -> None:
        """Set the cost of proximity that this rollout has."""
        first, last = self.config.proximity
        share = np.clip(2.0 * self.rollouts / self.config.first_stage - 0.5, 0.0, 1.0)
        weight = -self.config.reward_scale * float(first + share * (last - first))
        self.env.weigh({"proximity": weight})

    def actor(self) -> dict[str, Network]:
        """The networks whose output is the mean action, as `Policy` takes them."""
        return networks(self.model.policy)

    def close(self) -> None:
        """Free the environments."""
        self.env.close()

    def _rate(self, _: float) -> float:
        config, first = self.config, self.config.first_stage
        if self.rollouts < first:
            return _falling(config.learning_rate, self.rollouts / first, config.last_rate)
        done = (self.rollouts - first) / max(config.rollouts - first, 1)
        return _falling(config.second_rate, done, config.last_rate)

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


def encoder_spec(config: TrainConfig, sizes: FeatureSizes) -> EncoderSpec:
    """The networks that a configuration asks for."""
    return EncoderSpec(
        sizes=sizes,
        encoder=config.encoder,
        pooling=config.pooling,
        hidden=config.hidden,
        set_hidden=config.set_hidden,
        neighbor_types=config.types if sizes.typed else (ANY,),
        owners=config.types if config.per_type else (ANY,),
    )


def _falling(rate: float, done: float, last: float) -> float:
    return rate * max(1.0 - done, last)


class _Watch(BaseCallback):  # type: ignore[misc]  # SB3's base has no types here
    """Keeps the learner's count of rollouts, on which rate and rewards depend."""

    def __init__(self, learner: Learner, watch: Callable[[Learner], None] | None) -> None:
        super().__init__()
        self._learner, self._watch = learner, watch

    def _on_step(self) -> bool:
        return True

    def _on_rollout_start(self) -> None:
        self._learner.rollouts = self.num_timesteps // self._learner.config.rollout_steps
        self._learner.weigh()

    def _on_rollout_end(self) -> None:
        if self._watch is not None:
            self._watch(self._learner)
