"""Formation: drones form one shape after another, each in its own slot.

Assignments of drones to slots (`labels`):

- `nearest`: the assignment with the least sum of squared distances. Synchronous motion on straight
  lines is then free of collisions (Turpin, Michael and Kumar 2014, for spacings above 2.83 radii);
  these lines are the reference.
- `random`: a random assignment, as in labeled planning. The agent plans the paths.
- `mirror`: the slots nearest to the drones' point reflections, as in `rings` of RTH3D, Fig. 9.
- `blocks`: between `blocks` only; each block goes to the slots of another, random block, as in
  RTH3D.

Shapes change at fixed times, even if they were not reached, so that the reference is a function of
time alone.
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

__all__ = ["FormationTask", "nearest_places"]

SHAPES = ("plane", "pyramid", "cube", "sphere", "plane")
"""The default shapes."""


class Mission(NamedTuple):
    """Shapes, assignment and time; by default those of the layout `tour`."""

    shapes: tuple[str, ...] = SHAPES
    """Names of the shapes, in order; those of letters are `letter:A` etc."""
    labels: str = "nearest"
    """The assignment to slots: `nearest`, `random`, `mirror` or `blocks`."""
    shape_s: float = 6.0
    """Time for each shape, s."""


LAYOUTS: Mapping[str, Mission] = MappingProxyType(
    {
        "tour": Mission(),
        "cube": Mission(("plane", "cube"), shape_s=8.0),
        "shuffle": Mission(("plane", "cube"), "random", 8.0),
    }
)
"""Missions by name: the default; one change of shape, after which half of the drones are below
others; the same with a random assignment, so that paths cross."""
LABELS = ("nearest", "random", "mirror", "blocks")  # Assignments of drones to slots
STARTS = ("shape", "ground")  # Starts of an episode: in the first shape, or above the ground
GROUND_HEIGHT = 0.15
"""Height of starts with `start="ground"`, m: just above the ground, where contact is a crash."""
SPACING = 0.5  # Default of the distance between slots, m
CLOSEST = 2.0 * math.sqrt(2.0)
"""Least distance between slots, in radii, at which straight paths are free of collisions."""
_RAMP = 0.5


@dataclass(frozen=True)
class FormationTask(Task):
    """Formation, version 1: drones form one shape after another, each in its own slot.

        from swarm_envs import formation_v1
        env = formation_v1.parallel_env(num_drones=10, letters="ARC")

    Agents, actions, observations, arena and frames are those of `swarm_envs.swap_v1`; the observed
    `task.goal` is the drone's slot in the current shape.

    **Shapes.** `plane`, `pyramid`, `cube`, `sphere` and `plane` by default; `rings` and `blocks`
    are those of Fig. 9 of the RTH3D paper; `letter:A` etc. are letters. Shapes exist for any number
    of drones; slots are 0.5 m apart, or less if the shape would not fit into the arena. All shapes
    are rotated about the vertical by one random angle, unless they are given as `letters`.

    **Layouts.** `tour`: the default shapes. `cube`: one change, from a plane to a cube, within 8 s.
    `shuffle`: the same with `labels="random"`.

    **Labels.** `nearest` (the default): drones are assigned to slots by the least sum of squared
    distances, and the reference is a straight line of 4 s to the slot. `random`, `mirror`,
    `blocks`: see `swarm_envs.tasks.formation`; there is no reference.

    **Start.** In the first shape, or just above the ground (`start="ground"`), with a random
    assignment. `reset(options={"start": ...})` sets other starts. Goals cannot be set: use
    `shapes`.

    **Success.** A shape is reached when every drone stayed within 0.10 m of its slot for 0.5 s
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
    """Names of the shapes, in order; None: those of `tour`."""
    letters: str | None = None
    """A text such as `"ARC"` to form letter by letter, instead of `shapes`."""
    labels: str | None = None
    """The assignment to slots: `nearest`, `random`, `mirror` or `blocks`; None: `nearest`."""
    start: str = "shape"
    """Starts: `shape`, in the first shape, or `ground`, just above the ground."""
    spacing_m: float | None = None
    """Smallest distance between two slots of a shape, m; None: 0.5, or less if shapes of this
    number of drones would not fit into the arena."""
    shape_s: float | None = None
    """Time for each shape, s; None: 6."""
    travel_s: float = 4.0
    """Time of the reference from one shape to the next, s."""
    turn_rad: tuple[float, float] | None = None
    """Range of the rotation of all shapes about the vertical, rad; None: any angle, or 0 with
    `letters`."""
    success: Success = Success()
    """The criterion of success for a shape."""

    name = "formation_v1"
    defaults: ClassVar[Mapping[str, Any]] = {"num_drones": 9}
    layouts = tuple(LAYOUTS)
    goals_are = "those of shapes=(...)"
    learning = Learning(
        layouts={name: {"layout": name} for name in ("shuffle", "cube", "tour")},
        evaluated={"shuffle": ("shuffle", "cube", "tour")},
        reward_weights={"at_goal": 2.0},
        curriculum=lambda task, layout: (
            task.as_kind(FormationCurriculum, layout=None) if type(task) is FormationTask else task
        ),
    )

    def __post_init__(self) -> None:
        """Raise ValueError for invalid values, contradictions, and shapes larger than the arena."""
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
                f"shapes are {shapes!r}, but with start={self.start!r} there must be at least "
                f"{least}; name more shapes"
            )
        if labels == "blocks" and {*shapes} != {"blocks"}:
            raise ValueError(
                f"shapes are {shapes!r}, but with labels='blocks' all must be 'blocks'; give "
                "shapes=('blocks', 'blocks')"
            )
        self._check_fits()

    @cached_property
    def mission(self) -> Mission:
        """The shapes, assignment and time, from the layout or the other options.

        Raises:
            ValueError: more than one of layout, shapes and letters is given.
        """
        shapes = None if self.shapes is None else tuple(self.shapes)
        if self.letters is not None:
            if not self.letters:
                raise ValueError("letters is '', but must have at least one, such as 'ARC'")
            if shapes is not None:
                raise ValueError(
                    f"letters={self.letters!r} and shapes are given, but each sets the shapes; "
                    "give one of them"
                )
            shapes = shapes_of(self.letters)
        mission = {"shapes": shapes, "labels": self.labels, "shape_s": self.shape_s}
        given: dict[str, Any] = {k: value for k, value in mission.items() if value is not None}
        if self.layout is not None and given:
            raise ValueError(
                f"layout={self.layout!r} and {', '.join(given)} are given, but a layout already "
                "sets them; leave one of them out"
            )
        return LAYOUTS[self.layout or "tour"]._replace(**given)

    @property
    def turn(self) -> tuple[float, float]:
        """The range of the rotation of all shapes about the vertical, rad."""
        if self.turn_rad is not None:
            return self.turn_rad
        return (0.0, 2 * math.pi) if self.letters is None else (0.0, 0.0)

    @property
    def _spaced(self) -> tuple[str, ...]:
        """The names of all shapes that must fit into the arena."""
        return (*self.mission.shapes, *(["plane"] if self.start == "ground" else []))

    def _check_fits(self) -> None:
        name = min(self._spaced, key=self._room)
        largest, closest = self._room(name), CLOSEST * float(self.radius.max())
        if self.spacing < closest:
            raise ValueError(
                f"slots are {self.spacing:.3f} m apart, but must be at least {closest:.3f} m apart "
                f"to avoid collisions between shapes; at most {largest:.2f} m fit shape {name!r} "
                f"of {len(self.team)} drones: use a larger spacing_m or fewer drones"
            )
        if self.spacing > largest:
            raise ValueError(
                f"shape {name!r} of {len(self.team)} drones {self.spacing} m apart does not fit "
                f"the arena; use spacing_m={largest:.2f} or less, or fewer drones"
            )

    def _room(self, name: str) -> float:
        """Return the largest spacing at which a shape fits the arena, m."""
        points = shape_points(name, len(self.team), 1.0)
        room = (self.arena[1] - self.arena[0]) / 2 - WALL_MARGIN
        reach = np.abs(points).max(axis=0)
        if self.turn[0] < self.turn[1]:
            reach[:2] = np.hypot(points[:, 0], points[:, 1]).max()
        return float((room / np.maximum(reach, 1e-9)).min())

    @cached_property
    def spacing(self) -> float:
        """The smallest distance between two slots, m."""
        if self.spacing_m is not None:
            return self.spacing_m
        return min(SPACING, *(math.floor(100 * self._room(name)) / 100 for name in self._spaced))

    @property
    def num_stages(self) -> int:
        """The number of shapes, without one at the start."""
        return len(self.mission.shapes) - (self.start == "shape")

    @property
    def motion(self) -> Motion:
        """Straight lines with `labels="nearest"`, else rest at the goals."""
        _, labels, shape_s = self.mission
        return Motion(LINES if labels == "nearest" else REST, _RAMP, float(shape_s))

    @property
    def episode_s(self) -> float:
        """The time of all shapes, s."""
        return self.num_stages * self.mission.shape_s

    @cached_property
    def places(self) -> tuple[FloatArray, ...]:
        """The slots (N, 3) of each shape before the rotation, m."""
        middle = (self.arena[0] + self.arena[1]) / 2
        n = len(self.team)
        return tuple(middle + shape_points(name, n, self.spacing) for name in self.mission.shapes)

    def draw(self, rng: Generator, start: Given = None, goal: Given = None) -> Placement:
        """Sample the rotation of the shapes, the starts and the assignments."""
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
        """Return the slot (N,) of each drone; drones are at positions `here`, in slots `at`."""
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


