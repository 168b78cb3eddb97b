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
from swarm_envs.tasks.base import Placement, Task
from swarm_envs.tasks.formation import FormationTask, nearest_places
from swarm_envs.tasks.motion import REST, Motion
from swarm_envs.tasks.placing import WALL_MARGIN, derangement, draw_apart
from swarm_envs.tasks.swap import SwapTask
from swarm_envs.training.rl.rl_config import RlConfig

CIRCLE_SHARE, CROWDED_SHARE = 0.25, 0.5
"""Shares of episodes on a circle, and in a small cube; the rest are those of the random layout."""
CROWDED_SIDE_M = (0.9, 1.6)
"""Side of the cube for four drones, m, from which it is drawn; it grows with N^(1/3)."""
PAIRS_SHARE = 0.5
"""Share of crowded episodes in which drones change places in pairs."""
NEAREST_SHARE = 0.2
"""Share of formations in which places are matched to drones, as with labels='nearest'."""
STRETCH = (0.8, 1.0)
"""Range from which the spacing of both shapes is drawn, over the task's own."""


@dataclass(frozen=True)
class SwapCurriculum(SwapTask):
    """A random swap whose episodes are at times on a circle, and at times crowded."""

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
        if kind < CIRCLE_SHARE:
            return self._circle.draw(rng)
        if kind < CIRCLE_SHARE + CROWDED_SHARE:
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
    """The task in which formations are learned: the same unless hard starts are wanted."""
    if not config.hard_starts:
        return task
    return FormationCurriculum(team=task.team, reward_weights=task.reward_weights)
