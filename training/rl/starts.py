"""Swaps to learn from: the task's own layouts, and starts that are harder than both.

Nearly all failures of a policy that swaps are collisions soon after the start, mostly with a drone
that heads for the other's place. Starts drawn in a small cube, half of them as pairs that change
places, have many of these.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from swarm_envs.state import FloatArray
from swarm_envs.tasks.base import Task
from swarm_envs.tasks.mission import Placement
from swarm_envs.tasks.placing import WALL_MARGIN, check_range, derangement, draw_apart
from swarm_envs.tasks.swap import SwapTask
from swarm_envs.training.rl.config import TrainConfig


@dataclass(frozen=True)
class PracticeSwap(SwapTask):
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
        """Refuse shares that are none, and a layout that is not random."""
        super().__post_init__()
        check_range("PracticeSwap.crowded_side_m", self.crowded_side_m, 2.0 * self.radius.max())
        for name in ("circle_share", "crowded_share", "pairs_share"):
            if not 0.0 <= getattr(self, name) <= 1.0:
                raise ValueError(f"PracticeSwap.{name} is {getattr(self, name)}, not in [0, 1]")
        if self.layout != "random" or self.circle_share + self.crowded_share > 1.0:
            raise ValueError(
                "PracticeSwap needs layout='random', and shares of circle and crowded episodes "
                f"that sum to at most 1, not {self.circle_share} and {self.crowded_share}"
            )
        object.__setattr__(self, "_circle", replace(_plain(self), layout="circle"))

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
            circle: SwapTask = self._circle  # type: ignore[attr-defined]  # set when made
            return circle.draw(rng)
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


def practise_swap(task: Task, config: TrainConfig) -> Task:
    """What training flies for a swap: with the layout `random`, if wanted, hard starts too."""
    if config.layout == "random" and config.hard_starts:
        return PracticeSwap(team=task.team, reward_weights=task.reward_weights)
    return task


def _pairs(rng: np.random.Generator, n: int) -> np.ndarray[tuple[int], np.dtype[np.int64]]:
    """A permutation (n,), n even, in which each changes places with one other."""
    order, shuffled = np.empty(n, dtype=np.int64), rng.permutation(n)
    order[shuffled[0::2]], order[shuffled[1::2]] = shuffled[1::2], shuffled[0::2]
    return order


def _plain(task: SwapTask) -> SwapTask:
    """The swap without what is practised beside."""
    names = ("team", "layout", "stacked", "circle", "spacing_m", "heights_m", "success")
    options = {name: getattr(task, name) for name in names}
    return SwapTask(**options, reward_weights=task.reward_weights, obstacles=task.obstacles)
