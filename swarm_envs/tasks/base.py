"""The base class of tasks: starts, goals, references, rewards, success and time limit."""

from __future__ import annotations

import inspect
import re
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields
from difflib import get_close_matches
from functools import cached_property
from numbers import Integral, Real
from typing import Any, ClassVar, NamedTuple, Self, TypeVar

import numpy as np
from numpy.random import Generator

from swarm_envs.errors import (
    check_array,
    check_bool,
    check_integer,
    check_number,
    check_parameters,
    check_type,
)
from swarm_envs.state import BoolArray, FloatArray, IntArray
from swarm_envs.tables import SETTINGS_TYPE, Records, World, new_world
from swarm_envs.tasks.learning import Learning
from swarm_envs.tasks.motion import (
    ACCELERATION_LIMIT,
    OWN_GOALS,
    REST,
    SPEED_LIMIT,
    WRITERS,
    Motion,
    reference_of,
)
from swarm_envs.tasks.obstacles import Obstacle, obstacle_rows
from swarm_envs.tasks.placing import OBSTACLE_MARGIN, arena_of, check_free, check_points
from swarm_envs.tasks.rewards import (
    REWARD_NAMES,
    REWARD_WEIGHTS,
    check_reward_weights,
    write_terms,
)
from swarm_envs.trajectories import Reference
from swarm_envs.vehicles import Team, parse_team

__all__ = [
    "ACCELERATION_LIMIT",
    "NEAR_MISS",
    "SPEED_LIMIT",
    "ByScore",
    "Placement",
    "Success",
    "Task",
    "TrackingSuccess",
    "check_rules",
    "place",
]


class Orbit(NamedTuple):
    """The drones' ellipses: center + first cos(angle) + second sin(angle)."""

    center: FloatArray  # (N, 3) centers, m
    first: FloatArray  # (N, 3) half axes at angle 0, m
    second: FloatArray  # (N, 3) half axes at angle pi / 2, m
    rate: FloatArray  # (N,) angular rates, rad/s
    phase: FloatArray  # (N,) angles at time zero, rad

    def at(self, angle: FloatArray) -> FloatArray:
        """Return the points (N, 3), m, of the ellipses at angles (N,), rad."""
        c, s = np.cos(angle)[:, None], np.sin(angle)[:, None]
        return np.asarray(self.center + self.first * c + self.second * s)


class Placement(NamedTuple):
    """The starts and goals of one episode of one environment, as a task samples them.

    `start` (N, 3) and `goals` (S, N, 3), one set for each of S stages, are positions in m.
    `duration` is the time of the reference from one stage to the next, s, 0 if it rests at the
    goals; `orbit` has the ellipses of a reference that moves on ellipses; `team` the vehicles, if
    the task samples payloads; `chased` (N,) the drone that each drone chases, or -1; `key` the
    random numbers of goals that kernels sample, 64 bits.
    """

    start: FloatArray
    goals: FloatArray
    duration: float = 0.0
    orbit: Orbit | None = None
    team: Team | None = None
    chased: IntArray | None = None
    key: int = 0


def place(world: World, e: int, placement: Placement) -> None:
    """Write a new episode of environment `e` into the tables, at its first stage."""
    drones, goals = world.drones[e], placement.goals
    drones["start"], drones["goal"], world.goals[e] = placement.start, goals[0], goals
    world.environments["duration"][e] = placement.duration
    world.environments["goal_key"][e] = placement.key
    drones["chased"] = -1 if placement.chased is None else placement.chased
    if placement.orbit is not None:
        drones["orbit"] = np.stack(placement.orbit[:3], axis=1)
        drones["orbit_rate"], drones["orbit_phase"] = placement.orbit.rate, placement.orbit.phase


def world_of(placement: Placement) -> World:
    """Return the tables of a single environment at the start of an episode."""
    stages, drones, _ = placement.goals.shape
    world = new_world(1, drones, stages)
    place(world, 0, placement)
    world.drones["position"] = placement.start
    return world


