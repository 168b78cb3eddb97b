"""What is particular to learning each task: its curriculum, its measures, and defaults.

A recipe is data and a few small functions. What trains, evaluates and writes takes it as it comes,
and asks no task by its name.

Curricula are flown in place of a task's own episodes: starts and goals that are harder. Nearly all
failures of a policy that swaps are collisions soon after the start, mostly with a drone that heads
for the other's place. Starts drawn in a small cube, half of them as pairs that change places, have
many of these. Of formations, any shape follows any other at several spacings, and places are mostly
drawn rather than matched, so that straight ways cross; what also has to be learned is that a drone
below others sinks.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from itertools import product
from types import MappingProxyType
from typing import Any

import numpy as np

from swarm_envs import task_family
from swarm_envs.agents.policy import Policy, PolicyAgent
from swarm_envs.agents.protocol import AT_ONCE, fly_batch
from swarm_envs.agents.registry import controller_of
from swarm_envs.envs.core import SwarmCore
from swarm_envs.envs.options import batch_of
from swarm_envs.errors import check_name
from swarm_envs.state import FloatArray
from swarm_envs.tasks.base import Placement, Task
from swarm_envs.tasks.columns import COLUMN_LAYOUTS
from swarm_envs.tasks.crowd import CROWD_LAYOUTS
from swarm_envs.tasks.formation import FormationTask, nearest_places
from swarm_envs.tasks.motion import REST, Motion
from swarm_envs.tasks.obstacles import Column
from swarm_envs.tasks.placing import WALL_MARGIN, derangement, draw_apart
from swarm_envs.tasks.pursuit import PURSUIT_LAYOUTS
from swarm_envs.tasks.ring import REWARD_WEIGHTS as RING_REWARDS
from swarm_envs.tasks.swap import REWARD_WEIGHTS, SwapTask
from swarm_envs.training.rl.rl_config import RlConfig

__all__ = ["choosing_seeds", "evaluate_policy", "recipe_of", "with_recipe"]

CIRCLE_SHARE, CROWDED_SHARE = 0.25, 0.5
"""Shares of episodes on a circle, and in a small cube; the rest are those of the random layout."""
CROWDED_SIDE_M = (0.9, 1.6)
"""Side of the cube for four drones, m, from which it is drawn; it grows with N^(1/3)."""
PAIRS_SHARE = 0.5  # Share of crowded episodes in which drones change places in pairs
NEAREST_SHARE = 0.2
"""Share of formations in which places are matched to drones, as with labels='nearest'."""
STRETCH = (0.8, 1.0)  # Range from which the spacing of both shapes is drawn, over the task's own


@dataclass(frozen=True)
class SwapCurriculum(SwapTask):
    """A random swap whose episodes are at times on a circle, and at times crowded."""

    circle_share: float = CIRCLE_SHARE  # Of the episodes on a circle
    crowded_share: float = CROWDED_SHARE  # Of the episodes in a small cube

    @cached_property
    def _circle(self) -> SwapTask:
        options = {field.name: getattr(self, field.name) for field in fields(SwapTask)}
        return SwapTask(**{**options, "layout": "circle"})

    def draw(
        self,
        rng: np.random.Generator,
        start: FloatArray | None = None,
        goal: FloatArray | None = None,
    ) -> Placement:
        """Draw an episode; a start or goal that is given makes it one of the random layout.

        Raises:
            RuntimeError: no room for the drones was found within a bounded number of draws.
        """
        kind = rng.random()
        if start is not None or goal is not None or len(self.team) < 2:
            return super().draw(rng, start, goal)
        if kind < self.circle_share:
            return self._circle.draw(rng)
        if kind < self.circle_share + self.crowded_share:
            return self._draw_crowded(rng)
        return super().draw(rng)

    def _draw_crowded(self, rng: np.random.Generator) -> Placement:
        n, (_, _, arena) = len(self.team), self._kept
        side = rng.uniform(*CROWDED_SIDE_M) * (n / 4.0) ** (1.0 / 3.0)
        low, high = arena[0] + WALL_MARGIN, arena[1] - WALL_MARGIN
        size = np.minimum(side, high - low)
        corner = low + (high - low - size) * rng.random(3)
        start = draw_apart(rng, corner, corner + size, n, 0.35)
        paired = rng.random() < PAIRS_SHARE and n % 2 == 0
        order = _pairs(rng, n) if paired else derangement(rng, n)
        return Placement(start, start[order][None])


def swap_curriculum(task: Task, config: RlConfig) -> Task:
    """The task in which a swap is learned: in the layout `random`, with hard starts."""
    if config.layout == "random":
        return SwapCurriculum(
            team=task.team, reward_weights=task.reward_weights, obstacles=task.obstacles
        )
    return task


def swap_parts(task: Task, config: RlConfig) -> dict[str, tuple[float, Task]]:
    """Random swaps, crowded ones and circles apart: a teacher may be for one of them alone."""
    if not isinstance(task, SwapCurriculum):
        return _whole(task, config)
    shares = {
        "random": (0.6, (0.0, 0.0)),
        "crowded": (0.25, (0.0, 1.0)),
        "circle": (0.15, (1.0, 0.0)),
    }
    return {
        name: (share, replace(task, circle_share=circle, crowded_share=crowded))
        for name, (share, (circle, crowded)) in shares.items()
    }


def _whole(task: Task, config: RlConfig) -> dict[str, tuple[float, Task]]:
    return {str(config.layout): (1.0, task)}


ALL = "all"  # Name of all layouts of a task together


def layout_parts(task: Task, config: RlConfig) -> dict[str, tuple[float, Task]]:
    """The layout of a run, or each of `ALL` and what is trained beside them."""
    if config.layout != ALL:
        return _whole(task, config)
    recipe = recipe_of(task.name)
    flown = {name: recipe.layouts[name] for name in recipe.evaluated[ALL]} | dict(recipe.beside)
    changed: Any = task  # a dataclass, as every task is
    parts = {}
    for name, own in flown.items():
        stand = (*task.obstacles, *own.get("obstacles", ()))
        # The success of `task` is that of its own layout: each part has the default for its layout.
        given = {"success": type(changed).success, **own, "obstacles": stand}
        parts[name] = (1 / len(flown), replace(changed, **given))
    return parts


def _pairs(rng: np.random.Generator, n: int) -> np.ndarray[tuple[int], np.dtype[np.int64]]:
    """A permutation (n,), n even, in which each changes places with one other."""
    order, shuffled = np.empty(n, dtype=np.int64), rng.permutation(n)
    order[shuffled[0::2]], order[shuffled[1::2]] = shuffled[1::2], shuffled[0::2]
    return order


@dataclass(frozen=True)
class FormationCurriculum(FormationTask):
    """One change of shape, from any of `shapes` to any, the same included; no reference."""

    @property
    def num_stages(self) -> int:
        """One: training episodes are short."""
        return 1

    @property
    def motion(self) -> Motion:
        """Rest at the places."""
        return Motion(REST)

    def draw(
        self,
        rng: np.random.Generator,
        start: FloatArray | None = None,
        goal: FloatArray | None = None,
    ) -> Placement:
        """Draw two shapes, their turn and spacing, who starts where and who goes where."""
        count, n = len(self.places), len(self.team)
        stretch, angle = rng.uniform(*STRETCH), rng.uniform(*self.turn_rad)
        middle = (self.arena[0] + self.arena[1]) / 2
        c, s = np.cos(angle), np.sin(angle)
        turn = stretch * np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
        before, after = (
            middle + (self.places[k] - middle) @ turn for k in rng.integers(count, size=2)
        )
        matched = rng.random() < NEAREST_SHARE
        here = before[rng.permutation(n)] if start is None else start
        order = nearest_places(here, after) if matched else rng.permutation(n)
        return Placement(here, after[order][None] if goal is None else goal[None])


def formation_curriculum(task: Task, config: RlConfig) -> Task:
    """The task in which formations are learned."""
    return FormationCurriculum(
        team=task.team, reward_weights=task.reward_weights, obstacles=task.obstacles
    )


_REACH = {"horizon_s": 3.5}
"""Defaults where places are to be found: failures come early, and the time-out is bootstrapped."""
_WHOLE_CLOCK: Mapping[str, float] = MappingProxyType({**REWARD_WEIGHTS, "at_goal": 2.0})
Metrics = Mapping[str, Any]  # `episode_metrics` of one episode
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


LATE_S = 10.0  # Time with which an episode counts that did not succeed, s


def late(metrics: Metrics) -> float:
    """Time in which the team did its task, s; `LATE_S` if it did not."""
    return float(metrics["time_to_goal_s"]) if metrics["success"] else LATE_S


def _metric(name: str) -> Callable[[Metrics], float]:
    return lambda metrics: float(metrics[name])


@dataclass(frozen=True)
class Recipe:
    """How one task is learned."""

    layouts: Mapping[str, Mapping[str, Any]]
    """what `--layout` may name: options of the task's environment"""
    defaults: Mapping[str, Any]
    """of those options of `RlConfig` that are None unless they are given"""
    evaluated: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    """layouts on which the policy of a layout is evaluated; itself alone where nothing is said"""
    has_obstacles: bool = False  # of its own, in some layout
    beside: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    """what is trained beside all layouts, but never evaluated: options of the task by name"""
    reward_weights: Mapping[str, float] = field(default_factory=lambda: _WHOLE_CLOCK)
    """of the reward in training; those of proximity and of a crash come from the options, and
    those of `at_goal` and `tracking` are for a whole clock, in every version"""
    curriculum: Callable[[Task, RlConfig], Task] = lambda task, _: task
    """the task that is flown in training, made from the layout's"""
    parts: Callable[[Task, RlConfig], Mapping[str, tuple[float, Task]]] = _whole
    """that task as parts by name, for which `--algo dagger` may have teachers of their own: the
    share of the environments, and what is flown there"""
    measures: Mapping[str, Callable[[Metrics], float]] = field(
        default_factory=lambda: {"success": success, "collision": collision}
    )
    """what an episode of an evaluation is measured by; averaged over episodes"""
    cost: Mapping[str, float] = field(default_factory=dict)
    """what is taken off a layout's success for each measure, times this, to say how good it is"""

    def evaluation_layouts(self, layout: str) -> tuple[str, ...]:
        """Layouts on which a policy trained on `layout` is evaluated."""
        return self.evaluated.get(layout, (layout,))

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


