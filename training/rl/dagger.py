"""DAgger in plain torch: a policy imitates teachers in the states to which it brings itself.

Ross et al., "A Reduction of Imitation Learning and Structured Prediction to No-Regret Online
Learning", 2011: the policy flies, a teacher says at every decision what it would have done, and the
policy is fitted to all that is remembered. At first the teacher flies too, less and less often; a
third of the environments add noise, from which the policy learns to come back.

A teacher is any agent, and may be privileged: see `labels`. Parts of a curriculum and sizes of
teams may have teachers of their own. A checkpoint holds what is remembered too; that of a run's
end, when nothing is learned any more, holds none.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from swarm_envs.agents.features import FEATURE_SETS
from swarm_envs.agents.networks import Network
from swarm_envs.envs.core import SwarmCore
from swarm_envs.envs.observation import Float32Array
from swarm_envs.envs.options import Blueprint
from swarm_envs.training.rl.encoders import Actor
from swarm_envs.training.rl.labels import Teacher, teachers_of
from swarm_envs.training.rl.learner import Entry, Learner, Watch
from swarm_envs.training.rl.recipes import recipe_of
from swarm_envs.training.rl.rl_config import RlConfig
from swarm_envs.training.shared_policy import SharedPolicyVecEnv

_MEMORY, _PLACE = "memory.", "memory_place"
_LARGEST_GRADIENT = 1.0
_NOISY = 3  # Every so many environments, one flies with noise


class DaggerLearner(Learner):
    """A policy in training by DAgger; what its methods are for, see `Learner`."""

    prefix = "networks."

    def __init__(self, config: RlConfig, task: str) -> None:
        torch.manual_seed(config.seed)
        super().__init__(config, task)
        self.networks = Actor(self.spec, self.env.core.mode.width)
        self.start_from(self.networks.trunks, self.networks.head)
        self.adam = torch.optim.Adam(self.networks.parameters(), fused=True)
        size = self.config.dagger.buffer_size
        widths = {"seen": self.sizes.width, "wanted": self.env.core.mode.width, "weight": 1}
        self._memory = {name: torch.zeros(size, width) for name, width in widths.items()}
        self._place, self._filled, self._flown = 0, 0, 0
        self._rng = np.random.default_rng(config.seed)

    def make_env(self, blueprints: list[Blueprint], share: int) -> SharedPolicyVecEnv:
        """The parts of every team's curriculum, each with its share of environments."""
        parts, counts, taught = [], [], []
        for blueprint in blueprints:
            found = recipe_of(blueprint.task.name).parts(blueprint.task, self.config)
            given = [max(1, round(portion * share)) for portion, _ in found.values()]
            counts += [share - sum(given[1:]), *given[1:]]
            for part, (_, task) in found.items():
                parts.append(blueprint._replace(task=task))
                taught.append((part, len(task.team)))
        if min(counts) < 1:
            raise ValueError(
                f"--environments is {self.config.environments}, but each of {len(counts)} parts of "
                f"the training needs one or more; give at least {len(counts)}"
            )
        names = teachers_of(self.config.dagger.teacher, taught)
        self._teachers = [Teacher(n, b) for n, b in zip(names, parts, strict=True)]
        return SharedPolicyVecEnv(parts, counts, self.config.seed)

    def fly(self, segment: range, watch: Watch | None = None) -> Entry:
        """Train for the rollouts of a segment."""
        config, seed = self.config, self.config.segment_seed(segment)
        self._rng, self._flown = np.random.default_rng(seed), segment.stop
        for core in self.env.cores:
            seed += core.num_envs
            core.reset([seed + e for e in range(core.num_envs)])
        self.start_counting()
        for rollout in segment:
            guided = config.dagger.guided * config.rollouts
            share = max(0.0, 1.0 - rollout / guided) if guided else 0.0
            for _ in range(config.dagger.train_freq):
                self._step(share)
            rate = config.learning_rate_after(rollout)
            loss = self._learn(rate)
            if watch is not None:
                watch()
        step = float(segment.stop * config.rollout_steps)
        return {"step": step, **self.rates(), "learning_rate": rate, "loss": loss}

    def _step(self, guided: float) -> None:
        """One decision of every drone: fly it, and remember what the teacher would have done."""
        seen = [self._features(core) for core in self.env.cores]
        with torch.no_grad():
            means = self.networks(torch.from_numpy(np.concatenate(seen))).numpy()
        first = 0
        for core, teacher, features in zip(self.env.cores, self._teachers, seen, strict=True):
            wanted, weight = teacher.labels(core, self.config.dagger.avoiding)
            running = means[first : first + len(features)].reshape(wanted.shape)
            first += len(features)
            flies = core.world.drones["active"].reshape(-1) > 0.0
            rows = (features, wanted, weight)
            self._remember(*(part.reshape(len(flies), -1)[flies] for part in rows))
            self._fly(core, self._flown_actions(running, wanted, guided))

    def _features(self, core: SwarmCore) -> Float32Array:
        """(E * N, width) of every drone of a core now."""
        made = FEATURE_SETS[self.features].make(core.rows, *core.form[1:])
        return made.reshape(-1, made.shape[-1])

    def _flown_actions(self, own: Float32Array, wanted: Float32Array, guided: float) -> Any:
        """Of each environment the policy's or the teacher's (E, N, width), with noise in some."""
        draws = self._rng.random((len(own), 1, 1))
        noise = self._rng.normal(0.0, self.config.dagger.noise, own.shape)
        noise[np.arange(len(own)) % _NOISY != 0] = 0.0
        return np.clip(np.where(draws < guided, wanted, own) + noise, -1.0, 1.0)

    def _fly(self, core: SwarmCore, actions: Any) -> None:
        result = core.step(actions)
        ended = result.terminated | result.truncated
        if ended.any():
            for metrics in core.metrics_of(np.flatnonzero(ended).tolist()):
                self.count(metrics)
            core.reset(mask=ended)

    def _remember(self, *rows: Float32Array) -> None:
        """Write rows (R, width) over the oldest."""
        count, size = len(rows[0]), self.config.dagger.buffer_size
        places = torch.from_numpy((self._place + np.arange(count)) % size)
        for held, new in zip(self._memory.values(), rows, strict=True):
            held[places] = torch.from_numpy(new)
        self._place = (self._place + count) % size
        self._filled = min(self._filled + count, size)

    def _learn(self, rate: float) -> float:
        """Gradient steps on what is remembered; the mean loss."""
        options, losses = self.config.dagger, []
        self.adam.param_groups[0]["lr"] = rate
        for _ in range(options.gradient_steps):
            chosen = torch.from_numpy(self._rng.integers(self._filled, size=options.batch_size))
            seen, wanted, weight = (held[chosen] for held in self._memory.values())
            errors = nn.functional.huber_loss(
                self.networks(seen), wanted, reduction="none", delta=options.huber
            )
            loss = (weight * errors).mean()
            self.adam.zero_grad()
            loss.backward()  # type: ignore[no-untyped-call]
            nn.utils.clip_grad_norm_(self.networks.parameters(), _LARGEST_GRADIENT)
            self.adam.step()
            losses.append(float(loss.detach()))
        return float(np.mean(losses))

    def actor(self) -> dict[str, Network]:
        """The networks whose output is the action."""
        return self.networks.networks()

    def network(self) -> nn.Module:
        """The actor alone."""
        return self.networks

    def optimisers(self) -> dict[str, torch.optim.Optimizer]:
        """Adam."""
        return {"optimiser.": self.adam}

    def tensors(self) -> dict[str, Tensor]:
        """Weights and Adam's averages; and while it learns, what is remembered."""
        tensors = super().tensors()
        if self._flown < self.config.rollouts:
            held = {_MEMORY + n: part[: self._filled] for n, part in self._memory.items()}
            tensors |= {**held, _PLACE: torch.tensor(self._place)}
        return tensors

    def load(self, tensors: Mapping[str, Tensor]) -> None:
        """Take what `tensors` gave."""
        super().load(tensors)
        if _PLACE in tensors:
            for name, part in self._memory.items():
                held = tensors[_MEMORY + name]
                part[: len(held)] = held
            self._place, self._filled = int(tensors[_PLACE]), len(held)
