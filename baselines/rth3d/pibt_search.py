"""PIBT with restarts, and PIBT from the starts and from the goals to vertices halfway."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from swarm_envs.baselines.rth3d.compaction import Paths, compact
from swarm_envs.baselines.rth3d.grid import Coordinates, GridInstance
from swarm_envs.baselines.rth3d.grid_plan import PlanningClock
from swarm_envs.baselines.rth3d.pibt import Pibt

_PATIENCE = 1.5
"""An attempt ends after this multiple of the lower bound, plus `_MARGIN` steps."""
_MARGIN = 60
_RESTARTS = 9 * (0.9, 0.8, 0.6, 0.3)
"""The shares of the lower bound at which PIBT is restarted, in order."""
_WORK = 250_000
"""The most steps of all restarts together times robots, as a multiple of the lower bound: tens of
seconds for many robots. For few, `_MOST_WORK` limits the steps, as more do not help."""
_MOST_WORK = 12.0
_VERDICT = 0.75
"""The share of the lower bound after which the first attempt shows if restarts may help."""
_HOPELESS = 1.1
"""Restarts are omitted if it cannot end by then within this multiple of the lower bound plus
`_SLACK` steps, as for rings and mirrors, whose robots cross in the middle; random instances can."""
_SLACK = 4
GOOD_ENOUGH = 1.02  # The multiple of the lower bound from which on PIBT is not restarted
_STALL = 48
"""The steps without a decrease of the longest remaining path after which PIBT has stalled."""
_LOST = 16
"""The steps without it after which robots move partly at random, to leave narrow passages."""
_GLANCE = 250_000  # Moves of robots between two checks of the clock, a tenth of a second
_STRIDE = 16  # The most steps between them


class PibtSearch:
    """PIBT and its restarts, with the best plan that is shorter than a known makespan."""

    def __init__(self, instance: GridInstance, seed: int, clock: PlanningClock) -> None:
        self.bound = instance.lower_bound
        self.cap = int(_PATIENCE * self.bound) + _MARGIN
        self.pibt = Pibt(instance, self.cap)
        self.best: Paths | None = None
        self.reached, self.left = 0, self.bound
        """The last step of the last attempt, and the longest remaining path then."""
        self._generator = np.random.default_rng(seed)
        self._clock = clock
        self._robots = len(instance.starts)
        self._chunk = min(_STRIDE, max(1, _GLANCE // self._robots))
        self._begin(0)

    def attempt(self) -> Paths | None:
        """Return the first attempt's plan if it is as short as the lower bound, or None.

        It ends when that is impossible, or after half of the time, and `run` continues from there.
        """
        with self._clock.phase("pibt, to the lower bound") as record:
            self._limit = min(self.bound, self.cap)
            self._advance(self._limit, self.bound, self._clock.halved())
            self._keep()
            record(self.reached)
        return self.best

    def improve(self, known: int | None = None) -> Paths | None:
        """Return the result of `run`, recorded as a phase of planning."""
        with self._clock.phase("pibt") as record:
            best = self.run(known)
            record(self.reached if best is None else len(best) - 1)
        return best

    def run(self, known: int | None = None) -> Paths | None:
        """Return the best plan of the first attempt and of restarts, or None.

        `known` is the makespan of another plan; only shorter ones count.
        """
        self._limit = self.cap if known is None else min(self.cap, known - 1)
        self._advance(int(_VERDICT * self.bound), self.cap)
        hopeless = self.reached + self.left > _HOPELESS * self.bound + _SLACK
        self._finish(last=hopeless)
        if not hopeless:
            self._restart()
        return self.best

    def _restart(self) -> None:
        work = min(_MOST_WORK, _WORK / self._robots) * self.bound
        for part in _RESTARTS:
            done = self.best is not None and len(self.best) - 1 <= GOOD_ENOUGH * self.bound
            if done or work <= 0 or self._clock.remaining <= 0:
                return
            begin = min(int(part * self.bound), self.reached)
            self._begin(begin)
            self._finish(last=False)
            work -= self.reached - begin

    def _begin(self, step: int) -> None:
        """Draw new random numbers, and discard what came after a step."""
        if self.best is not None and self.best.base is not None:
            self.best = self.best.copy()  # It is about to be overwritten
        self.pibt.reseed(self._generator)
        self.pibt.rewind(step)
        self.reached, self.left = step, -1

    def _finish(self, last: bool) -> None:
        """Continue an attempt to its end; keep its plan if it is the best."""
        if not last:  # Restarts continue from there
            self._advance(int(max(_RESTARTS) * self.bound), self.cap)
        self._advance(self.cap, self._limit)
        self._keep()

    def _keep(self) -> None:
        if self.left == 0 and self.reached <= self._limit:
            self.best = self.pibt.paths[: self.reached + 1]
            self._limit = self.reached - 1

    def _advance(self, end: int, limit: int, clock: PlanningClock | None = None) -> None:
        """Continue to a step, or until all have arrived, cannot in time, stall, or time is up."""
        clock, least, since = clock or self._clock, self.bound + 1, self.reached
        while self.reached < end and self.left != 0 and clock.remaining > 0:
            to = min(self.reached + self._chunk, end)
            lost = self.reached >= since + _LOST
            self.reached, self.left = self.pibt.run(self.reached, to, limit, self.left, lost)
            if self.left < least:
                least, since = self.left, self.reached
            if self.reached < to or self.reached > max(self.bound, since + _STALL):
                return


def halfway(instance: GridInstance) -> Coordinates:
    """Return vertices (n, 3), all different and spread over a grid without obstacles.

    Robots are assigned to planes by the order of x halfway between starts and goals, in each plane
    to rows by that of y, and in each row to vertices by that of z.
    """
    twice, (m1, m2, m3) = instance.starts + instance.goals, instance.shape
    found = np.empty_like(instance.starts)
    for x, plane in enumerate(np.array_split(np.argsort(twice[:, 0], kind="stable"), m1)):
        by_y = plane[np.argsort(twice[plane, 1], kind="stable")]
        for y, row in enumerate(np.array_split(by_y, m2)):
            by_z = row[np.argsort(twice[row, 2], kind="stable")]
            z = (2 * np.arange(len(row)) + 1) * m3 // (2 * max(len(row), 1))
            found[by_z] = np.stack([np.full_like(z, x), np.full_like(z, y), z], axis=1)
    return found


def search_halfway(
    instance: GridInstance, seed: int, clock: PlanningClock, known: int
) -> Paths | None:
    """Return a plan over vertices halfway, or None if there are obstacles or none is found.

    PIBT leads robots well from a crowd to vertices that are spread out, and with reversed time also
    back into a crowd, but not from one crowd into another: early arrivals block the others.
    """
    if instance.obstacles.any():
        return None
    middle = halfway(instance)
    halves = [replace(instance, starts=p, goals=middle) for p in (instance.starts, instance.goals)]
    if max(half.lower_bound for half in halves) >= known:
        return None
    there, back = (PibtSearch(half, seed, clock).run() for half in halves)
    if there is None or back is None:
        return None
    return compact(np.concatenate([there, back[-2::-1]]), int(np.prod(instance.shape)))
