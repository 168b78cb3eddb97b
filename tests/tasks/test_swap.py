"""The two layouts of swap: where drones start, where they belong, what the reference does."""

from __future__ import annotations

import numpy as np
import pytest

from swarm_envs.state import FloatArray
from swarm_envs.tables import World
from swarm_envs.tasks.base import Placement, world_of
from swarm_envs.tasks.placing import arena_of, check_points, derangement, draw_apart
from swarm_envs.tasks.swap import SwapTask
from swarm_envs.trajectories import Reference
from swarm_envs.vehicles import parse_team

SEEDS = range(20)


def drawn(task: SwapTask, seed: int) -> Placement:
    return task.place(np.random.default_rng(seed))


def at(task: SwapTask, world: World, time: float) -> Reference:
    full = task.reference(world, np.array([time]))
    return Reference(*(array[0] for array in full))


@pytest.mark.parametrize("team", ["S", "LS", "SSL", "LSS*S", "SSSSS"])
def test_stacked_stands_on_a_cylinder_in_the_order_of_the_team(team):
    task = SwapTask(team=parse_team(team), layout="stacked")
    radii, gaps, times = [], [], []
    for seed in SEEDS:
        start, (goal,), duration, *_ = drawn(task, seed)
        radius = np.hypot(start[:, 0], start[:, 1])
        np.testing.assert_allclose(radius, radius[0], rtol=1e-12)
        assert start[-1, 2] == pytest.approx(0.8)
        if len(start) > 1:
            step = -np.diff(start[:, 2])  # from the top down
            np.testing.assert_allclose(step, step[0], rtol=1e-9)
            gaps.append(step[0])
        np.testing.assert_allclose(goal, start * [-1, -1, 1], atol=1e-12)  # the opposite side
        angle = np.sort(np.arctan2(start[:, 1], start[:, 0]) % (2 * np.pi))
        apart = np.diff([*angle, angle[0] + 2 * np.pi])
        np.testing.assert_allclose(apart, 2 * np.pi / len(start), atol=1e-9)
        radii.append(radius[0])
        times.append(duration)
        for points in (start, goal):
            check_points("start", points, np.full(len(start), 0.095), arena_of(len(start)))
    for values, low, high in ((radii, 0.5, 0.75), (gaps, 0.2, 0.3), (times, 3.0, 4.0)):
        if values:
            assert low <= min(values) < low + 0.2 * (high - low)
            assert high - 0.2 * (high - low) < max(values) <= high


def test_stacked_reference_aligns_all_half_way():
    """Of a line whose derivatives tests/tasks/test_motion.py compares with the formula."""
    task = SwapTask(team=parse_team("LSS"), layout="stacked")
    for seed in SEEDS:
        placement = drawn(task, seed)
        world = world_of(placement)
        middle = at(task, world, placement.duration / 2)
        np.testing.assert_allclose(middle.position[:, :2], 0.0, atol=1e-12)
        np.testing.assert_array_equal(at(task, world, 0.0).position, placement.start)
        np.testing.assert_array_equal(at(task, world, 99.0).position, placement.goals[0])


@pytest.mark.parametrize("n", [1, 2, 4, 16, 40])
def test_random_starts_are_apart_and_goals_deranged(n):
    task = SwapTask(team=parse_team("S" * n))
    grown = max(1.0, (n / 16) ** (1 / 3))
    np.testing.assert_allclose(task.arena, np.array([[-2, -2, 0], [2, 2, 2.5]]) * grown)
    for seed in SEEDS if n < 40 else range(3):
        start, (goal,), duration, *_ = drawn(task, seed)
        assert duration == 0.0
        assert start.shape == goal.shape == (n, 3)
        assert (np.abs(start[:, :2]) <= 2.0 * grown - 0.3).all()
        assert (start[:, 2] >= 0.5).all()
        assert (start[:, 2] <= 2.0 * grown).all()
        distance = np.linalg.norm(start[:, None] - start[None], axis=2) + 9.0 * np.eye(n)
        assert distance.min() >= 0.5
        own = np.linalg.norm(goal - start, axis=1)
        assert own.min() >= 0.5  # nobody is at its goal already
        if n > 1:
            places = np.argmin(np.linalg.norm(goal[:, None] - start[None], axis=2), axis=1)
            assert sorted(places) == list(range(n))
            np.testing.assert_array_equal(start[places], goal)


def test_random_fills_its_box():
    task = SwapTask(team=parse_team("SSSS"))
    points: FloatArray = np.concatenate([drawn(task, seed).start for seed in range(200)])
    np.testing.assert_allclose(points.min(axis=0), [-1.7, -1.7, 0.5], atol=0.05)
    np.testing.assert_allclose(points.max(axis=0), [1.7, 1.7, 2.0], atol=0.05)


def test_overfull_boxes_raise_instead_of_searching_for_ever():
    task = SwapTask(team=parse_team("S" * 16), spacing_m=2.0)
    with pytest.raises(RuntimeError, match=r"found room for \d+ of 16 drones 2.0 m apart .* use"):
        drawn(task, 0)


@pytest.mark.parametrize("n", [2, 3, 4])
def test_derangements_leave_nothing_in_its_place(n):
    rng = np.random.default_rng(0)
    orders = [tuple(derangement(rng, n)) for _ in range(300)]
    for order in orders:
        assert sorted(order) == list(range(n))
        assert all(order[i] != i for i in range(n))
    counts = [orders.count(order) for order in set(orders)]
    assert len(counts) == {2: 1, 3: 2, 4: 9}[n]  # each of them comes up, and about as often
    assert min(counts) > 0.5 * 300 / len(counts)


@pytest.mark.parametrize("side", [1.0, 3.0])
def test_points_drawn_in_blocks_are_those_drawn_one_by_one(side):
    """To the last bit, and the generator stands where it would."""
    ours, theirs = np.random.default_rng(3), np.random.default_rng(3)
    points = draw_apart(ours, [0, 0, 0], [side] * 3, 10, 0.4)
    expected: list[np.ndarray] = []
    while len(expected) < 10:
        candidate = np.zeros(3) + side * theirs.random(3)
        if all(((candidate - other) ** 2).sum() >= 0.4**2 for other in expected):
            expected.append(candidate)
    np.testing.assert_array_equal(points, expected)
    assert ours.bit_generator.state == theirs.bit_generator.state
