"""SAC's gradient steps with little overhead: both critics as one network, and nothing in vain.

Stable-Baselines3 flies, remembers and draws; the update of Haarnoja et al. (Soft Actor-Critic
Algorithms and Applications, 2018) is here, with three changes. Returns are of several steps, which
carries a reward from the goal to the start in fewer gradient steps. Critics have layer
normalisation, which keeps them from running away (Ball et al., Efficient Online Reinforcement
Learning with Offline Data, 2023). The actor and the temperature follow every other step (Fujimoto
et al., Addressing Function Approximation Error in Actor-Critic Methods, 2018).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import torch
from stable_baselines3 import SAC
from stable_baselines3.common.buffers import NStepReplayBuffer
from stable_baselines3.sac.policies import SACPolicy
from torch import Tensor, nn
from torch.nn import functional

ACTOR_EVERY = 2
"""Gradient steps of the critics for each of the actor and of the temperature."""


class TwinCritic(nn.Module):
    """Two critics that share nothing but their calls: layers are stacked.

    Args:
        width: of an observation and an action together.
        hidden: widths of the hidden layers.
    """

    optimizer: torch.optim.Optimizer
    """Where Stable-Baselines3 keeps it."""

    def __init__(self, width: int, hidden: Sequence[int]) -> None:
        super().__init__()
        self.weights, self.biases = nn.ParameterList(), nn.ParameterList()
        for into, out in pairwise((width, *hidden, 1)):
            bound = 1.0 / math.sqrt(into)  # as torch's own linear layers begin
            self.weights.append(nn.Parameter(torch.empty(2, into, out).uniform_(-bound, bound)))
            self.biases.append(nn.Parameter(torch.empty(2, 1, out).uniform_(-bound, bound)))

    def forward(self, observations: Tensor, actions: Tensor) -> Tensor:
        """What each expects, (2, B), of observations (B, width) and actions (B, width)."""
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


class SoftActorCritic(SAC):  # type: ignore[misc]  # SB3's base has no types here
    """Stable-Baselines3's SAC with gradient steps of its own.

    Args:
        env: what is flown.
        lookahead: rewards that are counted before the critic's word on the rest.
        gamma: discount of a step.
        **options: as SAC takes them.
    """

    def __init__(self, env: Any, lookahead: int, gamma: float, **options: Any) -> None:
        super().__init__(
            TwinPolicy,
            env,
            gamma=gamma,
            replay_buffer_class=NStepReplayBuffer,
            replay_buffer_kwargs={"n_steps": lookahead, "gamma": gamma},
            **options,
        )
        self.critic_target.requires_grad_(False)

    def train(self, gradient_steps: int, batch_size: int = 256) -> None:
        """Take gradient steps, each on a batch of all that is remembered."""
        actor, critic = self.actor.optimizer, self.critic.optimizer
        self._update_learning_rate([actor, critic, self.ent_coef_optimizer])
        drawn = self.replay_buffer.sample(gradient_steps * batch_size)
        batches = zip(*(part.split(batch_size) for part in drawn), strict=True)
        for step, batch in enumerate(batches, self._n_updates):
            seen, done, after, ended, rewards, discounts = batch
            discounts = discounts * (1.0 - ended)
            critic_loss = self._teach_critic(seen, done, after, rewards, discounts)
            if step % ACTOR_EVERY == 0:
                actor_loss = self._teach_actor(seen)
                self.logger.record("train/actor_loss", actor_loss)
        self.logger.record("train/critic_loss", critic_loss)
        self._n_updates += gradient_steps

    def _teach_critic(
        self, seen: Tensor, done: Tensor, after: Tensor, rewards: Tensor, discounts: Tensor
    ) -> Tensor:
        """Move the critics towards rewards and the targets' word, and the targets after them."""
        with torch.no_grad():
            actions, log_probability = self._drawn(after)
            left = self.critic_target(after, actions).amin(0) - self._temperature * log_probability
            wanted = rewards[:, 0] + discounts[:, 0] * left
        expected = self.critic(seen, done)
        loss = functional.mse_loss(expected, wanted.expand_as(expected))
        _descend(self.critic.optimizer, loss, self.critic)
        with torch.no_grad():
            pairs = zip(self.critic_target.parameters(), self.critic.parameters(), strict=True)
            for target, parameter in pairs:
                target.lerp_(parameter, self.tau)
        return loss.detach()

    def _teach_actor(self, seen: Tensor) -> Tensor:
        """Move the actor towards what the critics like, and the temperature to its entropy."""
        actions, log_probability = self._drawn(seen)
        liked = self.critic(seen, actions).amin(0)
        loss = (self._temperature * log_probability - liked).mean()
        _descend(self.actor.optimizer, loss, self.actor)
        surplus = -(log_probability.detach().mean() + self.target_entropy)
        self.log_ent_coef.grad = surplus.reshape(1)  # of log_ent_coef times the surplus
        self.ent_coef_optimizer.step()
        return loss.detach()

    def _drawn(self, seen: Tensor) -> tuple[Tensor, Tensor]:
        """Actions (B, width) that the actor draws, and their log probability (B,)."""
        mean, log_deviation, _ = self.actor.get_action_dist_params(seen)
        noise = torch.randn_like(mean)
        before = mean + log_deviation.exp() * noise
        density = -0.5 * noise.square() - log_deviation - _HALF_LOG_TAU
        stretch = 2.0 * (math.log(2.0) - before - functional.softplus(-2.0 * before))
        return torch.tanh(before), (density - stretch).sum(1)  # stretch: log of tanh's slope

    @property
    def _temperature(self) -> Tensor:
        temperature: Tensor = self.log_ent_coef.detach().exp()
        return temperature


_HALF_LOG_TAU = 0.5 * math.log(2.0 * math.pi)


def _descend(optimiser: torch.optim.Optimizer, loss: Tensor, network: nn.Module) -> None:
    """One step of the network's own parameters, and no gradient of any other."""
    optimiser.zero_grad()
    loss.backward(inputs=list(network.parameters()))  # type: ignore[no-untyped-call]
    optimiser.step()
