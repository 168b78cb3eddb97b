"""Stable-Baselines3's PPO with parameter sharing: all drones of all teams share one policy.

Its networks are twins of those in `swarm_envs.agents.networks`, which fly: perceptrons, or deep
sets over the neighbours, one network a type. Stable-Baselines3 puts a linear layer behind what
comes out of them, for actions and for values. Where every type of vehicle has a policy of its own,
each type's trunk fills its own columns, one of them with ones, and zeros stand in the others: that
linear layer then has weights and a bias for each.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
import torch
from stable_baselines3 import PPO
from stable_baselines3.common.policies import ActorCriticPolicy
from torch import Tensor, nn

from swarm_envs.agents.features import FeatureSizes
from swarm_envs.agents.networks import ANY, Network
from swarm_envs.training.rl.learner import Entry, Sb3Learner, Watch, layers_of
from swarm_envs.training.rl.rl_config import RlConfig


class PpoLearner(Sb3Learner):
    """A policy in training by PPO; what its methods are for, see `Learner`."""

    def __init__(self, config: RlConfig, task: str) -> None:
        super().__init__(config, task)
        config = self.config
        assert config.deviation is not None  # the recipe has one
        self.model = PPO(
            TeamPolicy,
            self.env,
            learning_rate=lambda _: config.learning_rate_after(self.rollouts),
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
                "spec": self._encoder_spec(),
                "log_std_init": float(np.log(config.deviation)),
            },
        )

    def _encoder_spec(self) -> _EncoderSpec:
        config = self.config
        return _EncoderSpec(
            sizes=self.sizes,
            encoder=config.encoder,
            pooling=config.pooling,
            hidden=config.hidden,
            set_hidden=config.set_hidden,
            neighbor_types=self.types or (ANY,),
            owners=self.types if config.per_type else (ANY,),
        )

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
        return actor_networks(self.model.policy)

    def optimisers(self) -> dict[str, torch.optim.Optimizer]:
        """Adam."""
        return {"optimiser.": self.model.policy.optimizer}


@dataclass(frozen=True)
class _EncoderSpec:
    """What the networks of a policy look like."""

    sizes: FeatureSizes  # numbers that are taken in
    encoder: str  # one of `swarm_envs.agents.networks.ENCODERS`
    pooling: str  # how neighbours become one row
    hidden: tuple[int, ...]  # widths of the hidden layers
    set_hidden: tuple[int, ...]  # widths of phi's layers
    neighbor_types: tuple[str, ...]  # types of neighbours with a phi of their own, or `ANY` alone
    owners: tuple[str, ...]  # types of drones with a network of their own, or `ANY` alone


class SetEncoder(nn.Module):
    """A drone's own numbers, and those of its neighbours as a set."""

    def __init__(self, spec: _EncoderSpec) -> None:
        super().__init__()
        self._spec = spec
        self.phi = nn.ModuleList(
            _tanh_layers(spec.sizes.neighbor, spec.set_hidden) for _ in spec.neighbor_types
        )

    @property
    def width(self) -> int:
        """How many numbers come out."""
        return self._spec.sizes.own + self._spec.set_hidden[-1]

    def forward(self, values: Tensor) -> Tensor:
        """(B, `width`) for features (B, `sizes.width`)."""
        sizes = self._spec.sizes
        own = values[:, : sizes.own]
        around = values[:, sizes.own :].reshape(-1, sizes.num_neighbors, sizes.neighbor)
        present = around[..., sizes.mask, None]
        members = torch.zeros(())
        for token, phi in zip(self._spec.neighbor_types, self.phi, strict=True):
            column = sizes.mask if token == ANY else sizes.neighbor_column(token)
            members = members + around[..., column, None] * phi(around)
        return torch.cat([own, _pooled(members, present, self._spec.pooling)], dim=1)


def _pooled(members: Tensor, present: Tensor, pooling: str) -> Tensor:
    """Twin of `swarm_envs.agents.networks.pooled`: (B, width) of (B, K, width) and (B, K, 1)."""
    if pooling == "max":
        found = members.masked_fill(present == 0, -1.0).amax(dim=1)
        return found * present.amax(dim=1)
    total = members.sum(dim=1)
    return total if pooling == "sum" else total / present.sum(dim=1).clamp(min=1.0)


class Trunk(nn.Module):
    """From features to the last hidden layer."""

    def __init__(self, spec: _EncoderSpec) -> None:
        super().__init__()
        self.set = SetEncoder(spec) if spec.encoder == "deep-set" else None
        self.body = _tanh_layers(self.set.width if self.set else spec.sizes.width, spec.hidden)

    def forward(self, values: Tensor) -> Tensor:
        """(B, last width) for features (B, `sizes.width`)."""
        latent: Tensor = self.body(values if self.set is None else self.set(values))
        return latent


class Trunks(nn.Module):
    """The trunk of each type of drone; see the module for what comes out."""

    def __init__(self, spec: _EncoderSpec) -> None:
        super().__init__()
        self.owners, self._sizes = spec.owners, spec.sizes
        self.trunks = nn.ModuleList(Trunk(spec) for _ in spec.owners)
        self.width = len(spec.owners) * (spec.hidden[-1] + (spec.owners != (ANY,)))

    def forward(self, values: Tensor) -> Tensor:
        """(B, `width`) for features (B, `sizes.width`)."""
        if self.owners == (ANY,):
            latent: Tensor = self.trunks[0](values)
            return latent
        parts = []
        for token, trunk in zip(self.owners, self.trunks, strict=True):
            own = values[:, self._sizes.own_column(token), None]
            parts += [own * trunk(values), own]
        return torch.cat(parts, dim=1)


class ActorCritic(nn.Module):
    """Actor and critic, which share nothing, as Stable-Baselines3 calls them."""

    def __init__(self, spec: _EncoderSpec) -> None:
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
    """Stable-Baselines3's policy with the networks of a spec, which is given by `spec`."""

    def __init__(self, *arguments: Any, spec: _EncoderSpec, **options: Any) -> None:
        self._spec = spec
        super().__init__(*arguments, **options)

    def _build_mlp_extractor(self) -> None:
        self.mlp_extractor = ActorCritic(self._spec)


def actor_networks(policy: ActorCriticPolicy) -> dict[str, Network]:
    """The actor of a trained policy, in numpy, by type of drone."""
    spec, last = policy._spec, policy.action_net
    found, column = {}, 0
    for token, trunk in zip(spec.owners, policy.mlp_extractor.policy_net.trunks, strict=True):
        width = spec.hidden[-1]
        weight, bias = last.weight[:, column : column + width], last.bias
        if token != ANY:
            bias = bias + last.weight[:, column + width]
        column += width + (token != ANY)
        phi = None
        if trunk.set is not None:
            phi = dict(zip(spec.neighbor_types, map(layers_of, trunk.set.phi), strict=True))
        layers = (
            *layers_of(trunk.body),
            (weight.detach().numpy().copy(), bias.detach().numpy().copy()),
        )
        found[token] = Network(layers, phi, spec.pooling)
    return found


def _tanh_layers(width: int, hidden: Sequence[int]) -> nn.Sequential:
    parts: list[nn.Module] = []
    for into, out in pairwise((width, *hidden)):
        parts += [nn.Linear(into, out), nn.Tanh()]
    return nn.Sequential(*parts)
