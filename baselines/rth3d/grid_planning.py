"""`plan` and its methods: RTH3D as in the paper, PIBT, LaCAM*, and the best of them.

Algorithm 1 of the paper is `rth3d`, and its lines 3 to 5 are `rta3d`; their steps are in
`unlabeled_mrpp` and `rubik`.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cache, partial

import numpy as np
import numpy.typing as npt

from swarm_envs.baselines.rth3d.compaction import Paths, compact
from swarm_envs.baselines.rth3d.grid import (
    GridInstance,
    NoHighways,
    NoPlanExists,
    PlanNotFound,
    check_instance,
    numbers,
)
from swarm_envs.baselines.rth3d.grid_plan import GridPlan, PlanningClock, PlanTimeout
from swarm_envs.baselines.rth3d.grid_validation import check_paths, follow_paths
from swarm_envs.baselines.rth3d.highways import choose_highways
from swarm_envs.baselines.rth3d.matching import assign_levels
from swarm_envs.baselines.rth3d.negotiation import negotiate
from swarm_envs.baselines.rth3d.paper_lba import assign_levels_in_turn, balance_by_distance
from swarm_envs.baselines.rth3d.parts import search_parts
from swarm_envs.baselines.rth3d.pibt_search import GOOD_ENOUGH, PibtSearch, search_halfway
from swarm_envs.baselines.rth3d.rubik import (
    Matching,
    RubikTable,
    Shuffles,
    concatenate,
    matching_xy,
    rubik_table,
    xy_fitting,
    z_fitting,
)
from swarm_envs.baselines.rth3d.unlabeled_mrpp import balance, unlabeled_mrpp
from swarm_envs.compiled import announce_compilation
from swarm_envs.errors import check_integer, check_name, check_number


@dataclass(frozen=True, eq=False)
class _Solution:
    paths: Paths  # (T + 1, n) vertices of the given grid
    method: str  # The method that found them, as `GridPlan.winner`
    bound: int | None = None  # Guaranteed bound of the makespan, if any
    before_compaction: int | None = None  # Makespan of RTH3D's phases one after another

    @property
    def makespan(self) -> int:
        """The number of steps of the plan."""
        return len(self.paths) - 1


Solver = Callable[[GridInstance, int, PlanningClock], _Solution]
"""A function that returns paths for an instance, a seed and a clock."""

SIDE_STEPS = 9
"""Steps of the five shuffles beyond m1 + 2 m2 + 2 m3: 1 for each in which robots step out and back
(they run over m - 1 edges at most), 5 for that in which they change lanes, park and form a column.
"""


def rth3d(
    instance: GridInstance,
    seed: int,
    clock: PlanningClock,
    name: str,
    match: Matching,
    balance: Callable[..., Paths] = balance,
) -> _Solution:
    """Return the plan of RTH3D (Algorithm 1), compacted; it does not depend on the seed."""
    highways = choose_highways(instance)
    balanced = unlabeled_mrpp(highways, instance, balance, clock)
    table = rubik_table(highways, balanced)
    paths = concatenate(table, balanced, rta3d(table, match, clock), clock)
    before = len(paths) - 1
    balancing = len(balanced.first) + len(balanced.last) - 2
    with clock.phase("compaction") as record:
        paths = compact(paths, int(np.prod(highways.shape)))
        record(len(paths) - 1)
    bound = highways.length + SIDE_STEPS + balancing
    return _Solution(highways.renumber(paths), name, bound, before)


def rta3d(table: RubikTable, match: Matching, clock: PlanningClock) -> Shuffles:
    """Return the shuffles that solve a Rubik table (RTA3D, Sec. II-B): z, then y, x, y, then z."""
    height, to_height = matching_xy(table, match, clock)
    across = xy_fitting(table, height, match, clock)
    return {"heights": to_height, **across, "heights to goals": z_fitting(table, height)}


rth3d_lba = partial(rth3d, name="rth3d-lba", match=partial(assign_levels, bounded=True))


def _pibt(instance: GridInstance, seed: int, clock: PlanningClock) -> _Solution:
    """Return PIBT's best plan; PlanNotFound if not all robots arrive in any attempt."""
    search = PibtSearch(instance, seed, clock)
    best = search.improve()
    if best is None:
        if clock.remaining <= 0:
            raise PlanTimeout("the time limit ended before pibt had a plan; allow more time")
        raise PlanNotFound(
            f"pibt has found no plan of at most {search.cap} steps (lower bound {search.bound}); "
            "try another seed, or method='auto', which tries other methods as well"
        )
    return _Solution(best, "pibt")


