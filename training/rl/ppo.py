"""Stable-Baselines3's PPO with parameter sharing: all drones of all teams share one policy.

Its networks are those of `swarm_envs.training.rl.encoders`; Stable-Baselines3 puts a linear layer
behind what comes out of them, for actions and for values. The update computes the gradient of
Stable-Baselines3's loss at the outputs of the networks in closed form, and draws a batch from one
table: the same mathematics with fewer calls.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import numpy as np
import torch
from stable_baselines3 import PPO
from stable_baselines3.common.buffers import RolloutBuffer
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.policies import ActorCriticPolicy
from stable_baselines3.common.type_aliases import RolloutBufferSamples
from stable_baselines3.common.vec_env import VecEnv
from torch import Tensor, nn

from swarm_envs.agents.networks import Network
from swarm_envs.envs.observation import Float32Array
from swarm_envs.training.rl.encoders import Actor, TrunkExtractor, plain_networks
from swarm_envs.training.rl.learner import Entry, Sb3Learner, Watch
from swarm_envs.training.rl.rl_config import RlConfig

_HALF_LOG_TAU = 0.5 * math.log(2.0 * math.pi)


class PpoLearner(Sb3Learner):
    """A policy in training by PPO; what its methods are for, see `Learner`."""

    def __init__(self, config: RlConfig, task: str) -> None:
        super().__init__(config, task)
        config = self.config
        assert config.log_std_init is not None  # the recipe has one
        self.model = TeamPpo(
            self.policy_class(),
            self.env,
            learning_rate=lambda _: config.learning_rate_after(self.rollouts),
            n_steps=config.n_steps,
            batch_size=config.batch_size,
            n_epochs=config.n_epochs,
            gamma=config.gamma,
            gae_lambda=config.gae_lambda,
            clip_range=config.clip_range,
            ent_coef=config.ent_coef,
            rollout_buffer_class=FlownRollouts,
            rollout_buffer_kwargs={"waiting": self.env.waiting},
            seed=config.seed,
            device="cpu",
            policy_kwargs={
                "features_extractor_class": TrunkExtractor,
                "features_extractor_kwargs": {"spec": self.spec},
                "share_features_extractor": False,
                "net_arch": [],
                "log_std_init": config.log_std_init,
                "optimizer_kwargs": {"eps": 1e-5, "fused": True},
            },
        )
        policy = self.model.policy
        self.model.start_kl = config.start_kl
        self.model.start = self.start_from(policy.pi_features_extractor.trunks, policy.action_net)

    def policy_class(self) -> type[TeamPolicy]:
        """Actor and critic."""
        return TeamPolicy

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
        policy, least = self.model.policy, max(self.config.second_deviation, 1e-6)
        policy.log_std.data.clamp_(min=math.log(least))
        policy.optimizer = policy.optimizer_class(
            policy.parameters(), lr=self.config.second_rate, **policy.optimizer_kwargs
        )

    def actor(self) -> dict[str, Network]:
        """The networks whose output is the mean action."""
        policy = self.model.policy
        return plain_networks(policy.pi_features_extractor.trunks, policy.action_net)

    def optimisers(self) -> dict[str, torch.optim.Optimizer]:
        """Adam."""
        return {"optimiser.": self.model.policy.optimizer}


class FlownRollouts(RolloutBuffer):  # type: ignore[misc]  # SB3's base has no types here
    """Stable-Baselines3's rollouts, of which only decisions of drones that flew are learned from.

    `waiting` is how observations begin of a drone that has ended before its team.
    """

    def __init__(self, *arguments: Any, waiting: Float32Array, **options: Any) -> None:
        self._waiting = waiting
        super().__init__(*arguments, **options)

    def reset(self) -> None:
        """Forget what was flown."""
        super().reset()
        self._table: Tensor | None = None

    def get(self, batch_size: int | None = None) -> Iterator[RolloutBufferSamples]:
        """Batches in random order, of at most this many decisions; None for a single one."""
        if self._table is None:
            tables = (self.observations, self.actions, self.values, self.log_probs)
            columns = [self.swap_and_flatten(t) for t in (*tables, self.advantages, self.returns)]
            flew = (columns[0][:, : len(self._waiting)] != self._waiting).any(1)
            self._table, self._flown = torch.from_numpy(np.hstack(columns)), np.flatnonzero(flew)
        order = torch.from_numpy(np.random.permutation(self._flown))  # noqa: NPY002  # as SB3
        for chosen in torch.split(order, batch_size or len(order)):
            rows = self._table.index_select(0, chosen)
            seen, done, rest = torch.split(rows, [self.obs_shape[0], self.action_dim, 4], dim=1)
            yield RolloutBufferSamples(seen, done, *rest.unbind(1))


class TeamPolicy(ActorCriticPolicy):  # type: ignore[misc]  # SB3's base has no types here
    """Stable-Baselines3's policy, which computes only what an update needs."""

    def _build(self, lr_schedule: Any) -> None:
        super()._build(lr_schedule)
        self.features_extractor = None  # another name of the actor's

    def means(self, seen: Tensor) -> Tensor:
        """Mean actions (B, width)."""
        means: Tensor = self.action_net(self.pi_features_extractor(seen))
        return means

    def value_gradient(self, values: Tensor, returns: Tensor) -> Tensor:
        """Of half the squared error, at the values (B,)."""
        return values - returns

    def note_rollout(self, rollout: RolloutBuffer) -> None:
        """Called before a rollout is learned from."""

    def forward(self, obs: Tensor, deterministic: bool = False) -> tuple[Tensor, Tensor, Tensor]:
        """Actions that are drawn (B, width), values (B, 1), and log probabilities (B,)."""
        means, deviation = self.means(obs), self.log_std.exp()
        noise = torch.zeros_like(means) if deterministic else torch.randn_like(means)
        density = -0.5 * noise.square() - self.log_std - _HALF_LOG_TAU
        return means + deviation * noise, self.predict_values(obs), density.sum(1)


