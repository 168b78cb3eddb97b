"""RTH3D-LBA as published: its assignments against brute force, its balancing against scipy's."""

from __future__ import annotations

from itertools import permutations

import numpy as np
import pytest
from scipy.optimize import linear_sum_assignment

from swarm_envs.baselines.rth3d import building_columns, make_instance, plan, validate
from swarm_envs.baselines.rth3d.grid import points
from swarm_envs.baselines.rth3d.paper_lba import (
    assign_levels_in_turn,
    balance_by_distance,
)
from swarm_envs.baselines.rth3d.ways import neighbor_table, ways_to


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
        costs = ways_to(table, np.flatnonzero(slots).astype(np.int32))[:, starts]
        least = int(costs[linear_sum_assignment(costs)].sum())
        assert int((paths[1:] != paths[:-1]).sum()) == least
        again = balance_by_distance(table, starts[::-1].copy(), slots)
        assert np.array_equal(again[:, ::-1], paths)  # labels decide nothing


def test_it_matches_as_the_paper_and_is_longer_than_ours():
    instance = make_instance("uniform", (48, 24, 12), seed=1)
    given = (instance.starts, instance.goals, instance.shape)
    paper, ours, plain = (
        float(plan(*given, method=name).before_compaction or 0) / instance.lower_bound
        for name in ("rth3d-lba-paper", "rth3d-lba", "rth3d")
    )
    assert 1.4 < ours < paper < plain
