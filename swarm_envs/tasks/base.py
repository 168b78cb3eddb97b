"""What a task is: where drones start, where they belong, what is good, and when it is over."""

from __future__ import annotations

import inspect
import re
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, ClassVar, NamedTuple, Self

import numpy as np
from numpy.random import Generator

from swarm_envs.errors import check_array, check_bool, check_integer, check_number, check_type
from swarm_envs.state import BoolArray, FloatArray, IntArray
from swarm_envs.tables import SETTINGS_TYPE, Records, World, new_world
from swarm_envs.tasks.learning import Learning
from swarm_envs.tasks.motion import (
    ACCELERATION_LIMIT,
    REST,
    SPEED_LIMIT,
    WRITERS,
    Motion,
    reference_of,
)
from swarm_envs.tasks.obstacles import Obstacle, obstacle_rows
from swarm_envs.tasks.placing import OBSTACLE_MARGIN, arena_of, check_free, check_points
from swarm_envs.tasks.rewards import REWARD_NAMES, check_reward_weights, write_terms
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
    "place",
]


class Orbit(NamedTuple):
    """Ellipses on which drones circle: center + first cos(angle) + second sin(angle)."""

    center: FloatArray  # (N, 3) centres, m
    first: FloatArray  # (N, 3) half axes to which angle zero points, m
    second: FloatArray  # (N, 3) half axes to which a quarter turn points, m
    rate: FloatArray  # (N,) angular rates, rad/s
    phase: FloatArray  # (N,) angles at time zero, rad

    def at(self, angle: FloatArray) -> FloatArray:
        """Points (N, 3), m, of the ellipses at angles (N,), rad."""
        c, s = np.cos(angle)[:, None], np.sin(angle)[:, None]
        return np.asarray(self.center + self.first * c + self.second * s)


class Placement(NamedTuple):
    """One episode of one environment, as a task draws it."""

    start: FloatArray
    """(N, 3) start positions, m."""
    goals: FloatArray
    """(S, N, 3) goal positions of each stage, m."""
    duration: float = 0.0
    """Seconds that the reference takes from one stage to the next; 0 if it rests at the goals."""
    orbit: Orbit | None = None
    """What the reference circles on, if it does."""
    team: Team | None = None
    """The vehicles of this episode, where the task draws payloads; None for the task's."""
    chased: IntArray | None = None
    """(N,) index of the drone that each one chases; -1, and None for all, if it chases none."""
    key: int = 0
    """Stream of random numbers from which kernels draw goals to come: 64 bits."""


def place(world: World, e: int, placement: Placement) -> None:
    """Keep a new episode of environment `e` in the tables; its first stage begins."""
    drones, goals = world.drones[e], placement.goals
    drones["start"], drones["goal"], world.goals[e] = placement.start, goals[0], goals
    world.environments["duration"][e] = placement.duration
    world.environments["goal_key"][e] = placement.key
    drones["chased"] = -1 if placement.chased is None else placement.chased
    if placement.orbit is not None:
        drones["orbit"] = np.stack(placement.orbit[:3], axis=1)
        drones["orbit_rate"], drones["orbit_phase"] = placement.orbit.rate, placement.orbit.phase


def world_of(placement: Placement) -> World:
    """The tables of a single environment that begins with a placement."""
    stages, drones, _ = placement.goals.shape
    world = new_world(1, drones, stages)
    place(world, 0, placement)
    world.drones["position"] = placement.start
    return world


NEAR_MISS = 1.5
"""Drones that come closer than this times the sum of their radii had a near miss."""
_DRAWS = 200  # How often an episode is sampled again until it is free of obstacles


@dataclass(frozen=True)
class Success:
    """When a team has done a stage of its task: every drone near its goal, for a while."""

    radius: float = 0.10
    """How near a drone must be to its goal, m."""
    hold_s: float = 0.5
    """For how long all must stay there, s, as seen at decisions."""
    named: bool = True
    """Whether each drone has a goal of its own. If not, a drone that comes to another's goal
    exchanges goals with it, unless either stands at its own: any may take any."""

    def __post_init__(self) -> None:
        """Refuse values that an option cannot have."""
        check_number("radius", self.radius, above=0.0, unit="m")
        check_number("hold_s", self.hold_s, at_least=0.0)
        check_bool("named", self.named)