class TeamPpo(PPO):  # type: ignore[misc]  # SB3's base has no types here
    """Stable-Baselines3's PPO, whose update takes fewer calls, and may stay close to a policy."""

    start: Actor | None = None
    """The policy from which the divergence (Kullback-Leibler) is weighed in the loss by
    `start_kl`."""
    start_kl = 0.0
    _last_obs: Float32Array
    _last_episode_starts: Any

    def collect_rollouts(
        self,
        env: VecEnv,
        callback: BaseCallback,
        rollout_buffer: RolloutBuffer,
        n_rollout_steps: int,
    ) -> bool:
        """Fly so many decisions of every drone; False if a callback stops the training."""
        rollout_buffer.reset()
        callback.on_rollout_start()
        space = self.action_space
        for _ in range(n_rollout_steps):
            with torch.no_grad():
                drawn, values, log_probs = self.policy(torch.from_numpy(self._last_obs))
            actions = drawn.numpy()
            flown = np.clip(actions, space.low, space.high)
            new_obs, rewards, dones, infos = env.step(flown)
            self.num_timesteps += env.num_envs
            callback.update_locals(locals())
            if not callback.on_step():
                return False
            self._update_info_buffer(infos, dones)
            cut = [k for k in np.flatnonzero(dones) if infos[k]["TimeLimit.truncated"]]
            if cut:  # by the clock: what would have followed has a value
                ends = np.stack([infos[k]["terminal_observation"] for k in cut])
                rewards[cut] += self.gamma * self._values(ends)
            kept = (self._last_obs, actions, rewards, self._last_episode_starts, values, log_probs)
            rollout_buffer.add(*kept)
            self._last_obs, self._last_episode_starts = new_obs, dones
        last = torch.from_numpy(self._values(new_obs))
        rollout_buffer.compute_returns_and_advantage(last, dones)
        callback.update_locals(locals())
        callback.on_rollout_end()
        return True

    @torch.no_grad()
    def _values(self, seen: Float32Array) -> Float32Array:
        """Expected returns (B,) of observations (B, width)."""
        values: Float32Array = self.policy.predict_values(torch.from_numpy(seen))[:, 0].numpy()
        return values

    def train(self) -> None:
        """Update the policy by the rollout, as Stable-Baselines3 does (no `target_kl`)."""
        self._update_learning_rate(self.policy.optimizer)
        self._gradients = flat_gradients(self.policy)
        self.policy.note_rollout(self.rollout_buffer)
        for _ in range(self.n_epochs):
            said = [self._descend(batch) for batch in self.rollout_buffer.get(self.batch_size)]
        self._n_updates += self.n_epochs
        kl, value_loss = np.mean(said, axis=0)
        self.logger.record("train/approx_kl", kl)
        self.logger.record("train/value_loss", value_loss)

    def _descend(self, batch: RolloutBufferSamples) -> tuple[float, float]:
        """One step of Adam; the divergence from the rollout's policy, and the values' loss."""
        policy, gradients = self.policy, self._gradients.zero_()
        means = policy.means(batch.observations)
        values = policy.predict_values(batch.observations)
        at_values = policy.value_gradient(values.detach()[:, 0], batch.returns)
        at_values = (2.0 * self.vf_coef / len(means) * at_values)[:, None]
        errors = values.detach()[:, 0] - batch.returns
        at_means, kl = self._loss_gradient(means.detach(), batch)
        torch.autograd.backward((means, values), (at_means, at_values))
        gradients *= (self.max_grad_norm / (gradients.norm() + 1e-6)).clamp(max=1.0)
        policy.optimizer.step()
        return kl, float(errors.dot(errors)) / len(errors)

    def _loss_gradient(self, means: Tensor, batch: RolloutBufferSamples) -> tuple[Tensor, float]:
        """The loss' gradient at the means (B, width), and the divergence; adds that of deviations.

        Schulman et al., "Proximal Policy Optimization Algorithms", 2017, eq. 7: where the ratio of
        probabilities is clipped, there is none.
        """
        log_std, count = self.policy.log_std, len(means)
        gains, deviation = batch.advantages.numpy(), log_std.detach().exp().numpy()
        if self.normalize_advantage and count > 1:
            gains = (gains - gains.mean()) / (gains.std(ddof=1) + 1e-8)
        away = (batch.actions.numpy() - means.numpy()) / deviation
        squares, ones = np.square(away), np.ones(len(deviation), np.float32)
        change = -0.5 * (squares @ ones) - batch.old_log_prob.numpy()
        change -= np.log(deviation).sum() + len(ones) * _HALF_LOG_TAU
        ratio, clip = np.exp(change), self.clip_range(self._current_progress_remaining)
        free = np.where(gains > 0.0, ratio <= 1.0 + clip, ratio >= 1.0 - clip)
        slope = gains * ratio * free / np.float32(-count)
        at_means = slope[:, None] * away / deviation
        at_deviations = slope @ (squares - 1.0) - self.ent_coef
        if self.start is not None and self.start_kl:
            seen = batch.observations[:, : self.start.trunks.spec.sizes.width]
            apart = (means - self.start(seen)).numpy() / deviation
            at_means += self.start_kl / count * apart / deviation
            at_deviations -= self.start_kl * np.square(apart).mean(axis=0)
        log_std.grad += torch.from_numpy(at_deviations)
        return torch.from_numpy(at_means), float((ratio - 1.0 - change).mean())


def flat_gradients(network: nn.Module) -> Tensor:
    """Gradients of all parameters in one tensor, of which each parameter's own is a view."""
    parameters = list(network.parameters())
    sizes = [parameter.numel() for parameter in parameters]
    flat = torch.zeros(sum(sizes))
    for parameter, part in zip(parameters, torch.split(flat, sizes), strict=True):
        parameter.grad = part.view_as(parameter)
    return flat
