"""MAPPO in plain torch: one actor for all drones, and a critic that sees the whole team.

Yu et al., "The Surprising Effectiveness of PPO in Cooperative Multi-Agent Games", 2022: PPO whose
critic, used in training alone, looks at what no drone senses. Of its suggestions here: one actor
for all; a state of the team as each drone stands in it; values in units of their own spread; many
decisions in a batch, few passes.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor, nn

from swarm_envs.agents.networks import Network
from swarm_envs.training.rl.encoders import (
    Actor,
    EncoderSpec,
    hidden_layers,
)
from swarm_envs.training.rl.learner import Entry, Learner, Watch
from swarm_envs.training.rl.rl_config import RlConfig

_LARGEST_GRADIENT = 0.5
_HALF_LOG_TAU = 0.5 * math.log(2.0 * math.pi)


class ActorCriticNetworks(nn.Module):
    """Actor, critic, and the spread of returns, in whose units the critic is trained.

    Args:
        spec: of the actor.
        state: numbers that the critic takes of the team, from one drone.
        actions: width of an action.
        log_std: of actions, at the start.
    """

    def __init__(self, spec: EncoderSpec, state: int, actions: int, log_std: float) -> None:
        super().__init__()
        self.actor = Actor(spec, actions)
        critic = hidden_layers((state, *spec.hidden), "tanh")
        self.critic = nn.Sequential(*critic, nn.Linear(spec.hidden[-1], 1))
        _make_orthogonal(self.actor, 0.01)
        _make_orthogonal(self.critic, 1.0)
        self.log_deviation = nn.Parameter(torch.full((actions,), log_std))
        self.register_buffer("moments", torch.tensor([0.0, 1.0, 0.0]))
        self.moments: Tensor
        self.start: Actor | None = None

    def log_probability(self, means: Tensor, actions: Tensor) -> Tensor:
        """Of actions (..., width) that are drawn around these means."""
        away = (actions - means) / self.log_deviation.exp()
        return -(0.5 * away**2 + self.log_deviation + _HALF_LOG_TAU).sum(-1)

    def value(self, states: Tensor) -> Tensor:
        """Returns that are expected, in units of reward."""
        mean, deviation = self.spread()
        return self.critic(states).squeeze(-1) * deviation + mean

    def spread(self) -> tuple[Tensor, Tensor]:
        """Mean and deviation of returns so far."""
        mean, square, _ = self.moments
        return mean, (square - mean**2).clamp(min=1e-4).sqrt()

    def note_returns(self, returns: Tensor) -> None:
        """Let mean and mean square follow: the first at once, later ones ever more slowly."""
        count = self.moments[2] + 1
        share = torch.clamp(1.0 / count, min=0.02)
        now = torch.stack([returns.mean(), returns.square().mean()])
        self.moments[:2] += share * (now - self.moments[:2])
        self.moments[2] = count


class _Rollout(NamedTuple):
    """Decisions of every drone in a rollout, in one row each."""

    observations: Tensor  # of the actor
    states: Tensor  # of the team, as the critic takes them
    actions: Tensor  # what was done
    log_probs: Tensor  # logarithm of the density with which it was drawn
    advantages: Tensor  # by how much it was better than expected
    returns: Tensor  # what the critic learns


class MappoLearner(Learner):
    """A policy in training by MAPPO; what its methods are for, see `Learner`."""

    prefix = "networks."

    def __init__(self, config: RlConfig, task: str) -> None:
        super().__init__(config, task)
        torch.manual_seed(config.seed)
        config = self.config
        assert config.log_std_init is not None  # the recipe has one
        self.core = self.env.core
        observed = self.env.observation_space.shape[0]
        state = observed + (self.core.num_drones - 1) * self.core.team_state().shape[-1]
        width = self.core.mode.width
        self.networks = ActorCriticNetworks(self.spec, state, width, config.log_std_init)
        actor = self.networks.actor
        self.networks.start = self.start_from(actor.trunks, actor.head)
        self._adam(config.learning_rate)
        self._draws = torch.Generator()

    def fly(self, segment: range, watch: Watch | None = None) -> Entry:
        """Train for the rollouts of a segment."""
        config, seed = self.config, self.config.segment_seed(segment)
        if segment.start == config.first_stage:
            self._begin_second_stage()
        self._draws.manual_seed(seed)
        self.core.reset([seed + e for e in range(self.core.num_envs)])
        self.start_counting()
        for rollout in segment:
            rate = config.learning_rate_after(rollout)
            self.core.set_reward_weights({"proximity": config.proximity_weight_after(rollout)})
            kl, loss = self._learn(self._collect(), rate)
            if watch is not None:
                watch()
        return {
            "step": float(segment.stop * config.rollout_steps),
            **self.rates(),
            "deviation": float(self.networks.log_deviation.detach().exp().mean()),
            "learning_rate": rate,
            "kl": kl,
            "value_loss": loss,
        }

    @torch.no_grad()
    def _collect(self) -> _Rollout:
        discount = self.config.gamma
        assert discount is not None  # the recipe has one
        steps = [self._step() for _ in range(self.config.n_steps)]
        observations, states, actions, log_probs, values, rewards, after, ended, active = map(
            torch.stack, zip(*steps, strict=True)
        )
        last = self.networks.value(self._states(self._observations()))
        following = torch.where(ended, after, torch.cat([values[1:], last[None]]))
        errors = rewards + discount * following - values
        advantages = generalised_advantages(errors, ended, discount * self.config.gae_lambda)
        rows = (observations, states, actions, log_probs, advantages, advantages + values)
        return _Rollout(*(row[active] for row in rows))

    def _step(self) -> tuple[Tensor, ...]:
        """One decision of every drone: what it observed, what it did, what came of it."""
        observations = self._observations()
        states = self._states(observations)
        means = self.networks.actor(observations)
        noise = torch.randn(means.shape, generator=self._draws)
        actions = means + self.networks.log_deviation.exp() * noise
        result = self.core.step(actions.clamp(-1.0, 1.0).numpy())
        rewards = torch.from_numpy(result.rewards.astype(np.float32)) - self.env.decision_cost
        after, ended = torch.zeros_like(rewards), result.terminated | result.truncated
        if result.truncated.any():  # cut by the clock alone: what would follow has a value
            cut = torch.from_numpy(result.truncated[:, None] & ~result.ended)
            after[cut] = self.networks.value(self._states(self._observations())[cut])
        if ended.any():
            for e in np.flatnonzero(ended).tolist():
                self.count(self.core.metrics(e))
            self.core.reset(mask=ended)
        over, active = map(torch.from_numpy, (ended[:, None] | result.ended, result.active))
        log_probs = self.networks.log_probability(means, actions)
        values = self.networks.value(states)
        return observations, states, actions, log_probs, values, rewards, after, over, active

    def _observations(self) -> Tensor:
        """(E, N, features) of every drone now."""
        return torch.from_numpy(self.env.observe(self.core.rows))

    def _states(self, observations: Tensor) -> Tensor:
        """(E, N, width) of the critic: a drone's features, then the others' true states.

        Its own state is left out: features say it already.
        """
        states = torch.from_numpy(self.core.team_state())
        others = [states.roll(-k, dims=1) for k in range(1, self.core.num_drones)]
        return torch.cat([observations, *others], dim=-1)

    def _learn(self, rollout: _Rollout, rate: float) -> tuple[float, float]:
        networks, losses = self.networks, []
        networks.note_returns(rollout.returns)
        self.adam.param_groups[0]["lr"] = rate
        for batch in self._batches(rollout):
            kl, value_loss, loss = self._losses(batch)
            self.adam.zero_grad()
            loss.backward()  # type: ignore[no-untyped-call]
            for part in (networks.actor.parameters(), networks.critic.parameters()):
                nn.utils.clip_grad_norm_(part, _LARGEST_GRADIENT)
            self.adam.step()
            losses.append((float(kl), float(value_loss)))
        kls, value_losses = zip(*losses, strict=True)
        return float(np.mean(kls)), float(np.mean(value_losses))

    def _batches(self, rollout: _Rollout) -> Iterator[_Rollout]:
        size = self.config.batch_size
        for _ in range(self.config.n_epochs):
            order = torch.randperm(len(rollout.returns), generator=self._draws)
            for chosen in torch.split(order, size):
                yield _Rollout(*(row[chosen] for row in rollout))

    def _losses(self, batch: _Rollout) -> tuple[Tensor, Tensor, Tensor]:
        config, networks = self.config, self.networks
        means = networks.actor(batch.observations)
        log_probs = networks.log_probability(means, batch.actions)
        change = log_probs - batch.log_probs
        ratio, good = change.exp(), batch.advantages
        good = (good - good.mean()) / (good.std() + 1e-8)
        clipped = ratio.clamp(1.0 - config.clip_range, 1.0 + config.clip_range)
        gain = torch.minimum(ratio * good, clipped * good).mean()
        mean, deviation = networks.spread()
        expected = networks.critic(batch.states).squeeze(-1)
        value_loss = nn.functional.huber_loss(expected, (batch.returns - mean) / deviation)
        entropy = networks.log_deviation.sum()  # but for a constant
        kl = (ratio - 1.0 - change).mean().detach()
        loss = value_loss - gain - config.ent_coef * entropy
        if networks.start is not None:
            away = (means - networks.start(batch.observations)) / networks.log_deviation.exp()
            loss = loss + config.start_kl * 0.5 * away.square().sum(-1).mean()
        return kl, value_loss.detach(), loss

    def actor(self) -> dict[str, Network]:
        """The networks whose output is the mean action."""
        return self.networks.actor.networks()

    def network(self) -> nn.Module:
        """Actor, critic, and the spread of returns."""
        return self.networks

    def optimisers(self) -> dict[str, torch.optim.Optimizer]:
        """Adam."""
        return {"optimiser.": self.adam}

    def _adam(self, rate: float) -> None:
        self.adam = torch.optim.Adam(self.networks.parameters(), lr=rate, eps=1e-5)

    def _begin_second_stage(self) -> None:
        least = float(np.log(max(self.config.second_deviation, 1e-6)))
        with torch.no_grad():
            self.networks.log_deviation.clamp_(min=least)
        self._adam(self.config.second_rate)


def _make_orthogonal(network: nn.Module, last_gain: float) -> None:
    """Draw orthogonal weights, sqrt(2) in size but for the last layer, and no biases."""
    *hidden, last = [layer for layer in network.modules() if isinstance(layer, nn.Linear)]
    for layer in (*hidden, last):
        nn.init.orthogonal_(layer.weight, last_gain if layer is last else math.sqrt(2.0))
        nn.init.zeros_(layer.bias)


def generalised_advantages(errors: Tensor, ended: Tensor, decay: float) -> Tensor:
    """Generalised advantage estimation (Schulman et al., 2016, eq. 16).

    Args:
        errors: (T, ...) of the value: reward + gamma * the next value - this one.
        ended: (T, ...) whether the decision was an episode's last.
        decay: gamma * lambda.

    Returns:
        (T, ...): sums of later errors of the episode, each weighed by `decay` per decision.
    """
    advantages, last = torch.empty_like(errors), torch.zeros_like(errors[0])
    for t in reversed(range(len(errors))):
        last = errors[t] + decay * torch.where(ended[t], 0.0, last)
        advantages[t] = last
    return advantages
