"""What is particular to learning each task: practice, what counts as good, and defaults.

A recipe is data and two small functions. All that trains, judges and writes takes it as it comes,
and asks no task by its name.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import Any

from swarm_envs.agents.feature_sets import GOAL, REFERENCE, TYPED
from swarm_envs.errors import check_name
from swarm_envs.tasks.base import Task
from swarm_envs.tasks.ring import REWARD_WEIGHTS as RING_REWARDS
from swarm_envs.tasks.swap import REWARD_WEIGHTS
from swarm_envs.training.rl.config import TrainConfig
from swarm_envs.training.rl.formations import practise_formation
from swarm_envs.training.rl.starts import practise_swap

_REACH = {"horizon_s": 3.5, "deviation": math.exp(-0.5), "discount": 0.98}
"""Defaults where places are to be found: explored widely, rewarded late."""
Metrics = Mapping[str, Any]
"""`episode_metrics` of one episode."""
LOST_M = 0.15
"""Height error with which an episode counts that was lost: what ends a ring's success, m."""


def success(metrics: Metrics) -> float:
    """1 if the team has done its task."""
    return float(metrics["success"])


def collision(metrics: Metrics) -> float:
    """1 if drones collided."""
    return float(metrics["collided_drones"] > 0)


def worst_height_error(metrics: Metrics) -> float:
    """Largest vertical distance of any drone to its reference, m; `LOST_M` of a lost episode."""
    error = metrics["worst_height_error_m"]
    return LOST_M if error is None or not metrics["success"] else float(error)


@dataclass(frozen=True)
class Recipe:
    """How one task is learned."""

    layouts: Mapping[str, Mapping[str, Any]]
    """what `--layout` may name: options of the task's environment"""
    defaults: Mapping[str, Any]
    """of those options of `TrainConfig` that are None unless they are given"""
    judged: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    """layouts on which the policy of a layout is judged; itself alone where nothing is said"""
    reward_weights: Mapping[str, float] = field(default_factory=lambda: REWARD_WEIGHTS)
    """of the practice; those of proximity and of a crash come from the options"""
    practice: Callable[[Task, TrainConfig], Task] = lambda task, _: task
    """the task that is flown in training, made from the layout's"""
    features: str = GOAL
    """name of what the network is told of an observation row"""
    features_of_types: str = TYPED
    """the same where teams have vehicles of several types"""
    measures: Mapping[str, Callable[[Metrics], float]] = field(
        default_factory=lambda: {"success": success, "collision": collision}
    )
    """what a judged episode is measured by; averaged over episodes"""
    cost: Mapping[str, float] = field(default_factory=dict)
    """what is taken off a layout's success for each measure, times this, to say how good it is"""

    def completed(self, config: TrainConfig) -> TrainConfig:
        """The options with this recipe's defaults for what was not given.

        Raises:
            ValueError: there is no such layout; the message lists those that exist.
        """
        missing = [k for k in self.defaults if config.uses(k) and getattr(config, k) is None]
        whole = replace(config, **{k: self.defaults[k] for k in missing})
        check_name("--layout", whole.layout, self.layouts)
        return whole

    def judged_on(self, layout: str) -> tuple[str, ...]:
        """Layouts on which a policy trained on `layout` is judged."""
        return self.judged.get(layout, (layout,))

    def quality(self, measured: Mapping[str, float]) -> float:
        """How good a policy is: the larger, the better.

        Args:
            measured: averages of measures by what was flown, such as `random_success`.
        """
        end, total = "_success", 0.0
        names = [key.removesuffix(end) for key in measured if key.endswith(end)]
        for name in names:
            cost = sum(weight * measured[f"{name}_{k}"] for k, weight in self.cost.items())
            total += measured[name + end] - cost
        return total / len(names)


RECIPES: Mapping[str, Recipe] = MappingProxyType(
    {
        "swap_v0": Recipe(
            layouts={name: {"layout": name} for name in ("random", "circle")},
            defaults={"layout": "random", **_REACH},
            judged={"random": ("random", "circle")},
            practice=practise_swap,
        ),
        "formation_v0": Recipe(
            layouts={name: {"layout": name} for name in ("shuffle", "cube", "tour")},
            defaults={"layout": "shuffle", **_REACH},
            judged={"shuffle": ("shuffle", "cube", "tour")},
            practice=practise_formation,
        ),
        "ring_v0": Recipe(
            layouts={"rings": {}},
            defaults={"layout": "rings", "horizon_s": 5.0, "deviation": 0.2, "discount": 0.95},
            reward_weights={**RING_REWARDS, "progress": 1.0, "at_goal": 3.0, "tracking": 6.0},
            features=REFERENCE,
            features_of_types=REFERENCE,
            measures={
                "success": success,
                "collision": collision,
                "worst_height_error_m": worst_height_error,
            },
            cost={"worst_height_error_m": 1.0 / LOST_M},
        ),
    }
)
"""Every task that can be learned, by its versioned name."""


def completed(config: TrainConfig, task: str) -> TrainConfig:
    """The options of a run with the defaults of its task's recipe.

    Raises:
        ValueError: the task has no recipe, or no such layout.
    """
    return RECIPES[check_name("task with a recipe", task, RECIPES)].completed(config)
