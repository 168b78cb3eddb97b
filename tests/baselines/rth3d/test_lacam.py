"""LaCAM* is complete, in the end optimal; RTH3D-LBA as published, against brute force and scipy."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import permutations, product

import numpy as np
import pytest
from scipy.optimize import linear_sum_assignment

from swarm_envs.baselines.rth3d import (
    NoPlanExists,
    PlanNotFound,
    PlanTimeout,
    building_columns,
    grid_planning,
    make_instance,
    plan,
    unlabeled_mrpp,
    validate,
)
from swarm_envs.baselines.rth3d.grid import GridInstance, check_instance, numbers, points
from swarm_envs.baselines.rth3d.lacam import Lacam
from swarm_envs.baselines.rth3d.paper_lba import assign_levels_in_turn, balance_by_distance
from swarm_envs.baselines.rth3d.path_lengths import neighbor_table, path_lengths_to
from tests.baselines.rth3d.cases import between, load_checker, maze


def solve(instance: GridInstance, method: str = "lacam", **options):
    return plan(**instance.fields(), method=method, **options)


def shortest_makespan(instance: GridInstance) -> int | None:
    """By breadth-first search over all configurations; None if there is no plan."""
    steps = [
        [int(u) for u in row if u >= 0]
        for row in neighbor_table(instance.shape, instance.obstacles)
    ]
    start, goal = (
        tuple(numbers(p, instance.shape).tolist()) for p in (instance.starts, instance.goals)
    )
    known, level, count = {start}, [start], 0
    while level:
        if goal in known:
            return count
        following = []
        for here in level:
            for there in product(*(steps[v] for v in here)):
                moves = set(zip(here, there, strict=True))
                swap = any(u != v and (v, u) in moves for u, v in moves)
                if len(set(there)) == len(there) and not swap and there not in known:
                    known.add(there)
                    following.append(there)
        level, count = following, count + 1
    return None


def tiny_instance(seed: int) -> GridInstance:
    """Up to four robots on at most nine vertices, some of them obstacles."""
    generator = np.random.default_rng(seed)
    while True:
        shape = [(2, 2, 2), (3, 3, 1), (3, 2, 1), (5, 2, 1), (6, 1, 1), (2, 1, 3)][seed % 6]
        walls = generator.random(shape) < generator.choice([0.0, 0.2, 0.35])
        free = np.argwhere(~walls)
        if len(free) >= 2:
            count = int(generator.integers(1, min(4, len(free)) + 1))
            starts, goals = (generator.permutation(free)[:count] for _ in range(2))
            return check_instance(starts, goals, shape, walls)


def test_it_finds_the_shortest_plan_or_shows_that_there_is_none():
    found = {True: 0, False: 0}
    for seed in range(72):
        instance = tiny_instance(seed)
        best = shortest_makespan(instance)
        found[best is not None] += 1
        if best is None:
            for method in ("lacam", "auto"):
                with pytest.raises(NoPlanExists, match="no plan exists"):
                    solve(instance, method, seed=seed)
            continue
        assert solve(instance, seed=seed, configurations=1_000_000).makespan == best
        for method in ("lacam", "auto"):
            assert instance.lower_bound <= best <= solve(instance, method, seed=seed).makespan
    assert min(found.values()) >= 15


def test_plans_get_shorter_with_more_configurations_and_do_not_depend_on_pauses():
    instance = between(maze(11, np.random.default_rng(4)), 4, np.random.default_rng(4))
    whole, paused = Lacam(instance, 0), Lacam(instance, 0)
    lengths = []
    for most in range(0, 100_000, 500):
        paused.run(most)
        lengths.append(paused.steps or 1_000_000)
        if paused.exhausted:
            break
    while not whole.exhausted and whole.made < paused.made:
        whole.run(paused.made)
    assert paused.paths().tobytes() == whole.paths().tobytes()
    assert lengths == sorted(lengths, reverse=True) and lengths[-1] < lengths[1]
    assert validate(points(whole.paths(), instance.shape), **instance.fields())


def mazes(seed: int) -> Iterator[GridInstance]:
    generator = np.random.default_rng(seed)
    yield between(maze(31, generator), 1, generator)
    for count in (5, 10, 20):
        yield between(maze(17, generator), count, generator)


def holes(seed: int) -> Iterator[GridInstance]:
    """Walls with few one-vertex holes, 60 robots."""
    generator = np.random.default_rng(seed)
    for count in (1, 2, 4):
        walls = np.zeros((24, 12, 6), dtype=bool)
        walls[12] = True
        walls[12].flat[generator.permutation(72)[:count]] = False
        yield between(walls, 60, generator)


def clutter(seed: int) -> Iterator[GridInstance]:
    generator = np.random.default_rng(seed)
    for share in (0.1, 0.2, 0.3):
        for shape, count in (((32, 32, 1), 100), ((48, 48, 1), 225), ((24, 12, 6), 300)):
            yield between(generator.random(shape) < share, count, generator)


def crowds(seed: int) -> Iterator[GridInstance]:
    for density in (0.4, 0.6, 0.8, 0.95):
        yield make_instance("uniform", (12, 9, 6), int(648 * density), seed)


@pytest.mark.parametrize("family", [mazes, holes, clutter, crowds])
@pytest.mark.parametrize("method", ["lacam", "auto"])
def test_it_solves_what_pibt_alone_does_not(family, method, shared_data):
    checker = load_checker(shared_data)
    for instance in family(0):
        found = solve(instance, method)
        assert checker(found, found.paths)["ok"]
        assert instance.lower_bound <= found.makespan


def test_on_a_line_and_around_a_ring_nobody_passes_anybody():
    line = np.ones((200, 3, 1), dtype=bool)
    line[:, 1] = False
    ends = np.array([[0, 1, 0], [199, 1, 0]])
    for method in ("lacam", "auto"):
        with pytest.raises(NoPlanExists, match=r"a line of 200 vertices .* robots 0 and 1 would"):
            plan(ends, ends[::-1], line.shape, line, method=method)
    walls = np.zeros((5, 5, 1), dtype=bool)
    walls[1:4, 1:4] = True
    ring = np.array([[0, 0], [0, 4], [4, 4], [4, 0]])
    assert plan(ring, np.roll(ring, 1, axis=0), (5, 5), walls).makespan == 4
    with pytest.raises(NoPlanExists, match="a ring of 16 vertices"):
        plan(ring, ring[[1, 0, 2, 3]], (5, 5), walls)


def test_rooms_are_searched_one_by_one():
    """That robots in a small room are stuck is found at once, whoever is elsewhere."""
    walls = np.zeros((12, 8, 4), dtype=bool)
    walls[4] = True
    free = np.argwhere(~walls)
    crowd = free[free[:, 0] > 4]
    starts, goals = (np.random.default_rng(k).permutation(crowd)[:150] for k in (0, 1))
    corner = np.array([[0, 0, 0], [3, 7, 3]])
    found = plan(np.vstack([starts, corner]), np.vstack([goals, corner[::-1]]), walls.shape, walls)
    assert validate(found.paths, found.starts, found.goals, walls.shape, walls)
    walls[:4] = True
    walls[0, :3, 0] = walls[0, 1, 1] = False  # a T, full
    full = np.argwhere(~walls[:4])
    with pytest.raises(NoPlanExists, match="all moves of the 4 robots"):
        plan(np.vstack([starts, full]), np.vstack([goals, full[[1, 0, 2, 3]]]), walls.shape, walls)


def test_what_was_not_found_in_time_may_exist():
    instance = next(holes(0))
    with pytest.raises(PlanNotFound, match="within 20 configurations") as error:
        solve(instance, configurations=20)
    assert not isinstance(error.value, NoPlanExists)
    with pytest.raises(PlanTimeout):
        solve(instance, time_limit=1e-9)


def test_with_a_time_limit_the_search_goes_on_after_the_first_plans():
    """The 1,000 configurations after the first plan bind only where nothing else does."""
    instance = make_instance("uniform", (5, 5, 1), 20, seed=0)
    short, long = (solve(instance, time_limit=limit) for limit in (None, 1.0))
    assert long.lower_bound < long.makespan < short.makespan


def test_auto_falls_back_where_balancing_is_too_large(monkeypatch):
    monkeypatch.setattr(unlabeled_mrpp, "_MOST_NODES", 10)
    instance = make_instance("mirror", (12, 6, 3), seed=0)
    with pytest.raises(ValueError, match="too unevenly spread"):
        solve(instance, "rth3d-lba")
    monkeypatch.setattr(grid_planning, "_shorten", lambda *given: given[-1])
    assert solve(instance, "auto").winner in ("pibt", "lacam")


def test_no_plan_is_shorter_than_what_planes_let_through():
    """Robots in a block behind a hole of one vertex: they go through one after another."""
    walls = np.zeros((7, 3, 3), dtype=bool)
    walls[3] = True
    walls[3, 1, 1] = False
    left = np.argwhere(np.ones((3, 3, 3), dtype=bool))
    instance = check_instance(left, left + np.array([4, 0, 0]), walls.shape, walls)
    assert instance.lengths.max() == 8
    assert instance.lower_bound == 28  # 27 through the hole, and a last step
    assert solve(instance, "auto").makespan >= 28


def test_where_two_thirds_change_places_the_middle_bounds_the_plan():
    """Packed ends of a corridor: both directions share the edges between them."""
    starts = np.argwhere(np.ones((12, 2, 2), dtype=bool))
    starts = starts[(starts[:, 0] < 5) | (starts[:, 0] > 6)]
    goals = starts + np.where(starts[:, :1] < 5, 7, -7) * np.array([1, 0, 0])
    instance = check_instance(starts, goals, (12, 2, 2))
    assert instance.lengths.max() == 7
    assert instance.lower_bound == 12  # 40 robots over 4 edges, one step before and one behind


def worst_shift(levels, item_of, real) -> int:
    """The largest shift of the items (D, K) of matchings that are put on levels (D,)."""
    columns = range(item_of.shape[1])
    return max(
        abs(int(item_of[k, c]) - level) * int(real[c, item_of[k, c]])
        for k, level in enumerate(levels)
        for c in columns
    )


@pytest.mark.parametrize("seed", range(6))
def test_levels_are_matchings_on_their_best_heights(seed):
    generator = np.random.default_rng(seed)
    columns, size = 4, 3
    aims = generator.permutation(np.repeat(np.arange(columns), size)).reshape(1, columns, size)
    real = generator.random(aims.shape) < 0.8
    levels = assign_levels_in_turn(aims, real)[0]
    item_of = np.argsort(levels, axis=1).T  # (level, column)
    assert (np.sort(levels, axis=1) == np.arange(size)).all()
    for k in range(size):
        assert sorted(aims[0, range(columns), item_of[k]]) == list(range(columns))
    reached = worst_shift(range(size), item_of, real[0])
    assert reached == min(worst_shift(p, item_of, real[0]) for p in permutations(range(size)))


@pytest.mark.parametrize("obstacles", [False, True])
def test_balancing_has_the_least_distance(obstacles):
    shape = (9, 6, 3)
    walls = building_columns(shape) if obstacles else np.zeros(shape, dtype=bool)
    table = neighbor_table(shape, walls)
    sinks = np.zeros(shape, dtype=bool)
    sinks[1::3] = True
    slots = (sinks & ~walls).ravel()
    free = np.flatnonzero(~walls.ravel())
    for seed in range(10):
        starts = np.random.default_rng(seed).permutation(free)[:30].astype(np.int32)
        paths = balance_by_distance(table, starts, slots)
        ends = points(paths[-1], shape)
        assert validate(points(paths, shape), points(starts, shape), ends, shape, walls)
        assert slots[paths[-1]].all()
        costs = path_lengths_to(table, np.flatnonzero(slots).astype(np.int32))[:, starts]
        least = int(costs[linear_sum_assignment(costs)].sum())
        assert int((paths[1:] != paths[:-1]).sum()) == least
        again = balance_by_distance(table, starts[::-1].copy(), slots)
        assert np.array_equal(again[:, ::-1], paths)  # labels decide nothing


def test_it_matches_as_the_paper_and_is_longer_than_ours():
    instance = make_instance("uniform", (48, 24, 12), seed=1)
    paper, ours, plain = (
        float(solve(instance, name).before_compaction or 0) / instance.lower_bound
        for name in ("rth3d-lba-paper", "rth3d-lba", "rth3d")
    )
    assert 1.4 < ours < paper < plain
