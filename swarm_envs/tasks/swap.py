"""Swap: drones change places, through each other's downwash.

Layouts:

- `stacked`: Neural-Swarm2's data collection and flight test (Sec. VII-B, Fig. 8). Drones stand in
  horizontal planes on a cylinder, the first of the team on top; each flies straight to the
  opposite side, and half way all are in one vertical line. The task gives the reference.
- `random`: starts anywhere in the box, each drone's goal is another's start. No reference: the
  way there is the agent's business.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from itertools import pairwise
from types import MappingProxyType

import numpy as np

from swarm_envs.compiled import kernel
from swarm_envs.errors import check_name
from swarm_envs.state import FloatArray
from swarm_envs.tasks.base import (
    ARENA_HEIGHT,
    SPEED_LIMIT,
    WALL_MARGIN,
    Mission,
    Placement,
    Situation,
    Success,
    Task,
    derangement,
    draw_apart,
)
from swarm_envs.tasks.rewards import bell, progress, proximity
from swarm_envs.trajectories import Reference, ramped_line, rest
from swarm_envs.vehicles import Team

_SHORTEST = 1e-3
"""Stands for the duration of an environment that was never reset, s."""

LAYOUTS = ("stacked", "random")

REWARD_WEIGHTS: Mapping[str, float] = MappingProxyType(
    {
        "progress": 1.0,
        "at_goal": 2.0,
        "tracking": 0.0,
        "effort": -0.1,
        "proximity": -4.0,
        "crash": -1.0,
        "success": 3.0,
    }
)
"""Default weight of each reward term; see `write_swap_terms`. A whole clock spent at the goal earns
less than success, so that lingering never pays."""


@kernel
def write_swap_terms(
    situation: Situation, decision_s: float, horizon_s: float, out: FloatArray
) -> None:
    """Write the bounded reward terms (T, E, N), in the order of `REWARD_WEIGHTS`.

    What goes on is counted by time, so that returns do not depend on the decision rate:
    `progress` (of the speed limit towards the goal), `effort` (mean square action) and `proximity`
    (to the nearest drone) are the decision's duration in seconds times a number in [-1, 1] or
    [0, 1]; `at_goal` and `tracking` are its share of the clock times a bell around goal and
    reference, so that their sum over an episode is at most 1. Two are events: `crash` on the step
    that ends badly for the drone, `success` on the step at which the team is done.

    Args:
        situation: arrays (E, N).
        decision_s: time between decisions, s.
        horizon_s: the clock, s.
        out: (T, E, N), written.
    """
    farthest, share = SPEED_LIMIT * decision_s, decision_s / horizon_s
    for e in range(out.shape[1]):
        for i in range(out.shape[2]):
            before, now = situation.last_distance[e, i], situation.distance[e, i]
            out[0, e, i] = decision_s * progress(before, now, farthest)
            out[1, e, i] = share * bell(now, 0.15)
            out[2, e, i] = share * bell(situation.tracking_error[e, i], 0.10)
            out[3, e, i] = decision_s * situation.effort[e, i]
            out[4, e, i] = decision_s * proximity(situation.clearance[e, i])
            out[5, e, i] = situation.crashed[e, i]
            out[6, e, i] = situation.succeeded[e]


@dataclass(frozen=True)
class StackedLayout:
    """Ranges from which a stacked swap is drawn; equal ends fix a value."""

    radius_m: tuple[float, float] = (0.5, 0.75)
    """Radius of the circle on which drones stand, seen from above, m."""
    gap_m: tuple[float, float] = (0.2, 0.3)
    """Vertical distance between neighbouring planes, m."""
    lowest_m: float = 0.8
    """Height of the lowest plane, m."""
    duration_s: tuple[float, float] = (3.0, 4.0)
    """Time from one side to the other, s."""

    def __post_init__(self) -> None:
        """Refuse ranges that are empty or not positive."""
        for name in ("radius_m", "gap_m", "duration_s"):
            ends = np.array(getattr(self, name), dtype=np.float64)
            if ends.shape != (2,) or not 0.0 < ends[0] <= ends[1] < np.inf:
                raise ValueError(
                    f"StackedLayout.{name} is {getattr(self, name)!r}, but must be (low, high) "
                    "with 0 < low <= high"
                )
        if not 0.0 < self.lowest_m < np.inf:
            raise ValueError(
                f"StackedLayout.lowest_m is {self.lowest_m}, but must be positive and finite"
            )


@dataclass(frozen=True)
class SwapTask(Task):
    """Swap places. See the module for the layouts."""

    team: Team
    """The drones; in `stacked` the uppermost first."""
    layout: str = "random"
    """`stacked` or `random`."""
    stacked: StackedLayout = StackedLayout()
    """What the stacked layout is drawn from."""
    spacing_m: float = 0.5
    """Smallest distance between starts in the random layout, m."""
    heights_m: tuple[float, float] = (0.5, 2.0)
    """Lowest and highest start in the random layout, m; the highest grows with the arena."""
    success: Success = Success()
    """When the team has swapped."""
    reward_weights: Mapping[str, float] = field(default_factory=lambda: dict(REWARD_WEIGHTS))
    """Weight of each reward term."""

    name = "swap_v0"
    reward_names = tuple(REWARD_WEIGHTS)
    write_reward_terms = staticmethod(write_swap_terms)

    def __post_init__(self) -> None:
        """Refuse an unknown layout, and weights of terms that do not exist."""
        check_name("layout", self.layout, LAYOUTS)
        if self.layout == "stacked":
            self._check_stack()
        for term, weight in self.reward_weights.items():
            check_name("reward term", term, REWARD_WEIGHTS)
            if not math.isfinite(weight):
                raise ValueError(f"the weight of {term!r} is {weight}, but must be finite")

    def _check_stack(self) -> None:
        ranges, ceiling = self.stacked, self.arena[1, 2] - max(v.radius for v in self.team)
        touching = max((a.radius + b.radius for a, b in pairwise(self.team)), default=0.0)
        if ranges.gap_m[0] <= touching:
            raise ValueError(
                f"StackedLayout.gap_m begins at {ranges.gap_m[0]} m, but these drones touch at "
                f"{touching:.3f} m, and would collide half way; use a larger gap"
            )
        top = ranges.lowest_m + ranges.gap_m[1] * (len(self.team) - 1)
        if top > ceiling:
            raise ValueError(
                f"{len(self.team)} drones stacked from {ranges.lowest_m} m with gaps of up to "
                f"{ranges.gap_m[1]} m reach {top:.2f} m, but must stay below "
                f"{ceiling:.2f} m; use fewer drones or stacked=StackedLayout(gap_m=...)"
            )

    def place(
        self,
        rng: np.random.Generator,
        start: FloatArray | None = None,
        goal: FloatArray | None = None,
    ) -> Placement:
        """Draw an episode; what is given is kept, and goals follow from a start that is given.

        Raises:
            RuntimeError: no room for the drones was found within a bounded number of draws.
        """
        if self.layout == "stacked":
            drawn = self._place_stacked(rng, start)
        else:
            drawn = self._place_random(rng, start)
        return drawn if goal is None else drawn._replace(goal=goal)

    def _place_stacked(self, rng: np.random.Generator, start: FloatArray | None) -> Placement:
        n, ranges = len(self.team), self.stacked
        radius, gap = rng.uniform(*ranges.radius_m), rng.uniform(*ranges.gap_m)
        duration, turn = rng.uniform(*ranges.duration_s), rng.uniform(0.0, 2 * np.pi)
        if start is None:
            angle = turn + 2 * np.pi * np.arange(n) / n
            height = ranges.lowest_m + gap * np.arange(n - 1, -1, -1)
            start = np.stack([radius * np.cos(angle), radius * np.sin(angle), height], axis=-1)
        return Placement(start, start * np.array([-1.0, -1.0, 1.0]), float(duration))

    def _place_random(self, rng: np.random.Generator, start: FloatArray | None) -> Placement:
        n = len(self.team)
        edge = self.arena[1, 0] - WALL_MARGIN
        ceiling = self.heights_m[1] * self.arena[1, 2] / ARENA_HEIGHT
        low, high = [-edge, -edge, self.heights_m[0]], [edge, edge, ceiling]
        if n == 1:
            points = draw_apart(rng, low, high, 2, self.spacing_m)
            return Placement(points[:1] if start is None else start, points[1:], 0.0)
        if start is None:
            start = draw_apart(rng, low, high, n, self.spacing_m)
        return Placement(start, start[derangement(rng, n)], 0.0)

    def reference(self, mission: Mission, time: FloatArray) -> Reference:
        """Where the drones should be at `time` (E,), s.

        In the stacked layout a straight line at constant speed with smooth ramps; otherwise the
        goals, at rest.
        """
        if self.layout == "stacked":
            duration = np.maximum(mission.duration, _SHORTEST)[:, None]
            return ramped_line(mission.start, mission.goal, duration, time[:, None])
        return rest(mission.goal)
