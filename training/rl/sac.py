"""Stable-Baselines3's SAC with parameter sharing: it learns from every decision many times.

Stable-Baselines3 flies, stores and samples; the update of Haarnoja et al. (Soft Actor-Critic
Algorithms and Applications, 2018) is here, with three changes. Returns are of several steps, which
carries a reward from the goal to the start in fewer gradient steps. Critics have layer
normalisation, which keeps them from running away (Ball et al., Efficient Online Reinforcement
Learning with Offline Data, 2023). The actor and the temperature follow every other step (Fujimoto
et al., Addressing Function Approximation Error in Actor-Critic Methods, 2018).

A checkpoint holds the replay buffer too, which a run that continues would otherwise have lost: at
most `--sac.buffer-size` decisions. That of a run's end holds none: nothing is learned after it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import torch
from stable_baselines3 import SAC
from stable_baselines3.common.buffers import NStepReplayBuffer
from stable_baselines3.common.type_aliases import ReplayBufferSamples
from stable_baselines3.common.utils import polyak_update
from stable_baselines3.sac.policies import SACPolicy
from torch import Tensor, nn
from torch.nn import functional

from swarm_envs.agents.networks import Network
from swarm_envs.envs.observation import Float32Array
from swarm_envs.training.rl.encoders import TrunkExtractor, plain_networks
from swarm_envs.training.rl.learner import Entry, Sb3Learner, Watch
from swarm_envs.training.rl.rl_config import RlConfig

ACTOR_EVERY = 2  # Gradient steps of the critics for each of the actor and of the temperature
_HALF_LOG_TAU = 0.5 * math.log(2.0 * math.pi)
_MEMORY, _TEMPERATURE, _PLACE = "memory.", "log_temperature", "memory_place"
_SAME = ("buffer_size", "learning_starts", "batch_size", "tau", "train_freq", "gradient_steps")
"""Options that Stable-Baselines3 calls the same."""
_BUFFER_FIELDS = ("observations", "next_observations", "actions", "rewards", "dones", "timeouts")


class SacLearner(Sb3Learner):
    """A policy in training by SAC; what its methods are for, see `Learner`."""

    def __init__(self, config: RlConfig, task: str) -> None:
        super().__init__(config, task)
        config, options = self.config, self.config.sac
        assert config.gamma is not None  # the recipe has one
        self.model = SoftActorCritic(
            self.env,
            waiting=self.env.waiting,
            lookahead=options.lookahead,
            gamma=config.gamma,
            learning_rate=lambda _: config.learning_rate_after(self.rollouts),
            **{name: getattr(options, name) for name in _SAME},
            ent_coef=f"auto_{options.ent_coef}",
            seed=config.seed,
            device="cpu",
            policy_kwargs={
                "net_arch": {"pi": [], "qf": list(config.hidden)},
                "features_extractor_class": TrunkExtractor,
                "features_extractor_kwargs": {"spec": self.spec},
                "optimizer_kwargs": {"fused": True},
            },
        )

    def fly(self, segment: range, watch: Watch | None = None) -> Entry:
        """Train for the rollouts of a segment."""
        self.model.replay_buffer.cut()
        entry, said = super().fly(segment, watch), self.model.logger.name_to_value
        return {
            **entry,
            "temperature": float(self.model.log_ent_coef.detach().exp()),
            "critic_loss": float(said.get("train/critic_loss", 0.0)),
            "actor_loss": float(said.get("train/actor_loss", 0.0)),
        }

    def actor(self) -> dict[str, Network]:
        """The networks whose output is the mean action.

        SAC's last layer has a tanh, which a policy's has not: another follows, which changes
        nothing.
        """
        actor, width = self.model.actor, self.env.action_space.shape[0]
        identity = (np.eye(width, dtype=np.float32), np.zeros(width, np.float32))
        found = plain_networks(actor.features_extractor.trunks, actor.mu)
        return {owner: replace(n, layers=(*n.layers, identity)) for owner, n in found.items()}

    def tensors(self) -> dict[str, Tensor]:
        """Weights, Adam's averages, the temperature; and while it learns, the replay buffer."""
        tensors = {**super().tensors(), _TEMPERATURE: self.model.log_ent_coef.detach()}
        if self.rollouts < self.config.rollouts:
            tensors |= self.model.replay_buffer.tensors()
        return tensors

    def load(self, tensors: Mapping[str, Tensor]) -> None:
        """Take what `tensors` gave."""
        super().load(tensors)
        with torch.no_grad():
            self.model.log_ent_coef.copy_(tensors[_TEMPERATURE])
        if _PLACE in tensors:
            self.model.replay_buffer.fill(tensors)

    def optimisers(self) -> dict[str, torch.optim.Optimizer]:
        """Of the actor, the critics and the temperature."""
        model = self.model
        return {
            "actor_optimiser.": model.actor.optimizer,
            "critic_optimiser.": model.critic.optimizer,
            "temperature_optimiser.": model.ent_coef_optimizer,
        }


