"""The four methods: two that always succeed, one that promises nothing, and the best of both."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from swarm_envs.baselines.rth3d.compaction import Paths, compact
from swarm_envs.baselines.rth3d.grid import GridInstance, numbers, points
from swarm_envs.baselines.rth3d.highways import Highways, choose_highways
from swarm_envs.baselines.rth3d.records import Clock, PlanTimeout
from swarm_envs.baselines.rth3d.rubik import balance_both, shuffle
from swarm_envs.baselines.rth3d.search import Search


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
"""Finds paths from an instance, a seed and a clock."""

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


def _search(instance: GridInstance, seed: int, clock: Clock, known: int | None = None) -> Search:
    with clock.phase("pibt") as record:
        search = Search(instance, seed, clock, known)
        search.run()
        record(search.reached if search.best is None else len(search.best) - 1)
    return search


def solve_pibt(instance: GridInstance, seed: int, clock: Clock) -> Solution:
    """PIBT alone.

    Raises:
        PlanTimeout: the time ended before there was any plan.
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


def _finish_stalled(instance: GridInstance, search: Search, clock: Clock) -> Solution:
    """Where PIBT has stalled, go on by RTH3D-LBA, and compact all of it."""
    begin = search.reached
    stalled = replace(instance, starts=points(search.pibt.paths[begin], instance.shape))
    rest = solve_rth3d_lba(stalled, 0, clock)
    assert rest.bound is not None
    whole = np.concatenate([search.pibt.paths[:begin], rest.paths])
    with clock.phase("compaction of both") as record:
        whole = compact(whole, int(np.prod(instance.shape)))
        record(len(whole) - 1)
    return Solution(whole, "pibt, then rth3d-lba", begin + rest.bound)


def _improve(instance: GridInstance, seed: int, clock: Clock, known: Solution) -> Solution:
    """A shorter plan than the one that is known, by PIBT or from where it has stalled; or that."""
    search = _search(instance, seed, clock, known.makespan)
    if search.best is not None:
        return Solution(search.best, "pibt", None)
    if search.reached + search.left >= known.makespan:
        return known
    return min(known, _finish_stalled(instance, search, clock), key=lambda found: found.makespan)


def solve_auto(instance: GridInstance, seed: int, clock: Clock) -> Solution:
    """The best of RTH3D-LBA, PIBT, and RTH3D-LBA from where PIBT has stalled.

    Raises:
        ValueError: the robots are too many for RTH3D.
        PlanTimeout: the time ended before there was any plan.
    """
    found = sure = solve_rth3d_lba(instance, seed, clock)
    if sure.makespan > instance.lower_bound:
        with suppress(PlanTimeout):
            found = _improve(instance, seed, clock, sure)
    bounds = [b for b in (found.bound, sure.bound) if b is not None]
    return replace(found, bound=min(bounds))


METHODS: Mapping[str, Solver] = {
    "rth3d": solve_rth3d,
    "rth3d-lba": solve_rth3d_lba,
    "pibt": solve_pibt,
    "auto": solve_auto,
}
"""Every method by its name."""