@dataclass(frozen=True)
class TrackingSuccess:
    """Success at the time limit: no crash, and never far from the reference."""

    worst_error: float = 0.15
    """Every drone must always have been nearer to its reference than this, m."""
    settle_s: float = 2.0
    """Errors count from this time on, s."""

    def __post_init__(self) -> None:
        """Refuse values that an option cannot have."""
        check_number("worst_error", self.worst_error, above=0.0, unit="m")
        check_number("settle_s", self.settle_s, at_least=0.0)


@dataclass(frozen=True)
class ByScore:
    """A task that continues until the time limit: success is a sufficient score without a crash."""

    radius: float
    """How near a drone must be to its goal, m."""
    least: float
    """The score, in the task's own unit, from which the episode is a success."""

    def __post_init__(self) -> None:
        """Refuse values that an option cannot have."""
        check_number("radius", self.radius, above=0.0, unit="m")
        check_number("least", self.least, at_least=0.0)


OwnSuccess = Callable[[World], BoolArray]  # A method of a task of one's own
Given = FloatArray | None
"""Starts or goals (N, 3), m, that a reset was given; None if they are drawn."""


@dataclass(frozen=True)
class _Flown:
    """Fields of every task."""

    team: Team
    """The drones, in the order of the agents."""
    reward_weights: Mapping[str, float] = field(default_factory=dict, kw_only=True)
    """Weight of each reward term; a term left out has none. If empty, `default_weights`."""
    obstacles: tuple[Obstacle, ...] = field(default=(), kw_only=True)
    """Static obstacles, the same in every episode."""