def _of_air(*layouts: str, more: Mapping[str, Any] = MappingProxyType({}), **given: Any) -> Recipe:
    """Of a task in which loads and forces count; the name of the only layout is no option.

    `more` are further options of layouts, by name.
    """
    names: Mapping[str, Any] = {name: {"layout": name, **more.get(name, {})} for name in layouts}
    return Recipe(
        layouts=names if len(layouts) > 1 else {layouts[0]: {}},
        defaults={**_REACH, "layout": layouts[0], "horizon_s": None, "observe_load": True},
        **given,
    )


def _of_scores(
    layouts: Sequence[str],
    score: str,
    full: float,
    more: Mapping[str, Any] = MappingProxyType({}),
    **given: Any,
) -> Recipe:
    """Of tasks that give goal after goal; `more` are further options of layouts, by name."""
    names = {name: {"layout": name, **more.get(name, {})} for name in layouts}
    return Recipe(
        layouts={ALL: names[layouts[0]], **names},
        defaults={**_REACH, "layout": ALL, "horizon_s": None},
        evaluated={ALL: tuple(layouts)},
        reward_weights={},
        parts=layout_parts,
        measures={"success": success, "collision": collision, score: _metric(score)},
        cost={score: -1.0 / full},
        **given,
    )


_TIMED: Mapping[str, Any] = {
    "measures": {"success": success, "collision": collision, "late_s": late},
    "cost": {"late_s": 0.1},
}
_STACKS: Mapping[str, Any] = {"stack": {"gap_m": (0.28, 0.42), "payload_kg": (0.008, 0.016)}}
"""What the layout is learned in: the default's and the benchmark's gaps and payloads."""
_CROWDS: Mapping[str, Any] = {"buildings": {"reach_m": (0.8, 2.2)}}
"""Ways between towers are as short as the benchmark's, and as the default's shorter ones."""
_COLUMNS = (Column((1.0, 1.0), 0.15), Column((-0.7, -0.4), 0.15))
_FEW_COLUMNS: Mapping[str, Any] = {
    "column": {"layout": "open", "obstacles": _COLUMNS[:1]},
    "columns": {"layout": "open", "obstacles": _COLUMNS},
}
"""Crowds in which places for obstacles in a row stay empty, and obstacles are far away: a policy
that had never seen them hovered 0.4 m off its goals."""
_GATES: Mapping[str, Any] = {
    "has_obstacles": True,
    "reward_weights": {},
    "measures": {
        "success": success,
        "collision": collision,
        "gates_per_min": _metric("gates_per_min"),
    },
    "cost": {"gates_per_min": -1 / 80.0},
}