NEAR_MISS = 1.5
"""A near miss is a distance below this factor times the sum of two drones' radii."""
_DRAWS = 200  # Largest number of samples of an episode until one is free of obstacles


@dataclass(frozen=True)
class Success:
    """Success of a stage: every drone stays near its goal for some time."""

    radius: float = 0.10
    """Largest distance of a drone from its goal, m."""
    hold_s: float = 0.5
    """Time for which all drones must stay there, s, checked at decisions."""
    named: bool = True
    """True if each drone must reach its own goal. If False, a drone that reaches the goal of
    another exchanges goals with it, unless one of them is at its own goal."""

    def __post_init__(self) -> None:
        """Raise ValueError for invalid values."""
        check_number("radius", self.radius, above=0.0, unit="m")
        check_number("hold_s", self.hold_s, at_least=0.0)
        check_bool("named", self.named)


@dataclass(frozen=True)
class TrackingSuccess:
    """Success at the time limit: no crash, and every drone always near its reference."""

    worst_error: float = 0.15
    """Bound on every drone's distance from its reference, m."""
    settle_s: float = 2.0
    """Time from which errors count, s."""

    def __post_init__(self) -> None:
        """Raise ValueError for invalid values."""
        check_number("worst_error", self.worst_error, above=0.0, unit="m")
        check_number("settle_s", self.settle_s, at_least=0.0)


@dataclass(frozen=True)
class ByScore:
    """Success at the time limit by a sufficient score without a crash."""

    radius: float
    """Largest distance of a drone from its goal, m."""
    least: float
    """Least score of a success, in the task's own unit."""

    def __post_init__(self) -> None:
        """Raise ValueError for invalid values."""
        check_number("radius", self.radius, above=0.0, unit="m")
        check_number("least", self.least, at_least=0.0)


Kind = TypeVar("Kind", bound="Task")
_SHIPPED = "swarm_envs.tasks."  # Modules of the package's tasks
_SIMILAR = 0.9  # Least similarity of a name to a member that is taken for a misspelling
_MEMBERS = (
    "advance",
    "default_team",
    "default_weights",
    "defaults",
    "draw",
    "episode_s",
    "goals_are",
    "learning",
    "motion",
    "num_stages",
    "reward_terms",
    "score_names",
    "success",
)
"""Members that custom tasks override."""
_PARAMETERS = {
    "advance": ("self", "world"),
    "draw": ("self", "rng", "start", "goal"),
    "reward_terms": ("self", "world"),
    "success": ("self", "world"),
}
_KINDS: Mapping[str, Any] = {"bool": (bool, np.bool_), "float": Real, "int": Integral, "str": str}
"""Types of options that are checked, by their annotations."""
OwnSuccess = Callable[[World], BoolArray]  # A method of a custom task
Given = FloatArray | None
"""Starts or goals (N, 3), m, of the reset's options; None to sample them."""


@dataclass(frozen=True)
class _TaskFields:
    """The fields of every task."""

    team: Team
    """The drones, in the order of the agents."""
    reward_weights: Mapping[str, float] = field(default_factory=dict, kw_only=True)
    """Weights of the reward terms; a term left out has weight 0. If empty, `default_weights`."""
    obstacles: tuple[Obstacle, ...] = field(default=(), kw_only=True)
    """Static obstacles, the same in every episode."""


def _check_members(task: type) -> None:
    """Raise an error if a method has almost the name of a member, or other parameters."""
    for name, value in vars(task).items():
        if name in _PARAMETERS and inspect.isfunction(value):
            check_parameters(f"{name} of {task.__name__}", value, *_PARAMETERS[name])
        if inspect.isroutine(value) or isinstance(value, property):
            _check_name(task, name)


