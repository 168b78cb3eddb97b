"""What PPO, SAC, MAPPO and DAgger share: environments, episode statistics, segments, named tensors.

Every algorithm flies in segments that can be repeated: each begins with new episodes, and with
generators that follow from the run's seed and the segment's place. So a checkpoint between two
segments holds tensors alone, no environment and no generator; and a run that resumes from one ends
as if nothing had happened.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import replace
from importlib import import_module
from typing import Any

import torch
from stable_baselines3.common.callbacks import BaseCallback
from torch import Tensor, nn

from swarm_envs.agents.features import FEATURE_SETS, FULL, TYPES
from swarm_envs.agents.networks import Network
from swarm_envs.agents.policy import PolicyAgent, senses
from swarm_envs.agents.registry import load_agent
from swarm_envs.envs.options import Blueprint, batch_of
from swarm_envs.tasks.rewards import write_terms
from swarm_envs.training.rl.encoders import Actor, Trunks, encoder_spec, fill
from swarm_envs.training.rl.recipes import recipe_of, with_recipe
from swarm_envs.training.rl.rl_config import RlConfig
from swarm_envs.training.shared_policy import SharedPolicyVecEnv

Entry = dict[str, float]  # What is noted of a point of the training curve, by name
Watch = Callable[[], None]  # Called after every rollout: where a progress bar moves

_LEARNERS = {
    **{"ppo": "PpoLearner", "mappo": "MappoLearner"},
    **{"sac": "SacLearner", "dagger": "DaggerLearner"},
}
"""The class of each algorithm, in the module of its name."""


class Learner(ABC):
    """A policy in training.

    Args:
        config: of the run.
        task: its versioned name.

    Raises:
        ValueError: an option has an impossible value.
    """

    prefix = "policy."  # What names of the network's tensors begin with

    def __init__(self, config: RlConfig, task: str) -> None:
        torch.set_num_threads(1)  # matrices are small: more threads wait for each other
        self.config = config = with_recipe(config, task)
        blueprints = [training_blueprint(config, task, team) for team in config.teams]
        present = {vehicle.token for found in blueprints for vehicle in found.task.team}
        flown, recipe = tuple(token for token in TYPES if token in present), recipe_of(task)
        if config.per_type and len(flown) < 2:
            raise ValueError(
                f"--per-type needs vehicles of several types, but all here are {flown[0]}; name a "
                "team such as --team SSLL"
            )
        self.form = (config.num_neighbors, *senses_of(config))
        self.features = recipe.features_of_types if len(flown) > 1 else recipe.features
        self.features = config.features or (FULL if any(self.form[1:]) else self.features)
        self.sizes = FEATURE_SETS[self.features].sizes(*self.form)
        self.types = flown if self.sizes.typed else ()
        self.spec = encoder_spec(config, self.sizes, self.types)
        self.env = self.make_env(blueprints, config.environments // len(blueprints))
        self.env.decision_cost = config.time_cost * config.reward_scale / config.decision_rate
        self.start_counting()

    def make_env(self, blueprints: list[Blueprint], share: int) -> SharedPolicyVecEnv:
        """The environments of all teams, so many of each."""
        return SharedPolicyVecEnv(blueprints, share, self.config.seed, features=self.features)

    def start_from(self, trunks: Trunks, head: nn.Linear) -> Actor | None:
        """Fill an actor with the policy to start from, and return that frozen; None without one."""
        if self.config.start is None:
            return None
        agent = load_agent(self.config.start)
        if not isinstance(agent, PolicyAgent):
            raise ValueError(f"--start is {self.config.start!r}, but must be a trained policy")
        fill(trunks, head, agent.policy.networks)
        frozen = Actor(self.spec, head.out_features).requires_grad_(False)
        fill(frozen.trunks, frozen.head, agent.policy.networks)
        return frozen

    @abstractmethod
    def fly(self, segment: range, watch: Watch | None = None) -> Entry:
        """Train for the rollouts of a segment.

        Args:
            segment: of `RlConfig.segments`; the one after those that were trained.
            watch: called after every rollout.

        Returns:
            Averages over the segment: `step`, where it stands; `success` and `collision`, shares
            of its episodes; and what the algorithm says of itself.
        """

    @abstractmethod
    def actor(self) -> dict[str, Network]:
        """The networks whose output is the mean action, as `Policy` takes them."""

    @abstractmethod
    def network(self) -> nn.Module:
        """All that is trained, as one module."""

    @abstractmethod
    def optimisers(self) -> dict[str, torch.optim.Optimizer]:
        """Those that train it, by what names of their tensors begin with."""

    def tensors(self) -> dict[str, Tensor]:
        """All that the next segments depend on, by names of the algorithm's own."""
        weights = self.network().state_dict()
        tensors = {self.prefix + name: tensor for name, tensor in weights.items()}
        for prefix, optimiser in self.optimisers().items():
            for place, entries in optimiser.state_dict()["state"].items():
                for name, value in entries.items():
                    tensors[f"{prefix}{place}.{name}"] = torch.as_tensor(value).clone()
        return tensors

    def load(self, tensors: Mapping[str, Tensor]) -> None:
        """Stand where another learner of the same options gave these tensors.

        Raises:
            KeyError, RuntimeError, ValueError: they are of networks of another kind.
        """
        self.network().load_state_dict(_without_prefix(tensors, self.prefix))
        for prefix, optimiser in self.optimisers().items():
            state: dict[int, dict[str, Tensor]] = {}
            for name, tensor in _without_prefix(tensors, prefix).items():
                place, _, entry = name.partition(".")
                state.setdefault(int(place), {})[entry] = tensor
            groups = optimiser.state_dict()["param_groups"]
            optimiser.load_state_dict({"state": state, "param_groups": groups})

    def start_counting(self) -> None:
        """Begin to count ends of episodes again."""
        self._episodes = self._successes = self._collisions = 0

    def count(self, metrics: Mapping[str, Any]) -> None:
        """Count how an episode has ended."""
        self._episodes += 1
        self._successes += metrics["success"]
        self._collisions += metrics["collided_drones"] > 0

    def rates(self) -> Entry:
        """Shares of the episodes that have ended since the segment began."""
        ended = max(self._episodes, 1)
        return {"success": self._successes / ended, "collision": self._collisions / ended}

    def close(self) -> None:
        """Free the environments."""
        self.env.close()