RECIPES: Mapping[str, Recipe] = MappingProxyType(
    {
        "swap": Recipe(
            layouts={name: {"layout": name} for name in ("random", "circle")},
            defaults={"layout": "random", **_REACH},
            evaluated={"random": ("random", "circle")},
            curriculum=swap_curriculum,
            parts=swap_parts,
        ),
        "formation": Recipe(
            layouts={name: {"layout": name} for name in ("shuffle", "cube", "tour")},
            defaults={"layout": "shuffle", **_REACH},
            evaluated={"shuffle": ("shuffle", "cube", "tour")},
            curriculum=formation_curriculum,
        ),
        "ring": Recipe(
            layouts={"rings": {}},
            defaults={
                "layout": "rings",
                "horizon_s": 5.0,
            },
            reward_weights={**RING_REWARDS, "progress": 1.0, "at_goal": 3.0, "tracking": 6.0},
            measures={
                "success": success,
                "collision": collision,
                "worst_height_error_m": worst_height_error,
            },
            cost={"worst_height_error_m": 1.0 / LOST_M},
        ),
        "columns": _of_air(*COLUMN_LAYOUTS, more=_STACKS, **_TIMED),
        "delivery": _of_air("docks", **_TIMED),
        "gates": _of_air("slalom", **_GATES),
        "pursuit": _of_scores(PURSUIT_LAYOUTS, "share_on_goal", 1.0),
        "crowd": _of_scores(
            CROWD_LAYOUTS,
            "throughput_per_min",
            40.0,
            _CROWDS,
            has_obstacles=True,
            beside=_FEW_COLUMNS,
        ),
    }
)
"""Every task that can be learned, by its name without the version."""