class Task(_Flown, ABC):
    """A task for a team. Stateless: what changes over an episode lives in the `World`."""

    name: str
    """Versioned name, such as `swap_v1`; by default that of the class, `line_v0` of `LineTask`."""
    success: Success | TrackingSuccess | ByScore | OwnSuccess = Success()
    """When the team has done a stage, or the task; or a method `success(world)`, which returns for
    each environment (E,) whether its team is done."""
    defaults: ClassVar[Mapping[str, Any]] = {}
    """Defaults of options that every task has, such as `num_drones`, where they differ."""
    layouts: tuple[str, ...] = ()
    """The names that the task's option `layout` can have, if it has one."""
    default_weights: Mapping[str, float] = {}
    """Weight of each reward term, unless others are given."""
    reward_names: tuple[str, ...] = REWARD_NAMES
    """Names of the T reward terms."""
    goals_are: str = ""
    """What goals are, in a task that takes none."""
    learning: Learning | None = None
    """Layouts, curriculum and measures of training; None to train on the task as it is."""
    write_reward_terms: Callable[[Records, Records, Records, FloatArray], None] = staticmethod(
        write_terms
    )
    """A kernel that writes the terms (T, E, N): see `swarm_envs.tasks.rewards.write_terms`
    for its arguments, and docs/architecture.md for the fields that it can read."""
    score_names: tuple[str, ...] = ()
    """The metrics that `environments.score` and, if there are two, `.goals_reached` are."""
    advance: Callable[..., None] | None = None
    """A method `advance(world)`, which sets new goals in `world.drones["goal"]`, (E, N, 3) m, and
    scores in `world.environments["score"]`, (E,); or a kernel that does so: `(flown, drones,
    environments, goals, settings)`. These are the environments (E,) that made a decision; records
    (E, N) and (E,); goals (E, S, N, 3) of every stage or row, m; and one record (1,) of the
    rules."""
    reward_terms: Callable[[World], Mapping[str, FloatArray]] | None = None
    """A method `reward_terms(world)`, which returns reward terms (E, N) by name: those that
    `default_weights` names besides the shared ones, and shared ones that it replaces."""

    def __init_subclass__(cls, **options: Any) -> None:
        """Name the task after its class, and its reward terms after their weights, if not given."""
        super().__init_subclass__(**options)
        if not hasattr(cls, "name"):
            words = re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "_", cls.__name__.removesuffix("Task"))
            cls.name = f"{words.lower()}_v0"
        if inspect.isfunction(cls.reward_terms):
            own = (name for name in cls.default_weights if name not in REWARD_NAMES)
            cls.reward_names = (*REWARD_NAMES, *own)

    def __post_init__(self) -> None:
        """Read the team; complete the weights of rewards, and refuse those of unknown terms."""
        if inspect.isfunction(getattr(type(self), "success", None)):
            vars(self).pop("success", None)  # a method takes the place of a base class's field
        object.__setattr__(self, "team", parse_team(self.team))
        check_type("obstacles", self.obstacles, tuple | list)
        if not self.reward_weights:
            object.__setattr__(self, "reward_weights", dict(self.default_weights))
        check_reward_weights(self.reward_weights, self.reward_names)

    @classmethod
    def default_team(cls, options: Any) -> Team:
        """Return the team that flies if none is given: `options.num_drones` small drones.

        Raises:
            ValueError: there is no team of so many.
        """
        return parse_team("S" * check_integer("num_drones", options.num_drones, at_least=1))

    def with_team(self, team: Team) -> Self:
        """The same task for another team.

        Raises:
            ValueError: the team cannot fly it; the message says why.
        """
        given: dict[str, Any] = {}
        if inspect.ismethod(self.success) and "success" in self.__dataclass_fields__:
            given["success"] = Success()  # of a base class, whose place the method takes
        same: Self = replace(self, team=team, **given)
        return same

    @property
    def arena(self) -> FloatArray:
        """Corners (2, 3) of the arena, m."""
        return arena_of(len(self.team))

    @property
    def num_stages(self) -> int:
        """S: how many sets of goals are flown to, one after another."""
        return 1

    @property
    def rules(self) -> dict[str, Any]:
        """Fields of `swarm_envs.tables.SETTINGS` that its kernels read besides the usual ones."""
        return {}

    @property
    def radius(self) -> FloatArray:
        """(N,) radii of the collision spheres, m."""
        return np.array([vehicle.radius for vehicle in self.team])

    @property
    def obstacle_rows(self) -> FloatArray:
        """(M, 7) the obstacles, for the compiled contact test."""
        return obstacle_rows(self.obstacles)

    @cached_property
    def _kept(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Obstacle rows, radii and arena, made once: what every placement asks for."""
        return self.obstacle_rows, self.radius, self.arena

    @property
    def motion(self) -> Motion:
        """The motion of the reference, by default rest at the goals."""
        return Motion(REST)

    @property
    def write_reference(self) -> Callable[[Records, Records, FloatArray, Records], None]:
        """The kernel that writes the reference of every environment at its time."""
        return WRITERS[self.motion.kind]

    @property
    def episode_s(self) -> float:
        """The time limit, unless an environment is given another, s."""
        return 8.0

    @abstractmethod
    def draw(self, rng: Generator, start: Given = None, goal: Given = None) -> Placement:
        """Draw an episode, obstacles apart; a start or goal (N, 3) that is given is kept.

        Raises:
            RuntimeError: no room for the drones was found within a bounded number of draws.
        """

    def place(self, rng: Generator, start: Given = None, goal: Given = None) -> Placement:
        """Draw an episode whose starts, goals and reference are free of obstacles.

        Args:
            rng: the environment's generator.
            start: (N, 3) given starts, m.
            goal: (N, 3) given goals, m.

        Raises:
            ValueError: what is given lies outside the arena, in an obstacle, or drones touch; or
                the task takes no goal.
            RuntimeError: no placement was found within a bounded number of draws.
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
            placement = self.draw(rng, start, goal)
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

    def _obstructed(self, placement: Placement, margin: float) -> str:
        """Say what of a placement meets an obstacle; empty if nothing does."""
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
        """Where the drones should be at `time` (E,), s: arrays (E, N, 3) of their own."""
        copied = world.copy()
        copied.environments["time"] = check_array("time", time, world.environments.shape)
        settings = np.zeros(1, SETTINGS_TYPE)
        for name, value in self.motion.settings().items():
            settings[name] = value
        self.write_reference(*copied, settings)
        return reference_of(copied.drones)
