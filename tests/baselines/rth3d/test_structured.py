"""Crowds that go opposite ways, or from where they stand close to where they will."""

from __future__ import annotations

import numpy as np
import pytest

from swarm_envs.baselines.rth3d import make_instance, plan, validate
from swarm_envs.baselines.rth3d.grid import GridInstance, check_instance
from swarm_envs.baselines.rth3d.grid_plan import PlanningClock
from swarm_envs.baselines.rth3d.negotiation import Negotiation
from swarm_envs.baselines.rth3d.pibt_search import halfway
from tests.baselines.rth3d.test_lacam import shortest_makespan

SHAPE = (24, 12, 6)


@pytest.mark.parametrize(
    ("family", "most"), [("shift", 1.3), ("reflection", 1.3), ("layers", 1.2), ("ends", 1.2)]
)
@pytest.mark.parametrize("axes", [(0, 1, 2), (1, 2, 0), (2, 0, 1)])
def test_those_who_go_opposite_ways_pass_each_other(family, most, axes):
    """Along each axis: the instance is turned."""
    instance = make_instance(family, SHAPE)
    shape = tuple(SHAPE[k] for k in axes)
    found = plan(instance.starts[:, axes], instance.goals[:, axes], shape)
    assert found.ratio <= most, found.ratio


def test_places_halfway_are_between_and_differ():
    instance = make_instance("ends", SHAPE, seed=1)
    starts, goals = instance.starts, instance.goals
    middle = halfway(instance)
    assert len(np.unique(middle, axis=0)) == len(starts)
    assert (middle >= 0).all() and (middle < SHAPE).all()
    longest = [np.abs(middle - ends).sum(axis=1).max() for ends in (starts, goals)]
    assert max(longest) < instance.lower_bound
    counts = np.bincount(middle[:, 0], minlength=SHAPE[0])
    assert counts.max() - counts.min() <= 1


def test_negotiation_finds_what_is_asked_or_nothing():
    instance = make_instance("uniform", (12, 6, 3))
    starts, goals = instance.starts, instance.goals
    for steps in range(instance.lower_bound, instance.lower_bound + 4):
        paths = Negotiation(instance, 0, PlanningClock(), 10**9).plan(steps)
        if paths is not None:
            assert len(paths) == steps + 1
            places = np.stack(np.unravel_index(paths, (12, 6, 3)), axis=-1)
            assert validate(places, starts, goals, (12, 6, 3))
    assert paths is not None
    again = Negotiation(instance, 0, PlanningClock(), 10**9).plan(steps)
    assert again is not None and np.array_equal(paths, again)


def test_no_path_is_kept_of_what_has_no_plan_of_so_many_steps():
    """Two robots in a passage that is one wide cannot pass each other in any time."""
    instance = GridInstance(
        (4, 1, 1),
        np.array([[0, 0, 0], [3, 0, 0]]),
        np.array([[3, 0, 0], [0, 0, 0]]),
        np.zeros((4, 1, 1), dtype=bool),
    )
    assert Negotiation(instance, 0, PlanningClock(), 10**9).plan(9) is None


@pytest.mark.parametrize("seed", range(8))
def test_the_bound_for_passing_within_a_line_is_not_above_the_optimum(seed):
    """On small grids with robots that stay in their lines; the optimum is by exhaustive search."""
    generator = np.random.default_rng(seed)
    starts = generator.permutation(np.argwhere(np.ones((4, 2, 1), dtype=bool)))[:3]
    goals = starts.copy()
    for y in range(2):
        line = starts[:, 1] == y
        goals[line, 0] = generator.permutation(4)[: line.sum()]
    instance = check_instance(starts, goals, (4, 2, 1), None)
    least = shortest_makespan(instance)
    assert least is not None and instance.lower_bound <= least


def test_robots_that_exchange_places_in_a_line_need_two_steps_more():
    starts = np.array([[0, 0, 0], [3, 0, 0], [2, 1, 0]])
    goals = np.array([[3, 0, 0], [0, 0, 0], [2, 1, 0]])
    found = plan(starts, goals, (4, 2, 1))
    assert (found.lower_bound, found.makespan) == (5, 5)
