"""Stable-Baselines3's PPO with parameter sharing: all drones of all teams share one policy.

Its networks are those of `swarm_envs.training.rl.encoders`; Stable-Baselines3 puts a linear layer
behind what comes out of them, for actions and for values.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import torch
from stable_baselines3 import PPO
from stable_baselines3.common.buffers import RolloutBuffer
from stable_baselines3.common.policies import ActorCriticPolicy
from stable_baselines3.common.type_aliases import RolloutBufferSamples
from torch import Tensor, nn

from swarm_envs.agents.networks import Network
from swarm_envs.envs.observation import Float32Array
from swarm_envs.training.rl.encoders import Actor, EncoderSpec, Trunks, plain_networks
from swarm_envs.training.rl.learner import Entry, Sb3Learner, Watch
from swarm_envs.training.rl.rl_config import RlConfig


class PpoLearner(Sb3Learner):
    """A policy in training by PPO; what its methods are for, see `Learner`."""

    def __init__(self, config: RlConfig, task: str) -> None:
        super().__init__(config, task)
        config = self.config
        assert config.log_std_init is not None  # the recipe has one
        self.model = PPO(
            TeamPolicy,
            self.env,
            learning_rate=lambda _: config.learning_rate_after(self.rollouts),
            n_steps=config.n_steps,
            batch_size=config.batch_size,
            n_epochs=config.n_epochs,
            gamma=config.gamma,
            gae_lambda=config.gae_lambda,
            clip_range=config.clip_range,
            ent_coef=1.0,  # `TeamPolicy` weighs it
            rollout_buffer_class=FlownRollouts,
            rollout_buffer_kwargs={"waiting": self.env.waiting},
            seed=config.seed,
            device="cpu",
            policy_kwargs={
                "spec": self.spec,
                "log_std_init": config.log_std_init,
                "entropy_weight": config.ent_coef,
                "start_kl": config.start_kl,
            },
        )
        policy = self.model.policy
        policy.start = self.start_from(policy.mlp_extractor.policy_net, policy.action_net)

    def fly(self, segment: range, watch: Watch | None = None) -> Entry:
        """Train for the rollouts of a segment."""
        if segment.start == self.config.first_stage:
            self._begin_second_stage()
        entry, said = super().fly(segment, watch), self.model.logger.name_to_value
        return {
            **entry,
            "deviation": float(self.model.policy.log_std.detach().exp().mean()),
            "learning_rate": float(said["train/learning_rate"]),
            "kl": float(said["train/approx_kl"]),
            "value_loss": float(said["train/value_loss"]),
        }

    def _begin_second_stage(self) -> None:
        policy = self.model.policy
        with torch.no_grad():
            policy.log_std.clamp_(min=float(np.log(max(self.config.second_deviation, 1e-6))))
        options: dict[str, Any] = dict(policy.optimizer_kwargs)
        policy.optimizer = policy.optimizer_class(
            policy.parameters(), lr=self.config.second_rate, **options
        )

    def actor(self) -> dict[str, Network]:
        """The networks whose output is the mean action."""
        policy = self.model.policy
        return plain_networks(policy.mlp_extractor.policy_net, policy.action_net)

    def optimisers(self) -> dict[str, torch.optim.Optimizer]:
        """Adam."""
        return {"optimiser.": self.model.policy.optimizer}


class FlownRollouts(RolloutBuffer):  # type: ignore[misc]  # SB3's base has no types here
    """Stable-Baselines3's rollouts, of which only decisions of drones that flew are learned from.

    Args:
        *arguments: as `RolloutBuffer` takes them.
        waiting: (width,) what a drone observes that has ended before its team.
        **options: as `RolloutBuffer` takes them.
    """

    def __init__(self, *arguments: Any, waiting: Float32Array, **options: Any) -> None:
        self._waiting = waiting
        super().__init__(*arguments, **options)

    def get(self, batch_size: int | None = None) -> Iterator[RolloutBufferSamples]:
        """Batches in random order, of at most this many decisions; None for a single one."""
        flew = (self.observations != self._waiting).any(-1).T.reshape(-1)
        tables = (self.observations, self.actions, self.values, self.log_probs)
        columns = [
            self.to_torch(self.swap_and_flatten(table)[flew])
            for table in (*tables, self.advantages, self.returns)
        ]
        rows, *others = columns
        columns = [rows, others[0], *(column.flatten() for column in others[1:])]
        order = torch.from_numpy(np.random.permutation(len(rows)))  # noqa: NPY002  # as SB3
        for chosen in torch.split(order, batch_size or len(rows)):
            yield RolloutBufferSamples(*(column[chosen] for column in columns))


class ActorCritic(nn.Module):
    """Actor and critic, which share nothing, as Stable-Baselines3 calls them."""

    def __init__(self, spec: EncoderSpec) -> None:
        super().__init__()
        self.policy_net, self.value_net = Trunks(spec), Trunks(spec)
        self.latent_dim_pi = self.latent_dim_vf = self.policy_net.width

    def forward(self, values: Tensor) -> tuple[Tensor, Tensor]:
        """What comes out of the actor and of the critic."""
        return self.forward_actor(values), self.forward_critic(values)

    def forward_actor(self, values: Tensor) -> Tensor:
        """What comes out of the actor."""
        latent: Tensor = self.policy_net(values)
        return latent

    def forward_critic(self, values: Tensor) -> Tensor:
        """What comes out of the critic."""
        latent: Tensor = self.value_net(values)
        return latent


class TeamPolicy(ActorCriticPolicy):  # type: ignore[misc]  # SB3's base has no types here
    """Stable-Baselines3's policy with the networks of a spec, which is given by `spec`.

    What it calls entropy is what the loss takes off with a weight of 1: the weighed entropy, less
    the weighed divergence from the policy that it started from.
    """

    def __init__(
        self,
        *arguments: Any,
        spec: EncoderSpec,
        entropy_weight: float,
        start_kl: float,
        **options: Any,
    ) -> None:
        self._spec, self._entropy_weight, self._start_kl = spec, entropy_weight, start_kl
        super().__init__(*arguments, **options)
        self.start: Actor | None = None

    def evaluate_actions(self, obs: Tensor, actions: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Values and log probabilities (B,), and what the loss takes off, weighed (B,)."""
        values, log_probability, entropy = super().evaluate_actions(obs, actions)
        bonus = self._entropy_weight * entropy
        if self.start is not None:
            means, deviation = self.action_net(self.mlp_extractor.forward_actor(obs)), self.log_std
            away = (means - self.start(obs)) / deviation.exp()
            bonus = bonus - self._start_kl * 0.5 * away.square().sum(-1)
        return values, log_probability, bonus

    def _build_mlp_extractor(self) -> None:
        self.mlp_extractor = ActorCritic(self._spec)