def nearest_places(points: FloatArray, places: FloatArray) -> IntArray:
    """Return indices (N,) that assign points (N, 3) to places by least sum of squared distances."""
    from scipy.optimize import linear_sum_assignment  # takes half a second; only formations need it

    square = np.square(points[:, None] - places[None]).sum(axis=-1)
    return np.asarray(linear_sum_assignment(square)[1], dtype=np.int64)


def _turned(points: FloatArray, angle: float) -> FloatArray:
    """Return points (N, 3) rotated about the vertical axis by an angle, rad."""
    c, s = math.cos(angle), math.sin(angle)
    return np.asarray(points @ np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]]))


def shapes_of(letters: str) -> tuple[str, ...]:
    """Return the names of the shapes of letters."""
    return tuple(LETTER + character for character in letters.upper())


NEAREST_SHARE = 0.2
"""Share of the curriculum's episodes with the assignment of `labels="nearest"`."""
STRETCH = (0.8, 1.0)
"""Range of the spacing of both shapes in the curriculum, over the task's."""


@dataclass(frozen=True)
class FormationCurriculum(FormationTask):
    """One change between two random shapes, which may be equal; without a reference.

    Spacings vary, and most assignments are random, so that straight paths cross. A policy also has
    to learn that a drone below others is pushed down.
    """

    @property
    def num_stages(self) -> int:
        """One, since training episodes are short."""
        return 1

    @property
    def motion(self) -> Motion:
        """Rest at the slots."""
        return Motion(REST)

    def draw(self, rng: Generator, start: Given = None, goal: Given = None) -> Placement:
        """Sample two shapes, their rotation and spacing, the starts and the assignment."""
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
