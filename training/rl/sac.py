"""Stable-Baselines3's SAC with parameter sharing: it learns from every decision many times.

A checkpoint holds what it remembers too, which a run that goes on would otherwise have lost: at
most `--sac.buffer-size` decisions. That of a run's end holds none: nothing is learned after it.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import torch
from stable_baselines3.common.buffers import ReplayBuffer
from torch import Tensor, nn

from swarm_envs.agents.networks import Network, plain
from swarm_envs.training.rl.config import TrainConfig
from swarm_envs.training.rl.learner import Entry, Watch
from swarm_envs.training.rl.practice import Practice
from swarm_envs.training.rl.rollouts import Rollouts
from swarm_envs.training.rl.schedules import falling_rate, proximity_weight, segment_seed
from swarm_envs.training.rl.soft_actor_critic import SoftActorCritic
from swarm_envs.training.rl.tensors import load_optimiser, optimiser_tensors, without_prefix

_POLICY, _MEMORY, _TEMPERATURE, _PLACE = "policy.", "memory.", "log_temperature", "memory_place"
_REMEMBERED = ("observations", "next_observations", "actions", "rewards", "dones", "timeouts")


class SacLearner:
    """A policy in training by SAC; what its methods are for, see `Learner`.

    Args:
        config: of the run.
        task: its versioned name.
    """

    def __init__(self, config: TrainConfig, task: str) -> None:
        torch.set_num_threads(1)  # matrices are small: more threads wait for each other
        assert config.discount is not None  # the recipe has one
        self.config = config
        self.rollouts = 0
        self.env = Practice(config, task)
        widths, options = list(config.hidden), config.sac
        self.model = SoftActorCritic(
            self.env,
            lookahead=options.lookahead,
            gamma=config.discount,
            learning_rate=lambda _: falling_rate(config, self.rollouts),
            buffer_size=options.buffer_size,
            learning_starts=options.learning_starts,
            batch_size=options.batch_size,
            tau=options.smoothing,
            train_freq=options.rollout,
            gradient_steps=options.gradient_steps,
            ent_coef=f"auto_{options.temperature}",
            seed=config.seed,
            device="cpu",
            policy_kwargs={
                "net_arch": widths,
                "activation_fn": nn.Tanh,
                "optimizer_kwargs": {"fused": True},
            },
        )

    def fly(self, segment: range, watch: Watch | None = None) -> Entry:
        """Train for the rollouts of a segment."""
        config, model = self.config, self.model
        model.set_random_seed(segment_seed(config, segment))  # SB3's draws are global
        model._last_obs = None  # begin new episodes
        self.env.clear()
        _cut(self._memory())
        model.num_timesteps = segment.start * config.rollout_steps
        steps, rollouts = len(segment) * config.rollout_steps, Rollouts(self.begin_rollout, watch)
        model.learn(steps, callback=rollouts, log_interval=None, reset_num_timesteps=False)
        self.rollouts = segment.stop
        return self._entry()

    def begin_rollout(self, steps: int) -> None:
        """Set what depends on how many steps were flown."""
        self.rollouts = steps // self.config.rollout_steps
        weight = proximity_weight(self.config, self.rollouts)
        self.env.weigh({"proximity": weight})

    def actor(self) -> dict[str, Network]:
        """The network whose output is the mean action.

        SAC's last layer has a tanh, which a policy's has not: another follows, which changes
        nothing.
        """
        actor = self.model.actor
        linear = [layer for layer in actor.latent_pi if isinstance(layer, nn.Linear)]
        layers = [
            (layer.weight.detach().numpy().copy(), layer.bias.detach().numpy().copy())
            for layer in [*linear, actor.mu]
        ]
        width = len(layers[-1][1])
        return plain((*layers, (np.eye(width, dtype=np.float32), np.zeros(width, np.float32))))

    def tensors(self) -> dict[str, Tensor]:
        """Weights, Adam's averages, the temperature; and while it learns, what it remembers."""
        tensors = {_POLICY + name: t for name, t in self.model.policy.state_dict().items()}
        tensors[_TEMPERATURE] = self.model.log_ent_coef.detach()
        for name, optimiser in self._optimisers().items():
            tensors |= optimiser_tensors(optimiser, name)
        if self.rollouts < self.config.rollouts:
            tensors |= _remembered(self._memory())
        return tensors

    def load(self, tensors: Mapping[str, Tensor]) -> None:
        """Take what `tensors` gave."""
        self.model.policy.load_state_dict(without_prefix(tensors, _POLICY))
        with torch.no_grad():
            self.model.log_ent_coef.copy_(tensors[_TEMPERATURE])
        for name, optimiser in self._optimisers().items():
            load_optimiser(optimiser, tensors, name)
        if _PLACE in tensors:
            _remember(self._memory(), tensors)

    def close(self) -> None:
        """Free the environments."""
        self.env.close()

    def _optimisers(self) -> dict[str, torch.optim.Optimizer]:
        model = self.model
        return {
            "actor_optimiser.": model.actor.optimizer,
            "critic_optimiser.": model.critic.optimizer,
            "temperature_optimiser.": model.ent_coef_optimizer,
        }

    def _memory(self) -> ReplayBuffer:
        memory: ReplayBuffer = self.model.replay_buffer
        return memory

    def _entry(self) -> Entry:
        env, told = self.env, self.model.logger.name_to_value
        ended = max(env.episodes, 1)
        return {
            "step": float(self.model.num_timesteps),
            "success": env.successes / ended,
            "collision": env.collisions / ended,
            "temperature": float(self.model.log_ent_coef.detach().exp()),
            "critic_loss": float(told.get("train/critic_loss", 0.0)),
            "actor_loss": float(told.get("train/actor_loss", 0.0)),
        }


def _cut(memory: ReplayBuffer) -> None:
    """Let no return reach from the last decision into the episode that begins after it."""
    last = memory.pos - 1  # where nothing is remembered yet, a place that will be written over
    memory.timeouts[last] = np.maximum(memory.timeouts[last], 1.0 - memory.dones[last])


def _remembered(memory: ReplayBuffer) -> dict[str, Tensor]:
    """What a memory holds, and where it writes next."""
    filled = memory.buffer_size if memory.full else memory.pos
    tensors = {
        _MEMORY + name: torch.from_numpy(getattr(memory, name)[:filled]) for name in _REMEMBERED
    }
    return {**tensors, _PLACE: torch.tensor(memory.pos)}


def _remember(memory: ReplayBuffer, tensors: Mapping[str, Tensor]) -> None:
    """Let a fresh memory hold what another did."""
    for name in _REMEMBERED:
        held = tensors[_MEMORY + name].numpy()
        getattr(memory, name)[: len(held)] = held
    memory.pos = int(tensors[_PLACE])
    memory.full = len(held) == memory.buffer_size
