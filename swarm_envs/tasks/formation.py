"""Formation: one shape after another, each drone with a place of its own.

Who goes where (`labels`):

- `nearest`: places are matched so that the squared ways sum to the least. Straight lines, flown
  at the same time by all, are free of collisions then (Turpin, Michael and Kumar 2014, for spacings
  above 2.83 radii); they are the reference.
- `random`: places are drawn, as in labelled planning. The way is the agent's business.
- `mirror`: each to the place nearest to its point reflection, as in the `rings` of RTH3D, Fig. 9.
- `blocks`: between `blocks` only; each block goes to another block's place, drawn, as in RTH3D.

Shapes change at fixed times, whether they were reached or not, so that the reference is a function
of time alone.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from types import MappingProxyType
from typing import Any, ClassVar, NamedTuple

import numpy as np
from numpy.random import Generator

from swarm_envs.errors import check_interval, check_name, check_number, check_type
from swarm_envs.state import FloatArray, IntArray
from swarm_envs.tasks.base import Given, Placement, Success, Task
from swarm_envs.tasks.learning import Learning
from swarm_envs.tasks.motion import LINES, REST, Motion
from swarm_envs.tasks.placing import WALL_MARGIN, derangement
from swarm_envs.tasks.shapes import LETTER, block_of, plane, shape_points
from swarm_envs.tasks.swap import REWARD_WEIGHTS

__all__ = ["FormationTask", "nearest_places"]

SHAPES = ("plane", "pyramid", "cube", "sphere", "plane")
"""What is flown unless other shapes are asked for."""


class Mission(NamedTuple):
    """The mission that is flown; by default the tour of all shapes."""

    shapes: tuple[str, ...] = SHAPES
    """Names of the shapes, in order; `letter:A` and the like write."""
    labels: str = "nearest"
    """The assignment to places: `nearest`, `random`, `mirror` or `blocks`."""
    shape_s: float = 6.0
    """Time for each shape, s."""


LAYOUTS: Mapping[str, Mission] = MappingProxyType(
    {
        "tour": Mission(),
        "cube": Mission(("plane", "cube"), shape_s=8.0),
        "shuffle": Mission(("plane", "cube"), "random", 8.0),
    }
)
"""Missions by name: the default; one change of shape, in which half of the drones end up below
others; the same where places are drawn, so that ways cross."""
LABELS = ("nearest", "random", "mirror", "blocks")  # Rules of who goes to which place
STARTS = ("shape", "ground")  # Where an episode begins: on the first shape, or on the ground
GROUND_HEIGHT = 0.15
"""Height at which drones start on the ground, m: just above it, since touching it is a crash."""
SPACING = 0.5  # Distance between places unless another is given, m
CLOSEST = 2.0 * math.sqrt(2.0)
"""Places are at least this many radii apart, so that straight ways to them do not meet."""
_RAMP = 0.5


@dataclass(frozen=True)
class FormationTask(Task):
    """Formation, version 1: drones fly one shape after another, each to a place of its own.

        from swarm_envs import formation_v1
        env = formation_v1.parallel_env(num_drones=10, letters="ARC")

    Agents, actions, observations, arena and frames are those of `swarm_envs.swap_v1`; the observed
    `task.goal` is the drone's place in the current shape.

    **Shapes.** `plane`, `pyramid`, `cube`, `sphere` and `plane` by default; `rings` and `blocks`
    are those of Fig. 9 of the RTH3D paper; `letter:A` etc. are letters. Shapes exist for any number
    of drones; places are 0.5 m apart, or less where the shape would not fit into the arena. All
    shapes are turned about the vertical by one random angle; letters are not.

    **Layouts.** `tour`: the default shapes. `cube`: one change, from a plane to a cube, within 8 s.
    `shuffle`: the same with `labels="random"`.

    **Labels.** `nearest` (the default): drones are assigned to places by the least sum of squared
    distances, and the reference is a straight line of 4 s to the place. `random`, `mirror`,
    `blocks`: see `swarm_envs.tasks.formation`; there is no reference.

    **Start.** On the first shape, or just above the ground (`start="ground"`), with a random
    assignment. `reset(options={"start": ...})` sets other starts. Goals cannot be set: use
    `shapes`.

    **Success.** A shape is reached when every drone stayed within 0.10 m of its place for 0.5 s
    before the next shape begins, every 6 s. Success: all shapes were reached, without a collision.

    **Rewards** (`parallel_env` lists terms and weights): as in swap; `success` is one over the
    number of shapes, for each shape reached.

    **End.** The episode is terminated by a collision, the floor, a wall, an obstacle, tumbling (150
    rad/s) or success. It is truncated after 6 s for each shape but the first.

    **Versions.** v1: first version.
    """

    layout: str | None = None
    """A mission by name, instead of shapes, letters, labels and shape_s: `tour`, `cube` or
    `shuffle`; see `LAYOUTS` of `swarm_envs.tasks.formation`."""
    shapes: Sequence[str] | None = None
    """Names of the shapes, in order; None: `tour`'s."""
    letters: str | None = None
    """A text such as `"ARC"` to write, letter by letter, instead of `shapes`."""
    labels: str | None = None
    """The assignment to places: `nearest`, `random`, `mirror` or `blocks`; None: the first."""
    start: str = "shape"
    """Where drones start: on the first `shape`, or on the `ground`."""
    spacing_m: float | None = None
    """Smallest distance between two places of a shape, m; None: 0.5, or less where shapes of so
    many drones would not fit the arena."""
    shape_s: float | None = None
    """Time for each shape, s; None: 6."""
    travel_s: float = 4.0
    """Time in which the reference gets there, s."""
    turn_rad: tuple[float, float] | None = None
    """Range of the turn of all shapes about the vertical, rad; None: anything, but letters are not
    turned."""
    success: Success = Success()
    """When the team has reached a shape."""

    name = "formation_v1"
    defaults: ClassVar[Mapping[str, Any]] = {"num_drones": 9}
    layouts = tuple(LAYOUTS)
    default_weights = REWARD_WEIGHTS
    goals_are = "those of shapes=(...)"
    learning = Learning(
        layouts={name: {"layout": name} for name in ("shuffle", "cube", "tour")},
        evaluated={"shuffle": ("shuffle", "cube", "tour")},
        reward_weights={"at_goal": 2.0},
        curriculum=lambda task, layout: FormationCurriculum(
            team=task.team, reward_weights=task.reward_weights, obstacles=task.obstacles
        ),
    )

    def __post_init__(self) -> None:
        """Refuse options that contradict each other, and shapes that do not fit the arena."""
        check_type("letters", self.letters, str | None)
        check_type("shapes", self.shapes, tuple | list | None)
        if self.layout is not None:
            check_name("layout", self.layout, LAYOUTS)
        shapes, labels, shape_s = self.mission
        check_name("labels", labels, LABELS)
        check_name("start", self.start, STARTS)
        if self.spacing_m is not None:
            check_number("spacing_m", self.spacing_m, above=0.0, unit="m")
        for name, value in (("shape_s", shape_s), ("travel_s", self.travel_s)):
            check_number(name, value, above=0.0, unit="s")
        check_interval("turn_rad", self.turn, unit="rad")
        check_type("success", self.success, Success)
        super().__post_init__()
        if self.travel_s > shape_s:
            raise ValueError(f"travel_s is {self.travel_s}, but must not exceed shape_s, {shape_s}")
        least = 2 if self.start == "shape" else 1
        if len(shapes) < least:
            raise ValueError(
                f"shapes are {shapes!r}, but must be at least {least} with start={self.start!r}"
            )
        if labels == "blocks" and {*shapes} != {"blocks"}:
            raise ValueError(f"labels='blocks' needs shapes=('blocks', ...), not {shapes!r}")
        self._check_fits()

    @cached_property
    def mission(self) -> Mission:
        """The mission that is flown: a layout, or what is given.

        Raises:
            ValueError: more than one of layout, shapes and letters says so.
        """
        shapes = None if self.shapes is None else tuple(self.shapes)
        if self.letters is not None:
            if not self.letters:
                raise ValueError("letters is '', but must have at least one, such as 'ARC'")
            if shapes is not None:
                raise ValueError(
                    f"letters={self.letters!r} says what is flown, but shapes are given too; give "
                    "either"
                )
            shapes = shapes_of(self.letters)
        mission = {"shapes": shapes, "labels": self.labels, "shape_s": self.shape_s}
        given: dict[str, Any] = {k: value for k, value in mission.items() if value is not None}
        if self.layout is not None and given:
            raise ValueError(
                f"layout={self.layout!r} already says what is flown, but {', '.join(given)} are "
                "given too; give either"
            )
        return LAYOUTS[self.layout or "tour"]._replace(**given)

    @property
    def turn(self) -> tuple[float, float]:
        """Range from which the turn of all shapes about the vertical is drawn, rad."""
        if self.turn_rad is not None:
            return self.turn_rad
        return (0.0, 2 * math.pi) if self.letters is None else (0.0, 0.0)

    @property
    def _spaced(self) -> tuple[str, ...]:
        """Names of all shapes for which there must be room."""
        return (*self.mission.shapes, *(["plane"] if self.start == "ground" else []))

    def _check_fits(self) -> None:
        wanted = SPACING if self.spacing_m is None else self.spacing_m
        name = min(self._spaced, key=self._room)
        largest, closest = self._room(name), CLOSEST * float(self.radius.max())
        if self.spacing < closest:
            raise ValueError(
                f"places are {self.spacing:.3f} m apart, but must be {closest:.3f} m apart, so "
                f"that drones do not meet between shapes; at most {largest:.2f} m fit shape "
                f"{name!r} of {len(self.team)} drones: use a larger spacing_m or fewer drones"
            )
        if self.spacing > largest:
            raise ValueError(
                f"shape {name!r} of {len(self.team)} drones {wanted} m apart does not fit the "
                f"arena; use spacing_m={largest:.2f} or less, or fewer drones"
            )

    def _room(self, name: str) -> float:
        """Largest spacing at which a shape fits the arena, m."""
        points = shape_points(name, len(self.team), 1.0)
        room = (self.arena[1] - self.arena[0]) / 2 - WALL_MARGIN
        reach = np.abs(points).max(axis=0)
        if self.turn[0] < self.turn[1]:
            reach[:2] = np.hypot(points[:, 0], points[:, 1]).max()
        return float((room / np.maximum(reach, 1e-9)).min())

    @cached_property
    def spacing(self) -> float:
        """Smallest distance between two places that is flown, m."""
        if self.spacing_m is not None:
            return self.spacing_m
        return min(SPACING, *(math.floor(100 * self._room(name)) / 100 for name in self._spaced))

    @property
    def num_stages(self) -> int:
        """Shapes to be flown to."""
        return len(self.mission.shapes) - (self.start == "shape")

    @property
    def motion(self) -> Motion:
        """Straight lines to the nearest places, else rest at the goals."""
        _, labels, shape_s = self.mission
        return Motion(LINES if labels == "nearest" else REST, _RAMP, float(shape_s))

    @property
    def episode_s(self) -> float:
        """A time for each shape, s."""
        return self.num_stages * self.mission.shape_s

    @cached_property
    def places(self) -> tuple[FloatArray, ...]:
        """Places (N, 3) of each shape, m, before the turn."""
        middle = (self.arena[0] + self.arena[1]) / 2
        n = len(self.team)
        return tuple(middle + shape_points(name, n, self.spacing) for name in self.mission.shapes)

    def draw(self, rng: Generator, start: Given = None, goal: Given = None) -> Placement:
        """Draw the turn of the shapes, who starts where, and who goes where."""
        n = len(self.team)
        turn, order = rng.uniform(*self.turn), rng.permutation(n)
        places = [_turned(points, turn) for points in self.places]
        if self.start == "ground":
            ground = plane(n, self.spacing) + np.array([0.0, 0.0, GROUND_HEIGHT])
            begin = _turned(ground, turn)[order]
        else:
            begin, places = places[0][order], places[1:]
        begin = begin if start is None else start
        goals, here, at = np.empty((len(places), n, 3)), begin, order
        for k, points in enumerate(places):
            at = self._match(rng, here, points, at)
            here = goals[k] = points[at]
        return Placement(begin, goals, self.travel_s if self.mission.labels == "nearest" else 0.0)

    def _match(
        self, rng: np.random.Generator, here: FloatArray, places: FloatArray, at: IntArray
    ) -> IntArray:
        """(N,) index of the place that each drone goes to; it is `here`, at place `at`."""
        labels = self.mission.labels
        if labels == "random":
            return rng.permutation(len(here))
        if labels == "mirror":
            return nearest_places(self.arena[0] + self.arena[1] - here, places)
        if labels == "blocks":
            owner = block_of(len(here))
            count = int(owner.max()) + 1
            middles = np.array([places[owner == k].mean(axis=0) for k in range(count)])
            to = derangement(rng, count) if count > 1 else np.zeros(1, dtype=np.int64)
            move = middles[to] - middles
            return nearest_places(here + move[owner[at]], places)
        return nearest_places(here, places)