class TwinCritic(nn.Module):
    """Two critics that share nothing but their calls: their layers are stacked.

    Args:
        width: of an observation and an action together.
        hidden: widths of the hidden layers.
    """

    optimizer: torch.optim.Optimizer  # Where Stable-Baselines3 keeps it

    def __init__(self, width: int, hidden: Sequence[int]) -> None:
        super().__init__()
        self.weights, self.biases = nn.ParameterList(), nn.ParameterList()
        for into, out in pairwise((width, *hidden, 1)):
            bound = 1.0 / math.sqrt(into)  # as torch's own linear layers begin
            self.weights.append(nn.Parameter(torch.empty(2, into, out).uniform_(-bound, bound)))
            self.biases.append(nn.Parameter(torch.empty(2, 1, out).uniform_(-bound, bound)))

    def forward(self, observations: Tensor, actions: Tensor) -> Tensor:
        """Values (2, B) of observations (B, width) and actions (B, width)."""
        values = torch.cat([observations, actions], dim=1).expand(2, -1, -1)
        *hidden, last = zip(self.weights, self.biases, strict=True)
        for weight, bias in hidden:
            values = torch.baddbmm(bias, values, weight)
            values = torch.relu(functional.layer_norm(values, values.shape[-1:]))
        expected: Tensor = torch.baddbmm(last[1], values, last[0])[..., 0]
        return expected

    def set_training_mode(self, mode: bool) -> None:
        """As Stable-Baselines3 calls `train`."""
        self.train(mode)


class TwinPolicy(SACPolicy):  # type: ignore[misc]  # SB3's base has no types here
    """Stable-Baselines3's actor, and `TwinCritic`."""

    def make_critic(self, features_extractor: nn.Module | None = None) -> TwinCritic:
        """A fresh critic; it sees observations as they are."""
        width = self.observation_space.shape[0] + self.action_space.shape[0]
        return TwinCritic(width, self.critic_kwargs["net_arch"])


class FlownReplay(NStepReplayBuffer):  # type: ignore[misc]  # SB3's base has no types here
    """Stable-Baselines3's replay buffer, of which only decisions of drones that flew are drawn.

    `waiting` (width,) is what a drone observes that has ended before its team.
    """

    def __init__(self, *arguments: Any, waiting: Float32Array, **options: Any) -> None:
        super().__init__(*arguments, **options)
        self._waiting = torch.from_numpy(waiting)

    def sample(self, batch_size: int, env: Any = None) -> ReplayBufferSamples:
        """As of the base, less the decisions of drones that waited; at least one is left."""
        while True:
            batch = super().sample(batch_size, env)
            flew = (batch.observations != self._waiting).any(-1)
            if flew.any():
                return ReplayBufferSamples(*(part[flew] for part in batch))

    def cut(self) -> None:
        """Let no return reach from the last decision into the episode that begins after it."""
        last = self.pos - 1  # where nothing is stored yet, a place that will be written over
        self.timeouts[last] = np.maximum(self.timeouts[last], 1.0 - self.dones[last])

    def tensors(self) -> dict[str, Tensor]:
        """All that is remembered, by names of its own."""
        filled = self.buffer_size if self.full else self.pos
        held = {_MEMORY + n: torch.from_numpy(getattr(self, n)[:filled]) for n in _BUFFER_FIELDS}
        return {**held, _PLACE: torch.tensor(self.pos)}

    def fill(self, tensors: Mapping[str, Tensor]) -> None:
        """Remember what `tensors` gave."""
        for name in _BUFFER_FIELDS:
            held = tensors[_MEMORY + name].numpy()
            getattr(self, name)[: len(held)] = held
        self.pos, self.full = int(tensors[_PLACE]), len(held) == self.buffer_size


