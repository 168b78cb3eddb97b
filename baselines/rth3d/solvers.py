"""The four methods: two that always succeed, one that promises nothing, and the best of both."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from swarm_envs.baselines.rth3d.compaction import Paths, compact
from swarm_envs.baselines.rth3d.grid import GridInstance, numbers, points
from swarm_envs.baselines.rth3d.highways import Highways, choose_highways
from swarm_envs.baselines.rth3d.pibt import Pibt
from swarm_envs.baselines.rth3d.records import Clock, PlanTimeout
from swarm_envs.baselines.rth3d.rubik import balance_both, shuffle


@dataclass(frozen=True, eq=False)
class Solution:
    """Paths and what is known of them."""

    paths: Paths
    """(T + 1, n) vertices of the given grid."""
    method: str
    """What found them: a method, or "pibt, then rth3d-lba"."""
    bound: int | None
    """What the makespan could not exceed, whatever the labels; None without such a bound."""
    before_compaction: int | None = None
    """Makespan of RTH3D's phases one after another."""

    @property
    def makespan(self) -> int:
        """Steps of the plan."""
        return len(self.paths) - 1


class PlanNotFound(RuntimeError):
    """A method without guarantee has found no plan."""


Solver = Callable[[GridInstance, int, Clock], Solution]

SIDE_STEPS = 9
"""What the five shuffles take beyond m1 + 2 m2 + 2 m3: 1 each where robots step out and back (they
run over m - 1 edges at most), 5 where they change lanes, park and form a column."""


def _renumber(paths: Paths, highways: Highways) -> Paths:
    """Number the vertices as in the given grid, in place."""
    given = np.arange(np.prod(highways.shape), dtype=np.int32)
    back = tuple(np.argsort(highways.axes))
    shape = tuple(highways.shape[k] for k in back)
    where = points(given, highways.shape)[:, back]
    given = numbers(where, shape)  # type: ignore[arg-type]
    for row in paths:
        row[:] = given[row]
    return paths


def _rth3d(instance: GridInstance, clock: Clock, bounded: bool) -> Solution:
    """Plan by RTH3D, with or without bounded shifts, and compact."""
    highways = choose_highways(instance)
    axes = list(highways.axes)
    starts, goals = (numbers(p[:, axes], highways.shape) for p in (instance.starts, instance.goals))
    balanced = balance_both(highways, starts, goals, clock)
    paths = shuffle(highways, balanced, bounded, clock)
    before = len(paths) - 1
    balancing = len(balanced.first) + len(balanced.last) - 2
    with clock.phase("compaction") as record:
        paths = compact(paths, int(np.prod(highways.shape)))
        record(len(paths) - 1)
    return Solution(
        paths=_renumber(paths, highways),
        method="rth3d-lba" if bounded else "rth3d",
        bound=highways.length + SIDE_STEPS + balancing,
        before_compaction=before,
    )


def solve_rth3d(instance: GridInstance, seed: int, clock: Clock) -> Solution:
    """RTH3D with any matchings; nothing in it is random."""
    return _rth3d(instance, clock, bounded=False)


def solve_rth3d_lba(instance: GridInstance, seed: int, clock: Clock) -> Solution:
    """RTH3D with matchings whose shifts are small; nothing in it is random."""
    return _rth3d(instance, clock, bounded=True)


_PATIENCE = 1.5
"""PIBT gives up when it takes so many times the lower bound, and `_MARGIN` more steps."""
_MARGIN = 60
_RESTARTS = 4 * (0.9, 0.8, 0.6)
"""From which part of the lower bound on PIBT is tried again, as long as it pays."""
_WORK = 4.0
"""Steps that all restarts may take together, as a multiple of the lower bound."""
_HOPELESS = 0.1
"""PIBT is not tried again if more than this part of the lower bound was left to a robot."""
_GOOD_ENOUGH = 1.02
"""Multiple of the lower bound from which on PIBT is not tried again."""
_STRIDE = 16
"""Steps between two looks at the clock and at the progress."""
_STRIDES = 3
"""PIBT has stalled when the farthest robot has come no nearer to its goal for so many strides."""


