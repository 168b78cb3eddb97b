"""Goals that are the starts reflected are balanced as their image, and nothing need be sorted."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest

from swarm_envs.baselines.rth3d import buildings, make_instance, plan
from swarm_envs.baselines.rth3d.grid import GridInstance, numbers, points
from swarm_envs.baselines.rth3d.highways import choose_highways
from swarm_envs.baselines.rth3d.symmetry import reflected, reflection

SHAPE = (12, 9, 5)


def flipped(where: np.ndarray, flips: tuple[bool, ...]) -> np.ndarray:
    return np.where(flips, np.array(SHAPE) - 1 - where, where).astype(np.int32)


def drawn(walls: np.ndarray) -> np.ndarray:
    free = np.argwhere(~walls).astype(np.int32)
    return np.random.default_rng(0).permutation(free)[: int(0.2 * walls.size)]


@pytest.mark.parametrize("flips", list(product((False, True), repeat=3)))
@pytest.mark.parametrize("walls", [np.zeros(SHAPE, dtype=bool), buildings(SHAPE)])
def test_reflected_goals_skip_the_first_shuffles(flips, walls):
    starts = drawn(walls)
    found = plan(starts, flipped(starts, flips), SHAPE, walls, method="rth3d-lba")
    steps = {phase.name: phase.makespan for phase in found.phases}
    if found.lower_bound:
        assert steps["heights"] == steps["rows"] == 0
        assert steps["balance starts"] == steps["balance goals"]


def test_of_several_reflections_the_one_that_fits_the_labels():
    rings = make_instance("rings", (12, 12, 6))  # any reflection keeps the set
    highways = choose_highways(rings)
    starts, goals = (numbers(p, rings.shape) for p in (rings.starts, rings.goals))
    image = reflection(highways, starts, goals)
    assert image is not None
    np.testing.assert_array_equal(image[starts], goals)


def test_paths_from_the_goals_are_images_whoever_stands_where():
    walls = np.zeros(SHAPE, dtype=bool)
    starts = drawn(walls)
    goals = np.random.default_rng(1).permutation(flipped(starts, (True, False, True)))
    highways = choose_highways(GridInstance(SHAPE, starts, goals, walls))
    first, last = numbers(starts, SHAPE), numbers(goals, SHAPE)
    image = reflection(highways, first, last)
    assert image is not None
    aside = points(first, SHAPE) + np.array([1, 0, 0])
    paths = np.stack([first, numbers(np.minimum(aside, np.array(SHAPE) - 1), SHAPE)])
    found = reflected(paths, image, last)
    np.testing.assert_array_equal(found[0], last)
    step = np.abs(points(found[1], SHAPE) - points(found[0], SHAPE)).sum(axis=1)
    assert set(step) <= {0, 1} and step.any()
    assert reflection(highways, first, np.sort(last)[::-1] ^ 1) is None


def test_point_mirrors_come_near_the_bound():
    ratios = []
    for shape in [(12, 6, 3), (24, 12, 6), (48, 24, 12)]:
        found = make_instance("mirror", shape, seed=1)
        ratios.append(plan(found.starts, found.goals, shape, method="rth3d-lba").ratio)
    assert ratios == sorted(ratios, reverse=True)
    assert ratios[-1] <= 1.15
