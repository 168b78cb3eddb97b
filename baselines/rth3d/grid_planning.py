"""`plan` and its methods: RTH3D, PIBT with restarts, a complete search, and the best of them.

What is shorter than a plan that is known already is found whether that plan is known or not: the
knowledge only ends attempts that cannot get below it, and only after the last step from which
another attempt may go on.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cache, partial

import numpy as np
import numpy.typing as npt

from swarm_envs.baselines.rth3d.balancing import balance
from swarm_envs.baselines.rth3d.compaction import Paths, compact
from swarm_envs.baselines.rth3d.grid import (
    GridInstance,
    NoHighways,
    NoPlanExists,
    PlanNotFound,
    check_instance,
    numbers,
    points,
)
from swarm_envs.baselines.rth3d.grid_plan import GridPlan, PlanningClock, PlanTimeout
from swarm_envs.baselines.rth3d.grid_validation import check_paths, follow_paths
from swarm_envs.baselines.rth3d.lacam import (
    Lacam,
    after_a_plan,
    most_configurations,
    stride,
)
from swarm_envs.baselines.rth3d.matching import assign_levels
from swarm_envs.baselines.rth3d.negotiation import negotiate
from swarm_envs.baselines.rth3d.paper_lba import assign_levels_in_turn, balance_by_distance
from swarm_envs.baselines.rth3d.parts import check_order, connected_parts
from swarm_envs.baselines.rth3d.pibt_search import (
    GOOD_ENOUGH,
    PibtSearch,
    search_halfway,
)
from swarm_envs.baselines.rth3d.rubik import (
    Highways,
    Matching,
    balance_both,
    choose_highways,
    shuffle,
)
from swarm_envs.compiled import announce_compilation
from swarm_envs.errors import check_integer, check_name, check_number


@dataclass(frozen=True, eq=False)
class _Solution:
    paths: Paths  # (T + 1, n) vertices of the given grid
    method: str  # What found them, as `GridPlan.winner`
    # What the makespan could not exceed; None without such a bound
    bound: int | None
    before_compaction: int | None = None  # Makespan of RTH3D's phases one after another

    @property
    def makespan(self) -> int:
        """Steps of the plan."""
        return len(self.paths) - 1


Solver = Callable[[GridInstance, int, PlanningClock], _Solution]
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


def _rth3d(
    instance: GridInstance,
    seed: int,
    clock: PlanningClock,
    name: str,
    match: Matching,
    balance: Callable[..., Paths] = balance,
) -> _Solution:
    """RTH3D by a way to match and one to balance; nothing in it is random."""
    highways = choose_highways(instance)
    axes = list(highways.axes)
    starts, goals = (numbers(p[:, axes], highways.shape) for p in (instance.starts, instance.goals))
    balanced = balance_both(highways, starts, goals, balance, clock)
    paths = shuffle(highways, balanced, match, clock)
    before = len(paths) - 1
    balancing = len(balanced.first) + len(balanced.last) - 2
    with clock.phase("compaction") as record:
        paths = compact(paths, int(np.prod(highways.shape)))
        record(len(paths) - 1)
    return _Solution(
        paths=_renumber(paths, highways),
        method=name,
        bound=highways.length + SIDE_STEPS + balancing,
        before_compaction=before,
    )


_solve_rth3d_lba = partial(_rth3d, name="rth3d-lba", match=partial(assign_levels, bounded=True))


def _search(search: PibtSearch, clock: PlanningClock, known: int | None = None) -> Paths | None:
    """What PIBT finds that is shorter than a plan that is known."""
    with clock.phase("pibt") as record:
        best = search.run(known)
        record(search.reached if best is None else len(best) - 1)
    return best


def _solve_pibt(instance: GridInstance, seed: int, clock: PlanningClock) -> _Solution:
    """PIBT alone; PlanNotFound if not all robots arrive in any attempt."""
    search = PibtSearch(instance, seed, clock)
    best = _search(search, clock)
    if best is None:
        if clock.remaining <= 0:
            raise PlanTimeout("the time limit ended before pibt had a plan; give more time")
        raise PlanNotFound(
            f"pibt has found no plan of at most {search.cap} steps (lower bound {search.bound}); "
            "try another seed, or method='auto', which has other methods as well"
        )
    return _Solution(best, "pibt", None)


def _shorten(
    instance: GridInstance, seed: int, clock: PlanningClock, known: _Solution
) -> _Solution:
    """A shorter plan than one that is far from the lower bound; or that."""
    for name, search in (("pibt halfway", search_halfway), ("negotiation", negotiate)):
        if known.makespan <= GOOD_ENOUGH * instance.lower_bound:
            break
        with clock.phase(name) as record:
            found = search(instance, seed, clock, known.makespan)
            if found is not None and len(found) - 1 < known.makespan:
                known = _Solution(found, name, known.bound)
            record(known.makespan)
    return known


def _search_part(part: GridInstance, seed: int, clock: PlanningClock) -> Paths:
    """The best plan of LaCAM* for robots that all can get to each other."""
    count = len(part.starts)
    most = clock.configurations or most_configurations(count, part.lower_bound)
    lacam = Lacam(part, seed)
    while not lacam.exhausted and lacam.made < most:
        if clock.remaining <= 0 or lacam.steps == part.lower_bound:
            break
        first = lacam.steps is None
        lacam.run(min(most, lacam.made + stride(count)))
        if first and lacam.steps is not None and not clock.limited:
            most = after_a_plan(count, lacam.made)
    if lacam.steps is not None:
        return lacam.paths()
    if lacam.exhausted:
        raise NoPlanExists(
            f"no plan exists: the search has tried all that {count} robots can do, from robot at "
            f"{part.starts[0].tolist()} on ({lacam.made} configurations)"
        )
    clock.check("lacam")
    raise PlanNotFound(
        f"lacam has found no plan within {lacam.made} configurations of {count} robots, and has "
        "not shown that there is none; try another seed, or more configurations"
    )


def _solve_lacam(instance: GridInstance, seed: int, clock: PlanningClock) -> _Solution:
    """LaCAM*, in each connected part of the grid by itself; then every move as early as it can."""
    parts = connected_parts(instance)
    check_order(instance, parts)
    with clock.phase("lacam") as record:
        found = [_search_part(part.instance, seed, clock) for part in parts]
        steps = max(len(paths) for paths in found)
        whole = np.tile(numbers(instance.starts, instance.shape), (steps, 1))
        for part, paths in zip(parts, found, strict=True):
            whole[: len(paths), part.robots] = paths
            whole[len(paths) :, part.robots] = paths[-1]
        whole = compact(whole, int(np.prod(instance.shape)))
        record(len(whole) - 1)
    return _Solution(whole, "lacam", None)


def _solve_auto(instance: GridInstance, seed: int, clock: PlanningClock) -> _Solution:
    """PIBT's first plan if none is shorter; else the best of RTH3D-LBA and PIBT.

    Where the highways do not fit, the best of LaCAM* and PIBT. Then what `_shorten` finds.
    """
    try:
        choose_highways(instance)
        search = PibtSearch(instance, seed, clock)
        with clock.phase("pibt, to the lower bound") as record:
            shortest = search.attempt()
            record(search.reached)
        if shortest is not None:
            return _Solution(shortest, "pibt", None)
        found = sure = _solve_rth3d_lba(instance, seed, clock)
    except NoHighways:
        return _solve_off_highways(instance, seed, clock)
    if sure.makespan > instance.lower_bound:
        with suppress(PlanTimeout):
            best = _search(search, clock, sure.makespan)
            if best is not None:
                found = _Solution(best, "pibt", None)
            found = _shorten(instance, seed, clock, found)
    return replace(found, bound=sure.bound)


def _solve_off_highways(instance: GridInstance, seed: int, clock: PlanningClock) -> _Solution:
    """LaCAM* if it finds a plan, and what PIBT finds that is shorter."""
    found, failed = None, None
    try:
        found = _solve_lacam(instance, seed, clock.halved())
    except NoPlanExists:
        raise
    except (PlanNotFound, PlanTimeout) as error:
        failed = error
    known = None if found is None else found.makespan
    if known is None or known > instance.lower_bound:
        with suppress(PlanTimeout):
            best = _search(PibtSearch(instance, seed, clock), clock, known)
            if best is not None:
                found = _Solution(best, "pibt", None)
    if found is None:
        assert failed is not None
        raise failed
    with suppress(PlanTimeout):
        found = _shorten(instance, seed, clock, found)
    return found


METHODS: Mapping[str, Solver] = {
    "rth3d": partial(_rth3d, name="rth3d", match=partial(assign_levels, bounded=False)),
    "rth3d-lba": _solve_rth3d_lba,
    "rth3d-lba-paper": partial(
        _rth3d, name="rth3d-lba-paper", match=assign_levels_in_turn, balance=balance_by_distance
    ),
    "pibt": _solve_pibt,
    "lacam": _solve_lacam,
    "auto": _solve_auto,
}
"""Every method by its name."""


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
    """Plan collision-free paths on a 6-connected grid for robots that each have their own goal.

    Args:
        starts: (n, 3) integers, all different: the vertices (x, y, z) that the robots start at.
        goals: (n, 3) integers, all different: where each must get.
        shape: (m1, m2, m3), or (m1, m2) with (n, 2) starts and goals.
        obstacles: booleans of that shape, True anywhere, or for `"rth3d"` and `"rth3d-lba"` on
            whole columns at x = 3i + 1, y = 3j + 1; or None.
        method: `"rth3d"` (any matchings) and `"rth3d-lba"` (small shifts) always succeed up to
            `max_density(shape, obstacles)`; `"rth3d-lba-paper"` matches and balances as published;
            `"pibt"` takes any density and promises nothing; `"lacam"` takes any, too, and given
            enough configurations finds the shortest plan, or shows that none exists; `"auto"` is
            the best of `"rth3d-lba"` and `"pibt"`, or where the former does not fit, of `"lacam"`
            and `"pibt"`. If that is not near the lower bound, it also tries PIBT from both ends to
            places halfway, and negotiated congestion (PathFinder).
        seed: of the choices of PIBT and LaCAM*; the others make none. The same seed gives the same
            plan, unless a time limit cuts it short.
        time_limit: wall-clock limit, s, without compilation; a phase that has begun may exceed it.
            The best plan so far is returned; if there is none, PlanTimeout is raised.
        watch: called with the name of each phase when it begins.
        configurations: the maximum number that LaCAM* makes in each connected part of the grid.
            None: 1,000,000, or what fits into 0.8 GB. Without a time limit it makes as many again
            after its first plan to improve it, at least 1,000 (fewer for over 1,000 robots).

    Returns:
        A plan that `validate` has found feasible.

    Raises:
        ValueError: starts, goals, shape or obstacles are invalid, or the method cannot take them.
        NoPlanExists: the instance has no plan, which is proven; a ValueError and a PlanNotFound.
        PlanTimeout: the time ended before there was a valid plan.
        PlanNotFound: none was found, though there may be one.
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
        solution = _Solution(numbers(instance.starts, instance.shape)[None], "stay", 0)
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
