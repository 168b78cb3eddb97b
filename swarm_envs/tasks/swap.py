"""Swap: drones exchange positions through each other's downwash."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from typing import Literal, get_args

import numpy as np
from numpy.random import Generator

from swarm_envs.errors import check_interval, check_name, check_number, check_type
from swarm_envs.state import FloatArray
from swarm_envs.tasks.base import Given, Placement, Success, Task
from swarm_envs.tasks.learning import Learning, Parts
from swarm_envs.tasks.motion import LINES, REST, Motion
from swarm_envs.tasks.placing import (
    OBSTACLE_MARGIN,
    WALL_MARGIN,
    derangement,
    draw_apart,
    drawing_box,
)

__all__ = ["CircleLayout", "Layout", "StackedLayout", "SwapTask"]

Layout = Literal["stacked", "circle", "random"]
"""The name of a layout."""
LAYOUTS: tuple[str, ...] = get_args(Layout)
"""The names of the layouts."""
_RAMP = 0.2  # Share of a stacked swap in which the speed grows, and in which it falls


@dataclass(frozen=True)
class StackedLayout:
    """Ranges of a stacked swap; equal ends fix a value.

    Drones start in horizontal planes on a cylinder, as in Neural-Swarm2 (Sec. VII-B, Fig. 8).
    """

    radius_m: tuple[float, float] = (0.5, 0.75)
    """Range of the radius of the cylinder, m."""
    gap_m: tuple[float, float] = (0.2, 0.3)
    """Range of the vertical distance between adjacent planes, m."""
    lowest_m: float = 0.8
    """Height of the lowest plane, m."""
    duration_s: tuple[float, float] = (3.0, 4.0)
    """Range of the time from one side to the other, s."""

    def __post_init__(self) -> None:
        """Raise ValueError for invalid values."""
        for name in ("radius_m", "gap_m"):
            check_interval(name, getattr(self, name), above=0.0, unit="m")
        check_number("lowest_m", self.lowest_m, above=0.0, unit="m")
        check_interval("duration_s", self.duration_s, above=0.0, unit="s")


@dataclass(frozen=True)
class CircleLayout:
    """Size of the circle layout, whose rotation about the vertical is random."""

    radius_m: float = 1.5
    """Radius of the circle, m; larger if neighbors would be closer than `spacing_m`."""
    spacing_m: float = 0.3
    """Smallest distance between neighbors on the circle, m."""
    height_m: float = 1.0
    """Height of starts and goals, m."""

    def __post_init__(self) -> None:
        """Raise ValueError for invalid values."""
        for name in ("radius_m", "spacing_m", "height_m"):
            check_number(name, getattr(self, name), above=0.0, unit="m")

    def radius_for(self, num_drones: int) -> float:
        """Return the radius for a number of drones, m."""
        if num_drones < 2:
            return self.radius_m
        return max(self.radius_m, self.spacing_m / (2.0 * math.sin(math.pi / num_drones)))


CIRCLE_SHARE, CROWDED_SHARE = 0.25, 0.5
"""Shares of episodes on a circle, and in a small cube; the others have the random layout."""
CROWDED_SIDE_M = (0.9, 1.6)
"""Range of the side of the cube for four drones, m; it grows with N^(1/3)."""
PAIRS_SHARE = 0.5  # Share of crowded episodes in which drones exchange positions in pairs


def hard_swaps(task: SwapTask, layout: str) -> SwapTask:
    """Return the task of training: in the layout `random`, a curriculum with hard starts.

    A custom subclass, which may have its own starts and rewards, is trained as it is.
    """
    if layout != "random" or type(task) is not SwapTask:
        return task
    return task.as_kind(SwapCurriculum)


def kinds_of_swaps(task: SwapTask, layout: str) -> Parts:
    """Return random swaps, crowded swaps and circles as parts, for different teachers."""
    if not isinstance(task, SwapCurriculum):
        return {layout: (1.0, task)}
    return {
        "random": (0.6, replace(task, circle_share=0.0, crowded_share=0.0)),
        "crowded": (0.25, replace(task, circle_share=0.0, crowded_share=1.0)),
        "circle": (0.15, replace(task, circle_share=1.0, crowded_share=0.0)),
    }


@dataclass(frozen=True)
class SwapTask(Task):
    """Swap, version 1: drones exchange positions through each other's downwash.

        from swarm_envs import swap_v1
        env = swap_v1.parallel_env(team="LS", layout="stacked", action="setpoint")

    | | |
    |---|---|
    | Agents | `drone_0` ... `drone_{N-1}`, in the team's order |
    | `acceleration` | 3 in [-1, 1]: a set-point's acceleration along x, y, z, times 5 m/s^2 |
    | `velocity` | 3 in [-1, 1]: a set-point's velocity along x, y, z, times 2 m/s |
    | `ctbr` | 4 in [-1, 1]: collective thrust, zero to maximum; body rates times 8, 8, 4 rad/s |
    | `rotors` | 4 in [-1, 1]: thrust of each rotor, from zero to maximum |
    | `setpoint` | 14, SI, world frame: position, velocity, acceleration, jerk, yaw, yaw rate |
    | Observations | float32 row; `env.observation_layout`: names, slices, units and scales |
    | Arena | 4 x 4 x 2.5 m, grown with (N / 16)^(1/3) above 16 drones |

    World frame: x and y are horizontal, z points up, in meters. In `acceleration` and `velocity`
    the drone tracks a set-point, whose acceleration follows the action with a lag of 0.1 s and
    whose speed is at most 2 m/s. Rotors: front right, back right, back left, front left; the first
    and the third turn counterclockwise. Yaw is in rad. An observed quantity is the number in the
    row times its field's scale.

    **Start.**

    - `random`: at least 0.5 m apart, 0.5-2.0 m high. Each drone's goal is the start of another
      drone.
    - `circle`: evenly spaced on a circle of radius 1.5 m (larger where neighbors would be less than
      0.3 m apart), 1.0 m high. Each goal is the opposite point.
    - `stacked`, the flight test of Neural-Swarm2 (Sec. VII-E): on a circle of radius 0.5-0.75 m, in
      planes 0.2-0.3 m apart, the lowest at 0.8 m, with the first drone of the team on top. The
      reference leads straight to the opposite side in 3-4 s, so that drones are above each other
      half way.

    **Success.** Every drone stays within 0.10 m of its goal for 0.5 s, without a collision.

    **Rewards** (`parallel_env` lists terms and weights): each drone gets the weighted sum of
    bounded terms, which `infos[agent]["reward_terms"]` contains; `reward_weights={"effort": -0.5}`
    changes a weight.

    **End.** The episode is terminated by a collision, the floor, a wall, an obstacle, tumbling (150
    rad/s) or success. It is truncated after 8 s.

    **Versions.** v1: first version.
    """

    layout: Layout = "random"
    """The layout of starts: `random`, `stacked` or `circle`."""
    stacked: StackedLayout = StackedLayout()
    """Ranges of the stacked layout."""
    circle: CircleLayout = CircleLayout()
    """Size of the circle layout."""
    spacing_m: float = 0.5
    """Smallest distance between starts in the random layout, m."""
    heights_m: tuple[float, float] = (0.5, 2.0)
    """Range of the height of starts in the random layout, m; its upper end grows with the arena."""
    success: Success = Success()
    """The criterion of success."""

    name = "swap_v1"
    layouts = LAYOUTS
    learning = Learning(
        layouts={name: {"layout": name} for name in ("random", "circle")},
        evaluated={"random": ("random", "circle")},
        reward_weights={"at_goal": 2.0},
        curriculum=hard_swaps,
        parts=kinds_of_swaps,
    )

    def __post_init__(self) -> None:
        """Raise ValueError for invalid values, and for layouts that do not fit the team."""
        check_name("layout", self.layout, LAYOUTS)
        check_type("stacked", self.stacked, StackedLayout)
        check_type("circle", self.circle, CircleLayout)
        check_number("spacing_m", self.spacing_m, above=0.0, unit="m")
        check_interval("heights_m", self.heights_m, above=0.0, unit="m")
        check_type("success", self.success, Success)
        if self.layout == "stacked":
            self._check_stack()
        if self.layout == "circle":
            self._check_circle()
        super().__post_init__()

    def _check_stack(self) -> None:
        ranges, ceiling = self.stacked, self.arena[1, 2] - max(v.radius for v in self.team)
        touching = max((a.radius + b.radius for a, b in pairwise(self.team)), default=0.0)
        if ranges.gap_m[0] <= touching:
            raise ValueError(
                f"StackedLayout.gap_m begins at {ranges.gap_m[0]} m, but these drones touch at "
                f"{touching:.3f} m, and would collide half way; use a larger gap_m"
            )
        top = ranges.lowest_m + ranges.gap_m[1] * (len(self.team) - 1)
        if top > ceiling:
            gap = (ceiling - ranges.lowest_m) / (len(self.team) - 1)
            raise ValueError(
                f"{len(self.team)} drones stacked from {ranges.lowest_m} m with gaps of up to "
                f"{ranges.gap_m[1]} m reach {top:.2f} m, but must stay below {ceiling:.2f} m; use "
                f"fewer drones, gaps up to {gap:.3f} m or a smaller lowest_m: StackedLayout, or "
                "--env \"stacked={'gap_m': (LOW, HIGH), 'lowest_m': LOWEST}\""
            )

    def _check_circle(self) -> None:
        n, needed = len(self.team), self.circle.radius_for(len(self.team))
        most = float(self.arena[1, 0]) - WALL_MARGIN
        if needed > most:
            raise ValueError(
                f"{n} drones {self.circle.spacing_m} m apart need a circle of {needed:.2f} m, but "
                f"the arena has room for {most:.2f} m; use fewer drones or a "
                "smaller spacing_m: CircleLayout, or --env \"circle={'spacing_m': SPACING}\""
            )
        touching = 2.0 * float(self.radius.max())
        if n > 1 and self.circle.spacing_m <= touching:
            raise ValueError(
                f"CircleLayout.spacing_m is {self.circle.spacing_m} m, but these drones touch at "
                f"{touching:.3f} m; use a larger spacing_m"
            )

    @property
    def motion(self) -> Motion:
        """Straight lines at constant speed with smooth ramps in `stacked`; else rest at goals."""
        return Motion(LINES if self.layout == "stacked" else REST, _RAMP)

    def draw(self, rng: Generator, start: Given = None, goal: Given = None) -> Placement:
        """Sample an episode; a given start or goal is used as it is, and goals follow from starts.

        Raises:
            RuntimeError: no room for the drones was found in a bounded number of samples.
        """
        drawers = {
            "stacked": self._draw_stacked,
            "circle": self._draw_circle,
            "random": self._draw_random,
        }
        drawn = drawers[self.layout](rng, start)
        return drawn if goal is None else drawn._replace(goals=goal[None])

    def _draw_stacked(self, rng: np.random.Generator, start: FloatArray | None) -> Placement:
        n, ranges = len(self.team), self.stacked
        radius, gap = rng.uniform(*ranges.radius_m), rng.uniform(*ranges.gap_m)
        duration, turn = rng.uniform(*ranges.duration_s), rng.uniform(0.0, 2 * np.pi)
        if start is None:
            height: FloatArray = ranges.lowest_m + gap * np.arange(n - 1, -1, -1.0)
            start = _on_circle(n, radius, turn, height)
        return Placement(start, _opposite(start)[None], float(duration))

    def _draw_circle(self, rng: np.random.Generator, start: FloatArray | None) -> Placement:
        n, turn = len(self.team), rng.uniform(0.0, 2 * np.pi)
        if start is None:
            start = _on_circle(n, self.circle.radius_for(n), turn, self.circle.height_m)
        return Placement(start, _opposite(start)[None])

    def _draw_random(self, rng: np.random.Generator, start: FloatArray | None) -> Placement:
        n, (low, high, rows, margin) = len(self.team), self._box
        if n == 1:
            points = draw_apart(rng, low, high, 2, self.spacing_m, rows, margin)
            return Placement(points[:1] if start is None else start, points[None, 1:])
        if start is None:
            start = draw_apart(rng, low, high, n, self.spacing_m, rows, margin)
        return Placement(start, start[derangement(rng, n)][None])

    @cached_property
    def _box(self) -> tuple[FloatArray, FloatArray, FloatArray, float]:
        """The corners of the box of random starts, m; obstacles, and the distance from them, m."""
        rows, radius, arena = self._kept
        box = drawing_box(arena, *self.heights_m)
        return *box, rows, OBSTACLE_MARGIN + float(radius.max())


def _on_circle(n: int, radius: float, turn: float, height: FloatArray | float) -> FloatArray:
    """Return points (n, 3) evenly spaced on a circle about the z axis, the first at `turn`, rad."""
    angle = turn + 2 * np.pi * np.arange(n) / n
    points = np.empty((n, 3))
    points[:, 0], points[:, 1] = radius * np.cos(angle), radius * np.sin(angle)
    points[:, 2] = height
    return points


def _opposite(points: FloatArray) -> FloatArray:
    """Return the points (n, 3) opposite with respect to the z axis."""
    return points * np.array([-1.0, -1.0, 1.0])


@dataclass(frozen=True)
class SwapCurriculum(SwapTask):
    """Random swaps, of which some are on a circle and some are crowded.

    Nearly all failures of policies are collisions soon after the start, mostly of two drones that
    exchange positions. Starts in a small cube, half of them in pairs that exchange positions, make
    such situations frequent.
    """

    circle_share: float = CIRCLE_SHARE  # Share of episodes on a circle
    crowded_share: float = CROWDED_SHARE  # Share of episodes in a small cube

    @cached_property
    def _circle(self) -> SwapTask:
        return self.as_kind(SwapTask, layout="circle")

    def draw(self, rng: Generator, start: Given = None, goal: Given = None) -> Placement:
        """Sample an episode; with a given start or goal, it has the random layout.

        Raises:
            RuntimeError: no room for the drones was found in a bounded number of samples.
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


def _pairs(rng: np.random.Generator, n: int) -> np.ndarray[tuple[int], np.dtype[np.int64]]:
    """Return a random permutation (n,), n even, that exchanges elements in pairs."""
    order, shuffled = np.empty(n, dtype=np.int64), rng.permutation(n)
    order[shuffled[0::2]], order[shuffled[1::2]] = shuffled[1::2], shuffled[0::2]
    return order