def nearest_places(wanted: FloatArray, places: FloatArray) -> IntArray:
    """(N,) the place (N, 3) nearest to each point (N, 3), by the least sum of squared distances."""
    from scipy.optimize import linear_sum_assignment  # half a second, which only formations need

    square = np.square(wanted[:, None] - places[None]).sum(axis=-1)
    return np.asarray(linear_sum_assignment(square)[1], dtype=np.int64)


def _turned(points: FloatArray, angle: float) -> FloatArray:
    """Points (N, 3) turned about the vertical axis by an angle, rad."""
    c, s = math.cos(angle), math.sin(angle)
    return np.asarray(points @ np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]]))


def shapes_of(letters: str) -> tuple[str, ...]:
    """Names of the shapes that write letters, one after another.

    Raises:
        ValueError: a character is missing in the font.
    """
    return tuple(LETTER + character for character in letters.upper())


NEAREST_SHARE = 0.2
"""Share of the curriculum in which places are matched to drones, as with labels='nearest'."""
STRETCH = (0.8, 1.0)
"""Range from which the spacing of both shapes of the curriculum is drawn, over the task's own."""


@dataclass(frozen=True)
class FormationCurriculum(FormationTask):
    """One change of shape, from any of `shapes` to any, the same included; no reference.

    Any shape follows any other at several spacings, and places are mostly drawn rather than
    matched, so that straight ways cross; what also has to be learned is that a drone below others
    sinks.
    """

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
        stretch, angle = rng.uniform(*STRETCH), rng.uniform(*self.turn)
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
