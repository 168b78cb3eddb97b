"""The training of a task: a `Learning` is the class attribute `learning` of every task.

It says what `swarm-envs train` flies in place of a task's own episodes, and what makes one policy
better than another. Training itself asks no task by its name.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from swarm_envs.tasks.base import Task

__all__ = ["ALL", "Learning", "in_time", "metric", "scored"]

Metrics = Mapping[str, Any]
"""`episode_metrics` of one episode."""
Measure = Callable[[Metrics], float]
"""A number by which an episode of an evaluation is measured; it is averaged over episodes."""
Parts = Mapping[str, tuple[float, Any]]
"""Tasks by name, each with its share of the environments."""

ALL = "all"
"""Name of all layouts of a task together."""
LATE_S = 10.0
"""Time with which an episode counts that did not succeed, s."""


def success(metrics: Metrics) -> float:
    """Return 1 if the team has done its task."""
    return float(metrics["success"])


def collision(metrics: Metrics) -> float:
    """Return 1 if drones collided."""
    return float(metrics["collided_drones"] > 0)


def late_s(metrics: Metrics) -> float:
    """Return the time in which the team did its task, s; `LATE_S` if it did not."""
    return float(metrics["time_to_goal_s"]) if metrics["success"] else LATE_S


def metric(name: str) -> Measure:
    """Return the measure that is one of the metrics."""
    return lambda metrics: float(metrics[name])


RATES: Mapping[str, Measure] = MappingProxyType({"success": success, "collision": collision})
"""The measures of every task."""


@dataclass(frozen=True, kw_only=True)
class Learning:
    """Layouts, curriculum, reward and measures with which a task is learned."""

    layouts: Mapping[str, Mapping[str, Any]]
    """Options of the environment by the names that `--layout` takes, the default first."""
    evaluated: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    """Layouts on which the policy of a layout is evaluated; itself alone where nothing is given."""
    beside: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    """Parts that are trained beside all layouts, but never evaluated: options of the task."""
    horizon_s: float | None = 3.5
    """Default time limit in training, s, after which the value is bootstrapped: failures come
    early. None for the task's."""
    observe_load: bool | None = None
    """True to observe loads by default; None for the task's default."""
    has_obstacles: bool = False
    """True if the task has obstacles of its own, in some layout."""
    reward_weights: Mapping[str, float] = field(default_factory=dict)
    """Weights of the reward in training that differ from the task's. Those of proximity and of a
    crash come from the options of training; `at_goal` and `tracking` are for a whole episode."""
    curriculum: Callable[[Any, str], Task] = lambda task, layout: task
    """The task that is flown in training, made from the task and the name of its layout."""
    parts: Callable[[Any, str], Parts] = lambda task, layout: {layout: (1.0, task)}
    """That task as parts, for which DAgger may have teachers of their own."""
    measures: Mapping[str, Measure] = field(default_factory=lambda: RATES)
    """The measures of an episode of an evaluation."""
    cost: Mapping[str, float] = field(default_factory=dict)
    """Factors: what one unit of a measure takes off the success of a layout in `quality`."""

    def evaluation_layouts(self, layout: str) -> tuple[str, ...]:
        """Return the layouts on which a policy that was trained on `layout` is evaluated."""
        return self.evaluated.get(layout, (layout,))

    def quality(self, measured: Mapping[str, float]) -> float:
        """Return how good a policy is: the larger, the better.

        Args:
            measured: averages of measures by what was flown, such as `random_success`.
        """
        end, total = "_success", 0.0
        names = [key.removesuffix(end) for key in measured if key.endswith(end)]
        for name in names:
            cost = sum(weight * measured[f"{name}_{k}"] for k, weight in self.cost.items())
            total += measured[name + end] - cost
        return total / len(names)


def in_time(layouts: Mapping[str, Mapping[str, Any]]) -> Learning:
    """Return how a task about downwash is learned in which a team must be done in time."""
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
    """Return how a task is learned that gives goal after goal, in all its layouts together.

    Args:
        layouts: names of its layouts.
        score: the metric that counts beside success.
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
    """Return the layout of a run, or each of `ALL` and what is trained beside them."""
    if layout != ALL:
        return {layout: (1.0, task)}
    learning: Learning = task.learning
    flown = {name: learning.layouts[name] for name in learning.evaluated[ALL]} | {**learning.beside}
    parts = {}
    for name, own in flown.items():
        stand = (*task.obstacles, *own.get("obstacles", ()))
        # The success of `task` is that of its own layout: each part has the default for its layout.
        given = {"success": type(task).success, **own, "obstacles": stand}
        parts[name] = (1 / len(flown), replace(task, **given))
    return parts