def _check_name(task: type, name: str) -> None:
    """Raise TypeError if an attribute has almost the name of a member."""
    similar = get_close_matches(name, _MEMBERS, 1, _SIMILAR)
    if similar and name not in _MEMBERS and not name.startswith("_"):
        raise TypeError(
            f"{task.__name__} defines {name!r}, which is no member of a task; did you mean "
            f"{similar[0]!r}? A helper needs a less similar name, such as '_{name}'"
        )


def _check_options(task: Task) -> None:
    """Raise ValueError if an option has another type than its annotation, and is no default."""
    for each in fields(task):
        if not each.init or getattr(task, each.name) is each.default:
            continue
        kind = str(getattr(each.type, "__name__", each.type))
        value = getattr(task, each.name)
        wrong_bool = kind != "bool" and isinstance(value, bool | np.bool_)
        if kind in _KINDS and (wrong_bool or not isinstance(value, _KINDS[kind])):
            hint = f"""; --env "{each.name}='{value}'" gives one""" if kind == "str" else ""
            raise ValueError(f"{each.name} is {value!r:.80}, but must be of type {kind}{hint}")


def check_rules(task: Task) -> None:
    """Check the attributes of a custom task that are no options.

    Raises:
        TypeError: one has almost the name of a member.
        ValueError: one has a wrong type or value.
    """
    kind = type(task)
    for name in vars(kind).keys() - {each.name for each in fields(task)}:
        _check_name(kind, name)
    check_number("episode_s", task.episode_s, above=0.0, unit="s")
    check_integer("num_stages", task.num_stages, at_least=1)
    check_type("motion", task.motion, Motion)
    own_goals = task.advance is not None and not inspect.ismethod(task.advance)  # for a kernel
    if task.num_stages > 1 and not (
        task.motion.stage_s > 0.0 or own_goals or isinstance(task.success, ByScore)
    ):
        raise ValueError(
            f"num_stages of {task.name} is {task.num_stages}, but stages change by time, and its "
            "motion has none: give Motion(stage_s=...), or leave num_stages at 1 and let advance "
            "set later goals"
        )
    check_type("score_names", task.score_names, tuple)
    if not callable(task.success):
        check_type("success", task.success, Success | TrackingSuccess | ByScore)