def recipe_of(task: str) -> Recipe:
    """The recipe of a task, whatever its version."""
    return RECIPES[task_family(task)]


def with_recipe(config: RlConfig, task: str) -> RlConfig:
    """The options of a run, with the defaults of its task's recipe for what was not given.

    Raises:
        ValueError: the task has no such layout, the algorithm learns one layout alone, or no agent
            has such a controller.
    """
    recipe = recipe_of(task)
    seen = 3 if recipe.has_obstacles or config.obstacles else 0  # As many as environments show
    of_task = {"num_obstacles": seen, **recipe.defaults}
    missing = [name for name in of_task if getattr(config, name) is None]
    whole = replace(config, **{name: of_task[name] for name in missing})
    check_name("--layout", whole.layout, recipe.layouts)
    if config.controller is not None:
        controller_of(config.controller)
    if whole.layout == ALL and not config.imitates:
        single = ", ".join(sorted(set(recipe.layouts) - {ALL}))
        raise ValueError(
            f"all layouts of {task} together are learned by --algo dagger alone; name one by "
            f"--layout: {single}"
        )
    return whole


CHOOSING = (0x63686F6F, 0x73696E67)
"""Entropy of the seeds on which policies are chosen: no `--seed` of `evaluate` draws the same."""


def choosing_seeds(count: int) -> list[int]:
    """Seeds of so many episodes, never trained on; fewer are the first of more."""
    return [int(word) for word in np.random.SeedSequence(CHOOSING).generate_state(count)]


def evaluate_policy(
    policy: Policy,
    task: str,
    layouts: Sequence[str],
    seeds: Sequence[int],
    options: Mapping[str, Any],
    teams: Sequence[Mapping[str, Any]] = (),
) -> dict[str, float]:
    """Averages of the recipe's measures on each layout, such as `random_success`.

    Args:
        policy: what is evaluated.
        task: versioned name.
        layouts: of the task.
        seeds: of the episodes, the same on each layout.
        options: of the environments, besides what the policy requires.
        teams: options of each team that flies; of several each has its own averages, such as
            `random_8_success` of eight drones. With none the other options give the team.
    """
    agent, recipe, found = PolicyAgent(policy), recipe_of(task), {}
    for team, layout in product(teams or ({},), layouts):
        given = {"threads": 1, **options, **team, **recipe.layouts[layout], **agent.requires}
        blueprint = batch_of(task, **given)
        core = SwarmCore(blueprint.task, blueprint.config, min(AT_ONCE, len(seeds)))
        metrics = fly_batch(core, agent.act_batch, seeds)
        core.close()
        short = "_".join(map(str, team.values()))
        flown = layout if len(teams) < 2 else f"{layout}_{short}"
        for name, measure in recipe.measures.items():
            found[f"{flown}_{name}"] = float(np.mean([measure(m) for m in metrics]))
    return found
