"""PIBT: crowds in which robots pushed each other to and fro, that go opposite ways, or near."""

from __future__ import annotations

import numpy as np
import pytest

from swarm_envs.baselines.rth3d import grid_planning, make_instance, plan, validate
from swarm_envs.baselines.rth3d.grid import check_instance, points
from swarm_envs.baselines.rth3d.grid_plan import PlanningClock
from swarm_envs.baselines.rth3d.negotiation import Negotiation
from swarm_envs.baselines.rth3d.pibt import Pibt
from swarm_envs.baselines.rth3d.pibt_search import halfway, search_halfway
from tests.baselines.rth3d.test_lacam import shortest_makespan


def first_attempt(instance, seed=0) -> tuple[int, int]:
    """Steps taken by PIBT without restarts, and the longest way left."""
    most = 2 * instance.lower_bound + 60
    pibt = Pibt(instance, most)
    pibt.reseed(np.random.default_rng(seed))
    return pibt.run(0, most, most, -1, lost=False)


def in_a_block(exchanged, side=5, margin=2):
    """Robots filling a cube inside a larger one, all at their goals but two, exchanged."""
    shape = (side + 2 * margin,) * 3
    starts = np.argwhere(np.ones((side,) * 3, dtype=bool)) + margin
    goals = starts.copy()
    first, second = ((starts == np.array(v) + margin).all(axis=1).argmax() for v in exchanged)
    goals[[first, second]] = goals[[second, first]]
    return check_instance(starts, goals, shape)


@pytest.mark.parametrize(
    ("exchanged", "most"),
    [
        ([(2, 2, 2), (3, 2, 2)], 8),
        ([(0, 0, 0), (0, 1, 0)], 8),
        ([(0, 2, 2), (4, 2, 2)], 12),
        ([(0, 0, 0), (4, 4, 4)], 18),
    ],
)
def test_two_robots_change_places_among_robots_at_their_goals(exchanged, most):
    """The one in the way steps aside instead of into the gap that the other has left."""
    for seed in range(20):
        steps, left = first_attempt(in_a_block(exchanged), seed)
        assert left == 0
        assert steps <= most


def test_two_robots_meet_in_a_lane_between_robots_at_their_goals():
    """They pass each other, each losing a few steps, not the length of the lane."""
    starts = np.argwhere(np.ones((20, 6, 2), dtype=bool))
    starts = starts[~((starts[:, 1] == 0) & (starts[:, 2] == 0))]
    lane = np.array([[0, 0, 0], [19, 0, 0]])
    starts, goals = np.vstack([lane, starts]), np.vstack([lane[::-1], starts])
    instance = check_instance(starts, goals, (20, 8, 4))
    for seed in range(20):
        steps, left = first_attempt(instance, seed)
        assert left == 0
        assert steps <= 19 + 8


@pytest.mark.parametrize("family", ["uniform", "quasi-random", "buildings"])
def test_no_seed_leaves_stragglers(family):
    for seed in range(8):
        instance = make_instance(family, (48, 24, 12), seed=seed)
        steps, left = first_attempt(instance, seed)
        assert left == 0
        assert steps <= 1.02 * instance.lower_bound


@pytest.mark.slow
@pytest.mark.parametrize("family", ["uniform", "quasi-random"])
def test_auto_is_no_lottery(family):
    for seed in range(30):
        instance = make_instance(family, (72, 36, 18), seed=seed)
        found = plan(**instance.fields(), seed=seed)
        assert found.winner == "pibt"
        assert found.ratio <= 1.02


def test_crowds_denser_than_highways_carry():
    """70 % of all vertices are taken."""
    for seed in range(4):
        rng = np.random.default_rng(seed)
        vertices = np.argwhere(np.ones((12, 9, 6), dtype=bool))
        count = int(0.7 * len(vertices))
        starts, goals = rng.permutation(vertices)[:count], rng.permutation(vertices)[:count]
        found = plan(starts, goals, (12, 9, 6), method="pibt", seed=seed)
        assert validate(found.paths, starts, goals, (12, 9, 6))
        assert found.ratio <= 1.4


def test_who_is_lost_wanders_out_of_a_narrow_passage():
    """A wall with a hole of one vertex: without wandering robots wait on both sides for ever."""
    walls = np.zeros((14, 9, 6), dtype=bool)
    walls[7] = True
    walls[7, 3, 0] = False
    solved = 0
    for seed in range(6):
        rng = np.random.default_rng(seed)
        free = np.argwhere(~walls)
        starts, goals = rng.permutation(free)[:20], rng.permutation(free)[:20]
        try:
            found = plan(starts, goals, walls.shape, walls, method="pibt", seed=seed)
        except RuntimeError:
            continue
        solved += 1
        assert validate(found.paths, starts, goals, walls.shape, walls)
    assert solved >= 4


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


def test_a_gain_by_places_halfway_is_kept_if_the_time_ends(monkeypatch):
    def search_to_the_end_of_time(instance, seed, clock, known):
        paths = search_halfway(instance, seed, clock, known)
        clock.deadline = 0.0
        return paths

    monkeypatch.setattr(grid_planning, "search_halfway", search_to_the_end_of_time)
    instance, clock = make_instance("ends", SHAPE), PlanningClock()
    best = grid_planning.rth3d_lba(instance, 0, clock)
    found = grid_planning._shorten(instance, 0, clock, best)
    assert found.method == "pibt halfway" and found.makespan < best.makespan


def test_negotiation_finds_what_is_asked_or_nothing():
    instance = make_instance("uniform", (12, 6, 3))
    for steps in range(instance.lower_bound, instance.lower_bound + 4):
        paths = Negotiation(instance, 0, PlanningClock(), 10**9).plan(steps)
        if paths is not None:
            assert len(paths) == steps + 1
            assert validate(points(paths, instance.shape), **instance.fields())
    assert paths is not None
    again = Negotiation(instance, 0, PlanningClock(), 10**9).plan(steps)
    assert again is not None and np.array_equal(paths, again)


def test_no_path_is_kept_of_what_has_no_plan_of_so_many_steps():
    """Two robots in a passage that is one wide cannot pass each other in any time."""
    ends = np.array([[0, 0, 0], [3, 0, 0]])
    instance = check_instance(ends, ends[::-1], (4, 1, 1))
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
    instance = check_instance(starts, goals, (4, 2, 1))
    least = shortest_makespan(instance)
    assert least is not None and instance.lower_bound <= least


def test_robots_that_exchange_places_in_a_line_need_two_steps_more():
    starts = np.array([[0, 0, 0], [3, 0, 0], [2, 1, 0]])
    goals = np.array([[3, 0, 0], [0, 0, 0], [2, 1, 0]])
    found = plan(starts, goals, (4, 2, 1))
    assert (found.lower_bound, found.makespan) == (5, 5)