class _Search:
    """PIBT and its restarts; keeps the best plan."""

    def __init__(self, instance: GridInstance, seed: int, clock: Clock) -> None:
        self.bound = instance.lower_bound
        self.cap = int(_PATIENCE * self.bound) + _MARGIN
        self.pibt = Pibt(instance, self.cap)
        self.generator = np.random.default_rng(seed)
        self.clock = clock
        self.best: Paths | None = None
        self.reached, self.left = 0, self.bound

    @property
    def limit(self) -> int:
        """A plan must not take more to be worth finishing."""
        return self.cap if self.best is None else len(self.best) - 2

    def attempt(self, begin: int) -> int:
        """Try once from a step on; return the steps taken."""
        self.pibt.shuffle(self.generator)
        self.pibt.rewind(begin)
        at, lefts = begin, [self.bound] * _STRIDES
        while True:
            last, left = self.pibt.run(at, _STRIDE, self.limit)
            self.reached, self.left = last, left
            lefts.append(left)
            stalled = last > self.bound and min(lefts[-_STRIDES:]) >= lefts[-_STRIDES - 1]
            if left == 0:
                self.best = self.pibt.paths[: last + 1].copy()
                break
            if stalled or last < at + _STRIDE or self.clock.remaining <= 0:
                break
            at = last
        return self.reached - begin

    def run(self) -> None:
        """The first attempt, and restarts of it while there is something to gain."""
        self.attempt(0)
        if self.best is None and self.left > _HOPELESS * self.bound:
            return
        work = _WORK * self.bound
        for part in _RESTARTS:
            done = self.best is not None and len(self.best) - 1 <= _GOOD_ENOUGH * self.bound
            if done or work <= 0 or self.clock.remaining <= 0:
                return
            work -= self.attempt(min(int(part * self.bound), self.reached))


def _search(instance: GridInstance, seed: int, clock: Clock) -> _Search:
    with clock.phase("pibt") as record:
        search = _Search(instance, seed, clock)
        search.run()
        record(search.reached if search.best is None else len(search.best) - 1)
    return search


def solve_pibt(instance: GridInstance, seed: int, clock: Clock) -> Solution:
    """PIBT alone.

    Raises:
        PlanNotFound: not all robots arrive in any attempt.
    """
    search = _search(instance, seed, clock)
    if search.best is None:
        if clock.remaining <= 0:
            raise PlanTimeout("the time limit ended before pibt had a plan; give more time")
        raise PlanNotFound(
            f"pibt has found no plan of at most {search.cap} steps (lower bound {search.bound}); "
            "try another seed, or method='auto', which has one up to max_density(shape, obstacles)"
        )
    return Solution(search.best, "pibt", None)


def _finish_stalled(instance: GridInstance, search: _Search, clock: Clock) -> Solution:
    """Where PIBT has stalled, go on by RTH3D-LBA, and compact all of it."""
    begin = min(search.bound, search.reached)
    stalled = replace(instance, starts=points(search.pibt.paths[begin], instance.shape))
    rest = solve_rth3d_lba(stalled, 0, clock)
    assert rest.bound is not None
    whole = np.concatenate([search.pibt.paths[:begin], rest.paths])
    with clock.phase("compaction of both") as record:
        whole = compact(whole, int(np.prod(instance.shape)))
        record(len(whole) - 1)
    return Solution(whole, "pibt, then rth3d-lba", begin + rest.bound)


def solve_auto(instance: GridInstance, seed: int, clock: Clock) -> Solution:
    """The best of PIBT, RTH3D-LBA, and RTH3D-LBA from where PIBT has stalled.

    Raises:
        ValueError: the robots are too many for RTH3D.
        PlanTimeout: the time ended before there was any plan.
    """
    choose_highways(instance)
    search = _search(instance, seed, clock)
    found: list[Solution] = []
    if search.best is not None:
        found.append(Solution(search.best, "pibt", None))
        if found[0].makespan == search.bound:
            return replace(found[0], bound=search.bound)
    tries: list[Callable[[], Solution]] = [lambda: solve_rth3d_lba(instance, seed, clock)]
    if search.best is None:
        tries.append(lambda: _finish_stalled(instance, search, clock))
    for attempt in tries:
        try:
            found.append(attempt())
        except PlanTimeout:
            if not found:
                raise
            break
    best = min(found, key=lambda solution: solution.makespan)
    bounds = [solution.bound for solution in found if solution.bound is not None]
    return replace(best, bound=min(bounds, default=None))


METHODS: Mapping[str, Solver] = {
    "rth3d": solve_rth3d,
    "rth3d-lba": solve_rth3d_lba,
    "pibt": solve_pibt,
    "auto": solve_auto,
}
"""Every method by its name."""