class Task(_TaskFields, ABC):
    """A task of a team. It has no state: the state of episodes is in the `World`."""

    name: str
    """Versioned name, such as `swap_v1`; by default `line_v0` for a class `LineTask`. A subclass of
    a task of the package keeps its name."""
    success: Success | TrackingSuccess | ByScore | OwnSuccess = Success()
    """The criterion of success; or a method `success(world)`, which returns booleans (E,), True
    where an environment's team is done."""
    defaults: ClassVar[Mapping[str, Any]] = {}
    """Different defaults for options that every task has, such as `num_drones`."""
    layouts: tuple[str, ...] = ()
    """The values of the task's option `layout`, if it has one."""
    default_weights: Mapping[str, float] = REWARD_WEIGHTS
    """Default weights of the reward terms."""
    reward_names: tuple[str, ...] = REWARD_NAMES
    """Names of the T reward terms."""
    goals_are: str = ""
    """A description of the goals, for the error message, in a task in which they cannot be set."""
    learning: Learning | None = None
    """Layouts, curriculum and measures of training; None to train on the task as it is."""
    write_reward_terms: Callable[[Records, Records, Records, FloatArray], None] = staticmethod(
        write_terms
    )
    """A kernel that writes the terms (T, E, N). See `swarm_envs.tasks.rewards.write_terms`
    for its arguments, and docs/architecture.md for the fields that it can read."""
    score_names: tuple[str, ...] = ()
    """Names of the metrics `environments.score` and, if there are two, `.goals_reached`."""
    advance: Callable[..., None] | None = None
    """A method `advance(world)`, which sets new goals in `world.drones["goal"]`, (E, N, 3) m, and
    scores in `world.environments["score"]`, (E,); or a kernel that does so, with the arguments
    `(flown, drones, environments, goals, settings)`: a mask (E,) of the environments that made a
    decision; records (E, N) and (E,); goals (E, S, N, 3) of every stage or row, m; and one record
    (1,) of the rules."""
    reward_terms: Callable[[World], Mapping[str, FloatArray]] | None = None
    """A method `reward_terms(world)`, which returns reward terms (E, N) by name: the further terms
    of `default_weights`, and shared terms that it replaces."""

    def __init_subclass__(cls, **options: Any) -> None:
        """Set `name` and `reward_names` if they are not given.

        Raises:
            TypeError: a method has almost the name of a member.
            ValueError: a method has other parameters than those of the member.
        """
        super().__init_subclass__(**options)
        _check_members(cls)
        named = next((kind for kind in cls.__mro__ if "name" in vars(kind)), None)
        inherited = named is not cls and named is not None and issubclass(named, Task)
        if named is None or (inherited and not named.__module__.startswith(_SHIPPED)):
            words = re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "_", cls.__name__.removesuffix("Task"))
            cls.name = f"{words.lower()}_v0"
        if inspect.isfunction(cls.reward_terms):
            own = (name for name in cls.default_weights if name not in REWARD_NAMES)
            cls.reward_names = (*REWARD_NAMES, *own)

    def __post_init__(self) -> None:
        """Parse the team, complete the reward weights and check them."""
        if inspect.isfunction(getattr(type(self), "success", None)):
            vars(self).pop("success", None)  # a method overrides a base class's field
        object.__setattr__(self, "team", parse_team(self.team))
        _check_options(self)
        check_type("obstacles", self.obstacles, tuple | list)
        if not self.reward_weights:
            object.__setattr__(self, "reward_weights", dict(self.default_weights))
        check_reward_weights(self.reward_weights, self.reward_names)

    @classmethod
    def default_team(cls, options: Any) -> Team:
        """Return the default team: `options.num_drones` small drones.

        Raises:
            ValueError: the task has no team of this size.
        """
        return parse_team("S" * check_integer("num_drones", options.num_drones, at_least=1))

    def with_team(self, team: Team) -> Self:
        """Return this task with another team.

        Raises:
            ValueError: the task does not fit the team; the message gives the reason.
        """
        return self.as_kind(type(self), team=team)

    def as_kind(self, kind: type[Kind], **changes: Any) -> Kind:
        """Return a task of a base class or a subclass with the fields of this one.

        Args:
            kind: the class.
            **changes: fields that differ.
        """
        names = {f.name for f in fields(self)} & {f.name for f in fields(kind) if f.init}
        given = {**{name: getattr(self, name) for name in names}, **changes}
        if inspect.isfunction(kind.success):
            given.pop("success", None)  # the field of a base class, which the method overrides
        return kind(**given)

    @property
    def arena(self) -> FloatArray:
        """The corners (2, 3) of the arena, m."""
        return arena_of(len(self.team))

    @property
    def num_stages(self) -> int:
        """S, the number of stages: sets of goals, one after another."""
        return 1

    @property
    def rules(self) -> dict[str, Any]:
        """Further fields of `swarm_envs.tables.SETTINGS` for the task's kernels."""
        return {}

    @property
    def radius(self) -> FloatArray:
        """The radii (N,) of the collision spheres, m."""
        return np.array([vehicle.radius for vehicle in self.team])

    @property
    def obstacle_rows(self) -> FloatArray:
        """The obstacles as rows (M, 7) for the contact kernels."""
        return obstacle_rows(self.obstacles)

    @cached_property
    def _kept(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Obstacle rows, radii and arena, cached for placements."""
        return self.obstacle_rows, self.radius, self.arena

    @property
    def motion(self) -> Motion:
        """The motion of the reference; by default it rests at the goals."""
        return Motion(REST)

    @property
    def write_reference(self) -> Callable[[Records, Records, FloatArray, Records], None]:
        """The kernel that writes the references of all environments."""
        kind, stage_s = self.motion.kind, self.motion.stage_s
        follows = kind == REST and stage_s == 0.0 and inspect.ismethod(self.advance)
        return WRITERS[OWN_GOALS if follows else kind]

    @property
    def episode_s(self) -> float:
        """The default time limit, s."""
        return 8.0

    @abstractmethod
    def draw(self, rng: Generator, start: Given = None, goal: Given = None) -> Placement:
        """Sample an episode, ignoring obstacles; a given start or goal (N, 3) is used as it is.

        Raises:
            RuntimeError: no room for the drones was found in a bounded number of samples.
        """

    def place(self, rng: Generator, start: Given = None, goal: Given = None) -> Placement:
        """Sample an episode whose starts, goals and reference are free of obstacles.

        Args:
            rng: the environment's generator.
            start: (N, 3) given starts, m.
            goal: (N, 3) given goals, m.

        Raises:
            ValueError: a given point is outside the arena or in an obstacle, drones touch, or goals
                cannot be set in this task.
            RuntimeError: no placement was found in a bounded number of samples.
        """
        if goal is not None and self.goals_are:
            family = self.name.partition("_")[0]
            raise ValueError(
                f"a goal is given, but in {family} goals are {self.goals_are}; leave it out"
            )
        rows, radius, arena = self._kept
        for name, points in (("start", start), ("goal", goal)):
            if points is not None:
                check_points(name, points, radius, arena, rows)
        margin = OBSTACLE_MARGIN if start is None and goal is None else 0.0
        why = ""
        for _ in range(_DRAWS if len(rows) else 1):
            placement = self._checked(self.draw(rng, start, goal))
            check_points("start", placement.start, radius, arena)
            for goals in placement.goals:
                check_points("goal", goals, radius, arena)
            why = self._obstructed(placement, margin) if len(rows) else ""
            if not why:
                return placement
        raise RuntimeError(
            f"found no {self.name} free of the obstacles within {_DRAWS} draws; in the last one, "
            f"{why}; use fewer or smaller obstacles, or move them"
        )

    def _checked(self, placement: object) -> Placement:
        """Return what `draw` returned, with arrays.

        Raises:
            ValueError: it is no placement with the goals of all stages.
        """
        if not isinstance(placement, Placement):
            raise ValueError(
                f"draw of {self.name} returned a {type(placement).__name__}, but must return a "
                "Placement(start, goals) of swarm_envs.tasks.base"
            )
        shape, wanted = np.shape(placement.goals), (self.num_stages, len(self.team), 3)
        if shape != wanted:
            hint = "; write goals[None] for one stage" if len(shape) == 2 else ""
            raise ValueError(
                f"Placement.goals of {self.name} has shape {shape}, but must have shape {wanted}, "
                f"(num_stages, drones, 3){hint}"
            )
        start, goals = (np.asarray(points, np.float64) for points in placement[:2])
        return placement._replace(start=start, goals=goals)

    def _obstructed(self, placement: Placement, margin: float) -> str:
        """Return a message on a point too near an obstacle; empty if there is none."""
        rows = self.obstacle_rows
        parts = [("start", placement.start), *(("goal", goals) for goals in placement.goals)]
        if placement.duration or placement.orbit is not None:
            world, times = world_of(placement), np.arange(0.0, self.episode_s + 0.05, 0.05)
            path = [self.reference(world, np.array([t])).position[0] for t in times]
            parts.append(("reference", np.array(path)))
        for name, points in parts:
            why = check_free(name, points, self.radius, rows, margin)
            if why:
                return why
        return ""

    def reference(self, world: World, time: FloatArray) -> Reference:
        """Return the reference at `time` (E,), s, as new arrays (E, N, 3)."""
        copied = world.copy()
        copied.environments["time"] = check_array("time", time, world.environments.shape)
        settings = np.zeros(1, SETTINGS_TYPE)
        for name, value in self.motion.settings().items():
            settings[name] = value
        self.write_reference(*copied, settings)
        return reference_of(copied.drones)