def _lacam(instance: GridInstance, seed: int, clock: PlanningClock) -> _Solution:
    """Return the best plan of LaCAM*."""
    return _Solution(search_parts(instance, seed, clock), "lacam")


def auto(instance: GridInstance, seed: int, clock: PlanningClock) -> _Solution:
    """Return the shortest plan of several methods.

    1. PIBT, until its plan cannot be as short as the lower bound; on random instances it mostly is.
    2. RTH3D-LBA, which always succeeds, if highways fit; else LaCAM*, in half of the time.
    3. PIBT to its end, with restarts, whose plan is the shortest unless dense crowds cross.
    4. While a plan may be more than 2 % too long: PIBT to vertices halfway, then negotiation.
    """
    pibt, best, failure = None, None, None
    try:
        choose_highways(instance)
        pibt = PibtSearch(instance, seed, clock)
        if (shortest := pibt.attempt()) is not None:
            return _Solution(shortest, "pibt")
        best = rth3d_lba(instance, seed, clock)
    except NoHighways:
        best, failure = _try_lacam(instance, seed, clock.halved())
    if best is None or best.makespan > instance.lower_bound:
        known, bound = (best.makespan, best.bound) if best else (None, None)
        with suppress(PlanTimeout):
            paths = (pibt or PibtSearch(instance, seed, clock)).improve(known)
            best = best if paths is None else _Solution(paths, "pibt", bound)
    if best is None:
        assert failure is not None
        raise failure
    return _shorten(instance, seed, clock, best)


def _try_lacam(
    instance: GridInstance, seed: int, clock: PlanningClock
) -> tuple[_Solution | None, Exception | None]:
    """Return LaCAM*'s plan, or the error if it has found none, though there may be one."""
    try:
        return _lacam(instance, seed, clock), None
    except NoPlanExists:
        raise
    except (PlanNotFound, PlanTimeout) as error:
        return None, error


def _shorten(instance: GridInstance, seed: int, clock: PlanningClock, best: _Solution) -> _Solution:
    """Return the best plan, shortened if it is far from the lower bound."""
    for name, search in (("pibt halfway", search_halfway), ("negotiation", negotiate)):
        if best.makespan > GOOD_ENOUGH * instance.lower_bound:
            with suppress(PlanTimeout), clock.phase(name) as record:
                paths = search(instance, seed, clock, best.makespan)
                if paths is not None and len(paths) - 1 < best.makespan:
                    best = _Solution(paths, name, best.bound)
                record(best.makespan)
    return best


METHODS: Mapping[str, Solver] = {
    "rth3d": partial(rth3d, name="rth3d", match=partial(assign_levels, bounded=False)),
    "rth3d-lba": rth3d_lba,
    "rth3d-lba-paper": partial(
        rth3d, name="rth3d-lba-paper", match=assign_levels_in_turn, balance=balance_by_distance
    ),
    "pibt": _pibt,
    "lacam": _lacam,
    "auto": auto,
}
"""The methods by name."""


