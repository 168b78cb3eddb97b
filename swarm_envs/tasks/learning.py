"""Training of a task: `Learning`, the class attribute `learning` of every task.

It defines the episodes that `swarm-envs train` uses, and the quality of a policy.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from swarm_envs.tasks.base import Task

__all__ = ["ALL", "Learning", "collision", "crash", "in_time", "metric", "scored"]

Metrics = Mapping[str, Any]
"""The `episode_metrics` of an episode."""
Measure = Callable[[Metrics], float]
"""A function from the metrics of an evaluation episode to a number, which is averaged."""
Parts = Mapping[str, tuple[float, Any]]
"""Tasks by name, each with its share of the environments."""

ALL = "all"
"""Name of all layouts of a task together."""
LATE_S = 10.0
"""Value of `late_s` for an episode without success, s."""


def success(metrics: Metrics) -> float:
    """Return 1 if the episode is a success, else 0."""
    return float(metrics["success"])


def crash(metrics: Metrics) -> float:
    """Return 1 if any drone hit a drone, the floor, a wall or an obstacle, or tumbled, else 0."""
    hits = (count for name, count in metrics.items() if name.startswith("collided_"))
    return float(metrics["tumbled"] > 0 or any(hits))


def collision(metrics: Metrics) -> float:
    """Return 1 if drones collided with each other, else 0."""
    return float(metrics["collided_drones"] > 0)


def late_s(metrics: Metrics) -> float:
    """Return the time to the goals, s; `LATE_S` without success."""
    return float(metrics["time_to_goal_s"]) if metrics["success"] else LATE_S


def metric(name: str) -> Measure:
    """Return the measure that returns one of the metrics."""
    return lambda metrics: float(metrics[name])


RATES: Mapping[str, Measure] = MappingProxyType(
    {"success": success, "crash": crash, "collision": collision}
)
"""The measures of every task. `crash` is the `collision_rate` of `swarm-envs evaluate`."""


@dataclass(frozen=True, kw_only=True)
class Learning:
    """Layouts, curriculum, reward weights and measures for training a task."""

    layouts: Mapping[str, Mapping[str, Any]]
    """Options of the environment by the value of `--layout`, the default first."""
    evaluated: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    """Layouts on which a policy is evaluated, by the layout of its training; by default the same
    layout."""
    beside: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    """Options of further tasks that are trained together with all layouts, but not evaluated."""
    horizon_s: float | None = 3.5
    """Default time limit in training, s, after which the value is bootstrapped; it is short, since
    failures occur early. None for the task's."""
    observe_load: bool | None = None
    """True to observe loads by default; None for the task's default."""
    has_obstacles: bool = False
    """True if the task has obstacles of its own, in some layout."""
    reward_weights: Mapping[str, float] = field(default_factory=dict)
    """Reward weights in training that differ from the task's. Those of `proximity` and `crash` are
    options of training; `at_goal` and `tracking` are for a whole episode."""
    curriculum: Callable[[Any, str], Task] = lambda task, layout: task
    """A function from the task and the name of its layout to the task of training."""
    parts: Callable[[Any, str], Parts] = lambda task, layout: {layout: (1.0, task)}
    """A function from the task of training and its layout to parts, for which DAgger may have
    different teachers."""
    measures: Mapping[str, Measure] = field(default_factory=lambda: RATES)
    """The measures of an evaluation."""
    cost: Mapping[str, float] = field(default_factory=dict)
    """Factors of measures, by which they lower the quality of a policy."""

    def evaluation_layouts(self, layout: str) -> tuple[str, ...]:
        """Return the layouts on which a policy trained on `layout` is evaluated."""
        return self.evaluated.get(layout, (layout,))

    def quality(self, measured: Mapping[str, float]) -> float:
        """Return the quality of a policy: the mean over layouts of success minus costs.

        Args:
            measured: averages of measures by layout and measure, such as `random_success`.
        """
        end, total = "_success", 0.0
        names = [key.removesuffix(end) for key in measured if key.endswith(end)]
        for name in names:
            cost = sum(weight * measured[f"{name}_{k}"] for k, weight in self.cost.items())
            total += measured[name + end] - cost
        return total / len(names)


def in_time(layouts: Mapping[str, Mapping[str, Any]]) -> Learning:
    """Return the training of a task about downwash, in which late success has a cost."""
    return Learning(
        layouts=layouts,
        horizon_s=None,
        observe_load=True,
        reward_weights={"at_goal": 2.0},
        measures={**RATES, "late_s": late_s},
        cost={"late_s": 0.1},
    )


def scored(
    layouts: Sequence[str],
    score: str,
    full: float,
    more: Mapping[str, Mapping[str, Any]] = MappingProxyType({}),
    **given: Any,
) -> Learning:
    """Return the training of a task with a score, by default on all its layouts together.

    Args:
        layouts: names of its layouts.
        score: the metric that counts in addition to success.
        full: the score that is worth as much as success.
        more: further options of layouts in training, by name.
        **given: other fields of `Learning`.
    """
    names = {name: {"layout": name, **more.get(name, {})} for name in layouts}
    return Learning(
        layouts={ALL: names[layouts[0]], **names},
        horizon_s=None,
        evaluated={ALL: tuple(layouts)},
        parts=_each_layout,
        measures={**RATES, score: metric(score)},
        cost={score: -1.0 / full},
        **given,
    )


def _each_layout(task: Any, layout: str) -> Parts:
    """Return the task of a layout, or equal shares of all layouts and of `beside`."""
    if layout != ALL:
        return {layout: (1.0, task)}
    learning: Learning = task.learning
    every = {name: learning.layouts[name] for name in learning.evaluated[ALL]} | {**learning.beside}
    parts = {}
    for name, own in every.items():
        obstacles = (*task.obstacles, *own.get("obstacles", ()))
        # `task.success` is that of the task's own layout; each part has its layout's default.
        given = {"success": type(task).success, **own, "obstacles": obstacles}
        parts[name] = (1 / len(every), task.as_kind(type(task), **given))
    return parts
