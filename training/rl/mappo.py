"""MAPPO: Stable-Baselines3's PPO with one actor for all drones, whose critic sees the whole team.

Yu et al., "The Surprising Effectiveness of PPO in Cooperative Multi-Agent Games", 2022: PPO whose
critic, used in training alone, looks at what no drone senses. Of its suggestions here: a state of
the team from each drone's view; and values in units of their own spread.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from gymnasium import spaces
from stable_baselines3.common.buffers import RolloutBuffer
from torch import Tensor, nn

from swarm_envs.envs.core import SwarmCore
from swarm_envs.envs.observation import Float32Array
from swarm_envs.envs.options import Blueprint
from swarm_envs.training.rl.encoders import hidden_layers
from swarm_envs.training.rl.ppo import PpoLearner, TeamPolicy
from swarm_envs.training.shared_policy import SharedPolicyVecEnv


class MappoLearner(PpoLearner):
    """A policy in training by MAPPO; what its methods are for, see `Learner`."""

    def make_env(self, blueprints: Sequence[Blueprint], share: int) -> SharedPolicyVecEnv:
        """The environments of all teams, so many of each, with states for the critic."""
        return TeamStateVecEnv(blueprints, share, self.config.seed, features=self.features)

    def policy_class(self) -> type[TeamPolicy]:
        """Actor, and a critic of the team's state."""
        return TeamStatePolicy


class TeamStateVecEnv(SharedPolicyVecEnv):
    """Every drone's features, and behind them the true states of the others, in turn from its own.

    Its own state is left out: features say it already. Teams smaller than the largest have zeros.
    """

    def _observed_space(self) -> spaces.Box:
        (features,) = super()._observed_space().shape or ()
        others = max(core.num_drones for core in self.cores) - 1
        self._others = (others, self.core.team_state().shape[-1])
        return spaces.Box(-np.inf, np.inf, (features + np.prod(self._others, dtype=int),))

    def _observations(self) -> Float32Array:
        return np.concatenate([self._seen(core) for core in self.cores])

    def _seen(self, core: SwarmCore, places: Any = np.s_[:]) -> Float32Array:
        return np.hstack([super()._seen(core, places), self._states(core)[places]])

    def _states(self, core: SwarmCore) -> Float32Array:
        """(E * N, width) of the others of every drone."""
        states = core.team_state()
        found = np.zeros((*states.shape[:2], *self._others), np.float32)
        for k in range(1, core.num_drones):
            found[:, :, k - 1] = np.roll(states, -k, axis=1)
        return found.reshape(core.num_envs * core.num_drones, -1)


class TeamStatePolicy(TeamPolicy):
    """An actor of the features, and a critic of all that `TeamStateVecEnv` shows."""

    value_net: Any

    def _build(self, lr_schedule: Any) -> None:
        widths = (
            self.observation_space.shape[0],
            *self.pi_features_extractor.trunks.spec.hidden[:-1],
        )
        self.vf_features_extractor = hidden_layers((*widths, self.features_dim), "tanh")
        super()._build(lr_schedule)
        self.value_net = SpreadLinear(self.value_net)

    def value_gradient(self, values: Tensor, returns: Tensor) -> Tensor:
        """Of Huber's loss in units of the spread, at the values (B,)."""
        deviation = self.value_net.spread()[1]
        return ((values - returns) / deviation).clamp(-1.0, 1.0) / deviation

    def note_rollout(self, rollout: RolloutBuffer) -> None:
        """Let the critic's units follow the returns."""
        (whole,) = rollout.get()
        self.value_net.note_returns(whole.returns)


class SpreadLinear(nn.Module):
    """A layer to values, in units of the spread of returns so far."""

    def __init__(self, linear: nn.Linear) -> None:
        super().__init__()
        self.linear = linear
        self.register_buffer("moments", torch.tensor([0.0, 1.0, 0.0]))
        self.moments: Tensor

    def forward(self, latent: Tensor) -> Tensor:
        """Values in units of reward."""
        mean, deviation = self.spread()
        values: Tensor = self.linear(latent) * deviation + mean
        return values

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