def plan(
    starts: npt.ArrayLike,
    goals: npt.ArrayLike,
    shape: Sequence[int],
    obstacles: npt.ArrayLike | None = None,
    method: str = "auto",
    seed: int = 0,
    time_limit: float | None = None,
    watch: Callable[[str], None] | None = None,
    configurations: int | None = None,
) -> GridPlan:
    """Return collision-free paths on a 6-connected grid for robots that each have their own goal.

    Args:
        starts: The vertices (x, y, z) at which robots start, (n, 3) integers, all different.
        goals: The vertices at which robots end, (n, 3) integers, all different.
        shape: The shape of the grid, (m1, m2, m3), or (m1, m2) with (n, 2) starts and goals.
        obstacles: Booleans of that shape, or None. For `"rth3d"` and its variants, only whole
            columns at x = 3i + 1, y = 3j + 1.
        method: `"rth3d"` (any matchings) and `"rth3d-lba"` (small shifts) always succeed up to
            `max_density(shape, obstacles)`; `"rth3d-lba-paper"` matches and balances as published;
            `"pibt"` accepts any density, without guarantee; `"lacam"` does so too, and with enough
            configurations finds the shortest plan, or proves that none exists; `"auto"` is the best
            of `"pibt"` and `"rth3d-lba"`, or `"lacam"` if highways do not fit. If that is not near
            the lower bound, it also tries PIBT from both ends to vertices halfway, and negotiated
            congestion (PathFinder).
        seed: The seed of PIBT and LaCAM*; the other methods use none. The same seed gives the same
            plan, unless a time limit ends the search.
        time_limit: The wall-clock limit without compilation, s; a phase that has begun may exceed
            it. The best plan so far is returned; if there is none, PlanTimeout is raised.
        watch: A function called with the name of each phase when it begins.
        configurations: The most configurations of LaCAM* in each connected part of the grid; None
            for 1,000,000, or as many as fit into 0.8 GB. Without a time limit it makes as many
            again after its first plan to improve it, at least 1,000 (fewer for over 1,000 robots).

    Returns:
        A plan that `validate` has found feasible.

    Raises:
        ValueError: Starts, goals, shape or obstacles are invalid, or not supported by the method.
        NoPlanExists: It is proven that no plan exists; a ValueError and a PlanNotFound.
        PlanTimeout: The time ended before there was a valid plan.
        PlanNotFound: No plan was found, though there may be one.
    """
    check_integer("seed", seed, at_least=0)
    if time_limit is not None:
        check_number("time_limit", time_limit, above=0.0, unit="s")
    if configurations is not None:
        check_integer("configurations", configurations, at_least=1)
    instance = check_instance(starts, goals, shape, obstacles)
    check_name("method", method, METHODS)
    if time_limit is not None:
        _compile(method)
    deadline = float("inf") if time_limit is None else time.monotonic() + time_limit
    clock = PlanningClock(deadline, watch, configurations)
    announce_compilation(follow_paths)
    if instance.lower_bound == 0:
        solution = _Solution(numbers(instance.starts, instance.shape)[None], "stay", bound=0)
    else:
        solution = METHODS[method](instance, seed, clock)
    return _result(instance, solution, method, seed, clock)


@cache
def _compile(method: str) -> None:
    """Plan small instances, so that compilation does not count against a time limit."""
    announce_compilation(follow_paths)
    clock = PlanningClock()
    for blocked in (False, True):
        walls = np.zeros((6, 6, 3), dtype=np.bool_)
        walls[2, 1, 0] = blocked
        free = np.argwhere(~walls)[:12].astype(np.int32)
        small = GridInstance((6, 6, 3), free, free[::-1].copy(), walls)
        for name in ("rth3d-lba", "pibt", "lacam") if method == "auto" else (method,):
            with suppress(NoHighways, PlanNotFound):
                paths = METHODS[name](small, 0, clock).paths
                negotiate(small, 0, clock, len(paths) + 1)
                check_paths(paths, small)


def _result(
    instance: GridInstance, solution: _Solution, method: str, seed: int, clock: PlanningClock
) -> GridPlan:
    with clock.last_phase("validation") as record:
        report, moves = check_paths(solution.paths, instance)
        record(report.makespan)
    if not report:
        raise AssertionError(f"{method!r} has made an invalid plan: {report.reason}")
    return GridPlan(
        moves=moves,
        method=method,
        winner=solution.method,
        seed=seed,
        bound=solution.bound,
        before_compaction=solution.before_compaction,
        phases=tuple(clock.phases),
        valid=bool(report),
        **instance.fields(),
    )