class SoftActorCritic(SAC):  # type: ignore[misc]  # SB3's base has no types here
    """Stable-Baselines3's SAC with gradient steps of its own.

    Args:
        env: the environments.
        waiting: (width,) what a drone observes that has ended before its team.
        lookahead: rewards that are counted before the critic's estimate (n-step returns).
        gamma: discount of a step.
        **options: as SAC takes them.
    """

    def __init__(
        self, env: Any, waiting: Float32Array, lookahead: int, gamma: float, **options: Any
    ) -> None:
        super().__init__(
            TwinPolicy,
            env,
            gamma=gamma,
            replay_buffer_class=FlownReplay,
            replay_buffer_kwargs={"n_steps": lookahead, "gamma": gamma, "waiting": waiting},
            **options,
        )
        self.critic_target.requires_grad_(False)

    def train(self, gradient_steps: int, batch_size: int = 256) -> None:
        """Take gradient steps, each on a batch of the whole replay buffer."""
        actor, critic = self.actor.optimizer, self.critic.optimizer
        self._update_learning_rate([actor, critic, self.ent_coef_optimizer])
        samples = self.replay_buffer.sample(gradient_steps * batch_size)
        batches = zip(*(part.split(batch_size) for part in samples), strict=True)
        for step, batch in enumerate(batches, self._n_updates):
            observations, actions, next_observations, dones, rewards, discounts = batch
            discounts = discounts * (1.0 - dones)
            targets = self._targets(next_observations, rewards, discounts)
            critic_loss = self._update_critic(observations, actions, targets)
            if step % ACTOR_EVERY == 0:
                actor_loss = self._update_actor(observations)
                self.logger.record("train/actor_loss", actor_loss)
        self.logger.record("train/critic_loss", critic_loss)
        self._n_updates += gradient_steps

    @torch.no_grad()
    def _targets(self, next_observations: Tensor, rewards: Tensor, discounts: Tensor) -> Tensor:
        """Returns (B,) of n steps, and of the target critics for what follows them."""
        actions, log_probability = self._sample_actions(next_observations)
        following = self.critic_target(next_observations, actions).amin(0)
        following = following - self._temperature * log_probability
        targets: Tensor = rewards[:, 0] + discounts[:, 0] * following
        return targets

    def _update_critic(self, observations: Tensor, actions: Tensor, targets: Tensor) -> Tensor:
        expected = self.critic(observations, actions)
        loss = functional.mse_loss(expected, targets.expand_as(expected))
        _descend(self.critic.optimizer, loss, self.critic)
        polyak_update(self.critic.parameters(), self.critic_target.parameters(), self.tau)
        return loss.detach()

    def _update_actor(self, observations: Tensor) -> Tensor:
        """Move the actor towards higher values, and the temperature towards its entropy."""
        actions, log_probability = self._sample_actions(observations)
        values = self.critic(observations, actions).amin(0)
        loss = (self._temperature * log_probability - values).mean()
        _descend(self.actor.optimizer, loss, self.actor)
        surplus = -(log_probability.detach().mean() + self.target_entropy)
        self.log_ent_coef.grad = surplus.reshape(1)  # of log_ent_coef times the surplus
        self.ent_coef_optimizer.step()
        return loss.detach()

    def _sample_actions(self, observations: Tensor) -> tuple[Tensor, Tensor]:
        """Actions (B, width) that the actor draws, and their log probability (B,)."""
        mean, log_deviation, _ = self.actor.get_action_dist_params(observations)
        noise = torch.randn_like(mean)
        before = mean + log_deviation.exp() * noise
        density = -0.5 * noise.square() - log_deviation - _HALF_LOG_TAU
        stretch = 2.0 * (math.log(2.0) - before - functional.softplus(-2.0 * before))
        return torch.tanh(before), (density - stretch).sum(1)  # stretch: log of tanh's slope

    @property
    def _temperature(self) -> Any:
        return self.log_ent_coef.detach().exp()


def _descend(optimiser: torch.optim.Optimizer, loss: Tensor, network: nn.Module) -> None:
    """One step of the network's own parameters, and no gradient of any other."""
    optimiser.zero_grad()
    loss.backward(inputs=list(network.parameters()))  # type: ignore[no-untyped-call]
    optimiser.step()