class Sb3Learner(Learner):
    """What the algorithms of Stable-Baselines3 share, which fly by `model.learn`."""

    model: Any  # PPO or SAC
    rollouts = 0  # How many were flown when the present one began; schedules follow it

    def fly(self, segment: range, watch: Watch | None = None) -> Entry:
        """Train for the rollouts of a segment."""
        config, model = self.config, self.model
        model.set_random_seed(config.segment_seed(segment))  # SB3's draws are global
        model._last_obs = None  # begin new episodes
        self.start_counting()
        model.num_timesteps = segment.start * config.rollout_steps
        model.learn(
            len(segment) * config.rollout_steps,
            callback=_RolloutCallback(self, watch),
            log_interval=None,
            reset_num_timesteps=False,
        )
        self.rollouts = segment.stop
        return {"step": float(model.num_timesteps), **self.rates()}

    def network(self) -> nn.Module:
        """The policy of Stable-Baselines3."""
        policy: nn.Module = self.model.policy
        return policy

    def begin_rollout(self, steps: int) -> None:
        """Set what depends on how many steps were flown."""
        self.rollouts = steps // self.config.rollout_steps
        weight = self.config.proximity_weight_after(self.rollouts)
        for core in self.env.cores:
            core.set_reward_weights({"proximity": weight})


class _RolloutCallback(BaseCallback):  # type: ignore[misc]  # SB3's base has no types here
    """Counts ends of episodes, and tells the learner and the run of rollouts."""

    def __init__(self, learner: Sb3Learner, watch: Watch | None) -> None:
        super().__init__()
        self._learner, self._watch = learner, watch
        self._firsts = learner.env.first_drones

    def _on_step(self) -> bool:
        for k in self._firsts:
            if "episode_metrics" in (info := self.locals["infos"][k]):
                self._learner.count(info["episode_metrics"])
        return True

    def _on_rollout_start(self) -> None:
        self._learner.begin_rollout(self.num_timesteps)

    def _on_rollout_end(self) -> None:
        if self._watch is not None:
            self._watch()


def make_learner(config: RlConfig, task: str) -> Learner:
    """A fresh learner of the algorithm that the options name, for a versioned task."""
    module = import_module(f"swarm_envs.training.rl.{config.algo}")
    learner: Learner = getattr(module, _LEARNERS[config.algo])(config, task)
    return learner


def training_blueprint(config: RlConfig, task: str, team: Mapping[str, Any]) -> Blueprint:
    """What a team, one of `config.teams`, trains in: the recipe's curriculum with a short clock.

    Raises:
        ValueError: an option has an impossible value.
    """
    recipe = recipe_of(task)
    given = {**recipe.reward_weights, "crash": -config.crash}
    found = batch_of(
        task,
        **recipe.layouts[str(config.layout)],
        **team,
        reward_weights={name: weight * config.reward_scale for name, weight in given.items()},
        interactions=config.interactions,
        action=config.action,
        decision_rate=config.decision_rate,
        force_rate=config.force_rate,
        num_neighbors=config.num_neighbors,
        horizon_s=config.horizon_s,
        threads=config.threads,
        **senses(*senses_of(config), config.controller),
        **config.air(),
    )
    flown = recipe.curriculum(found.task, config)
    if flown.write_reward_terms is write_terms:  # which counts these by the second
        clock = config.horizon_s or flown.episode_s
        weights = dict(flown.reward_weights)
        whole = recipe.reward_weights.keys() & {"at_goal", "tracking"}
        weights |= {name: weights[name] / clock for name in whole}
        flown = replace(flown, reward_weights=weights)
    return found._replace(task=flown)


def senses_of(config: RlConfig) -> tuple[int, bool, bool]:
    """What a run's policy observes besides neighbors: M, and whether loads and forces."""
    return config.num_obstacles or 0, bool(config.observe_load), config.observe_force


def _without_prefix(tensors: Mapping[str, Tensor], prefix: str) -> dict[str, Tensor]:
    """Those whose names begin so, by what follows."""
    return {n.removeprefix(prefix): t for n, t in tensors.items() if n.startswith(prefix)}
