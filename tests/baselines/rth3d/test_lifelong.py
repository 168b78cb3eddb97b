"""Goals after goals, and plans of which the sum of costs is small."""

from __future__ import annotations

import numpy as np
import pytest

from swarm_envs.baselines.rth3d import (
    NoPlanExists,
    make_instance,
    plan,
    plan_lifelong,
    validate,
)
from tests.baselines.rth3d.cases import between


def visits(paths: np.ndarray, goals: np.ndarray) -> int:
    """How many of a robot's goals (K, 3) a path (T + 1, 3) visits, in their order."""
    found = 0
    for place in paths:
        if found < len(goals) and (place == goals[found]).all():
            found += 1
    return found


@pytest.mark.parametrize("clutter", [False, True])
def test_every_robot_visits_its_goals_in_their_order(clutter):
    generator = np.random.default_rng(0)
    walls = generator.random((9, 9, 3)) < (0.1 if clutter else 0.0)
    instance = between(walls, 40, generator)
    free = np.argwhere(~walls)
    goals = free[generator.integers(len(free), size=(40, 3))]
    goals[:, 0] = instance.goals
    found = plan_lifelong(instance.starts, goals, walls.shape, 400, walls)
    assert [visits(found.paths[:, i], goals[i]) for i in range(40)] == found.reached.tolist()
    assert (found.reached == 3).all() and len(found.paths) < 401
    assert validate(found.paths, instance.starts, found.paths[-1], walls.shape, walls)
    assert found.throughput == pytest.approx(120 / (len(found.paths) - 1))


def test_a_goal_cut_off_or_of_another_shape_is_refused():
    wall = np.zeros((5, 1, 1), dtype=bool)
    wall[2] = True
    with pytest.raises(NoPlanExists, match="cannot get from"):
        plan_lifelong([[0, 0, 0]], [[[1, 0, 0], [4, 0, 0]]], (5, 1, 1), 9, wall)
    with pytest.raises(ValueError, match=r"goals have shape \(1, 3\), but must be \(1, K, 3\)"):
        plan_lifelong([[0, 0, 0]], [[1, 0, 0]], (5, 1, 1), 9)
    with pytest.raises(ValueError, match=r"goals\[0\]\[1\] is \(5, 0, 0\), which is outside"):
        plan_lifelong([[0, 0, 0]], [[[1, 0, 0], [5, 0, 0]]], (5, 1, 1), 9)


def test_a_flat_grid_and_goals_that_are_shared_or_given_again():
    found = plan_lifelong([[0, 0], [3, 0]], [[[3, 1], [3, 1]], [[3, 1], [0, 0]]], (4, 2), 30)
    assert found.paths.shape[2] == 3 and found.reached.tolist() == [2, 2]


@pytest.mark.parametrize("family", ["uniform", "shift"])
def test_the_sum_of_costs_falls_within_the_same_makespan(family):
    instance = make_instance(family, (12, 9, 6), seed=2)
    short, cheap = (
        plan(**instance.fields(), objective=name) for name in ("makespan", "sum_of_costs")
    )
    assert cheap.makespan <= short.makespan and cheap.check()
    least = instance.lengths.sum()
    assert all(found.sum_of_costs == found.check().sum_of_costs for found in (short, cheap))
    before, after = (found.sum_of_costs - least for found in (short, cheap))
    assert 0 <= after < 0.8 * before


def test_an_unknown_objective_is_refused():
    with pytest.raises(ValueError, match="objective"):
        plan([[0, 0]], [[1, 0]], (2, 2), objective="makspan")  # type: ignore[arg-type]


def test_a_detour_longer_than_the_grid_is_walked():
    """Walls that leave one way, to and fro; three steps of it are planned."""
    walls = np.zeros((9, 9, 1), dtype=bool)
    for k, x in enumerate(range(1, 9, 2)):
        walls[x] = True
        walls[x, 8 if k % 2 == 0 else 0] = False
    found = plan_lifelong([[0, 0, 0]], [[[8, 8, 0]]], (9, 9, 1), 3, walls)
    assert found.paths[:, 0, 1].tolist() == [0, 1, 2, 3] and found.reached.tolist() == [0]


@pytest.mark.slow
def test_a_robot_that_collides_a_thousand_times_on_its_way_has_a_cost():
    """Robots join a corridor one by one; costs in 32 bits overflowed."""
    length, count = 1300, 12
    walls = np.ones((length, count + 2, 1), dtype=bool)
    walls[:, 0] = False
    walls[1, : count + 1] = False
    starts = [*([1, k + 1, 0] for k in range(count)), [0, 0, 0]]
    goals = [[length - 1 - k, 0, 0] for k in range(count + 1)]
    found = plan(starts, goals, walls.shape, walls, objective="sum_of_costs")
    assert validate(found.paths, starts, goals, walls.shape, walls)
