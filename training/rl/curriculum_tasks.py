"""What training flies in place of a task's own episodes: starts and goals that are harder.

Nearly all failures of a policy that swaps are collisions soon after the start, mostly with a drone
that heads for the other's place. Starts drawn in a small cube, half of them as pairs that change
places, have many of these. Of formations, any shape follows any other at several spacings, and
places are mostly drawn rather than matched, so that straight ways cross; what also has to be
learned is that a drone below others sinks.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from functools import cached_property

import numpy as np

from swarm_envs.state import FloatArray
from swarm_envs.tasks.base import Task
from swarm_envs.tasks.formation import FormationTask, nearest_places
from swarm_envs.tasks.mission import Placement
from swarm_envs.tasks.motion import REST, Motion
from swarm_envs.tasks.placing import WALL_MARGIN, check_range, derangement, draw_apart
from swarm_envs.tasks.swap import SwapTask
from swarm_envs.training.rl.rl_config import RlConfig


@dataclass(frozen=True)
class SwapCurriculum(SwapTask):
    """A random swap whose episodes are at times on a circle, and at times crowded."""

    circle_share: float = 0.25
    """share of episodes on the circle"""
    crowded_share: float = 0.5
    """share of episodes in a small cube; the rest are those of the random layout"""
    crowded_side_m: tuple[float, float] = (0.9, 1.6)
    """side of the cube for four drones, m, from which it is drawn; it grows with N^(1/3)"""
    pairs_share: float = 0.5
    """share of crowded episodes in which drones change places in pairs"""

    def __post_init__(self) -> None:
        """Refuse shares outside [0, 1], and a layout that is not random."""
        super().__post_init__()
        check_range("SwapCurriculum.crowded_side_m", self.crowded_side_m, 2.0 * self.radius.max())
        for name in ("circle_share", "crowded_share", "pairs_share"):
            if not 0.0 <= getattr(self, name) <= 1.0:
                raise ValueError(f"SwapCurriculum.{name} is {getattr(self, name)}, not in [0, 1]")
        if self.layout != "random" or self.circle_share + self.crowded_share > 1.0:
            raise ValueError(
                "SwapCurriculum needs layout='random', and shares of circle and crowded episodes "
                f"that sum to at most 1, not {self.circle_share} and {self.crowded_share}"
            )

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
        side = rng.uniform(*self.crowded_side_m) * (n / 4.0) ** (1.0 / 3.0)
        low, high = arena[0] + WALL_MARGIN, arena[1] - WALL_MARGIN
        size = np.minimum(side, high - low)
        corner = low + (high - low - size) * rng.random(3)
        start = draw_apart(rng, corner, corner + size, n, 0.35)
        paired = rng.random() < self.pairs_share and n % 2 == 0
        order = _pairs(rng, n) if paired else derangement(rng, n)
        return Placement(start, start[order][None])


def swap_curriculum(task: Task, config: RlConfig) -> Task:
    """The task in which a swap is learned: in the layout `random`, hard starts too if wanted."""
    if config.layout == "random" and config.hard_starts:
        return SwapCurriculum(team=task.team, reward_weights=task.reward_weights)
    return task


def _pairs(rng: np.random.Generator, n: int) -> np.ndarray[tuple[int], np.dtype[np.int64]]:
    """A permutation (n,), n even, in which each changes places with one other."""
    order, shuffled = np.empty(n, dtype=np.int64), rng.permutation(n)
    order[shuffled[0::2]], order[shuffled[1::2]] = shuffled[1::2], shuffled[0::2]
    return order


@dataclass(frozen=True)
class FormationCurriculum(FormationTask):
    """One change of shape, from any of `shapes` to any, the same included; no reference."""

    nearest_share: float = 0.2
    """share of episodes in which places are matched to drones, as with labels='nearest'"""
    stretch: tuple[float, float] = (0.8, 1.0)
    """range from which the spacing of both shapes is drawn, over the task's own"""

    def __post_init__(self) -> None:
        """Refuse a share outside [0, 1], and shapes that would be larger than the task's."""
        super().__post_init__()
        check_range("FormationCurriculum.stretch", self.stretch)
        if not 0.0 <= self.nearest_share <= 1.0 or self.stretch[1] > 1.0:
            raise ValueError(
                f"FormationCurriculum.nearest_share is {self.nearest_share} and stretch "
                f"{self.stretch}, but must lie in [0, 1]"
            )

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
        stretch, angle = rng.uniform(*self.stretch), rng.uniform(*self.turn_rad)
        middle = (self.arena[0] + self.arena[1]) / 2
        c, s = np.cos(angle), np.sin(angle)
        turn = stretch * np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
        before, after = (
            middle + (self.places[k] - middle) @ turn for k in rng.integers(count, size=2)
        )
        matched = rng.random() < self.nearest_share
        here = before[rng.permutation(n)] if start is None else start
        order = nearest_places(here, after) if matched else rng.permutation(n)
        return Placement(here, after[order][None] if goal is None else goal[None])


def formation_curriculum(task: Task, config: RlConfig) -> Task:
    """The task in which formations are learned: the same unless hard starts are wanted."""
    if not config.hard_starts:
        return task
    return FormationCurriculum(team=task.team, reward_weights=task.reward_weights)
