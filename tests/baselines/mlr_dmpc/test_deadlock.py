"""Deadlocks: contact forces push, never pull; and who makes room for whom."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from swarm_envs.baselines.mlr_dmpc.mlr_dmpc_config import MlrDmpcConfig
from swarm_envs.baselines.mlr_dmpc.trajectory import Identity, hover
from swarm_envs.baselines.mlr_dmpc.unit_planner import (
    NOBODY,
    Planner,
    PlanningOptions,
    SwarmSnapshot,
    deadlocked,
    next_detours,
    no_detours,
    rank_by_priority,
    unbalanced,
)

CONFIG = MlrDmpcConfig()


def snapshot(positions: list[list[float]], targets: list[list[float]]) -> SwarmSnapshot:
    at = np.array(positions)
    return SwarmSnapshot(at, np.zeros_like(at), at, np.array(targets))


def test_contacts_push_but_do_not_pull():
    pull = np.array([1.0, 0.0, 0.0])
    assert unbalanced(pull, np.array([[-2.0, 0.0, 0.0]])) == pytest.approx(0.0)
    assert unbalanced(pull, np.array([[1.0, 0.0, 0.0]])) == pytest.approx(1.0)
    assert unbalanced(pull, np.array([[-1.0, 1.0, 0.0]])) == pytest.approx(np.sqrt(0.5))
    assert unbalanced(pull, np.array([[-1.0, 1.0, 0.0], [-1.0, -1.0, 0.0]])) == pytest.approx(0.0)
    assert unbalanced(pull, np.zeros((0, 3))) == 1.0


HEAD_ON = ([[0.0, 0.0, 1.0], [0.25, 0.0, 1.0]], [[1.0, 0.0, 1.0], [-1.0, 0.0, 1.0]])


def test_two_head_on_are_in_a_deadlock_and_two_back_to_back_are_not():
    ends, targets = np.array(HEAD_ON[0]), np.array(HEAD_ON[1])
    still = np.zeros(2)
    assert deadlocked(ends, still, targets, CONFIG).all()
    assert not deadlocked(ends, still, targets[::-1], CONFIG).any(), "unsigned it would be"
    assert not deadlocked(ends, still + 0.2, targets, CONFIG).any(), "they move"
    assert not deadlocked(ends * 2.0, still, targets, CONFIG).any(), "they do not touch"
    near = ends + np.array([[0.05, 0.0, 0.0], [-0.05, 0.0, 0.0]])
    assert not deadlocked(ends, still, near, CONFIG).any(), "they have all but arrived"


def test_a_drone_under_another_touches_as_far_as_theta_says():
    ends = np.array([[0.0, 0.0, 0.6], [0.0, 0.0, 2.1]])
    assert deadlocked(ends, np.zeros(2), ends[::-1], CONFIG).all()


def test_walls_push_too():
    ends, target = np.array([[2.0, 0.0, 1.0]]), np.array([[3.0, 0.0, 1.0]])
    assert deadlocked(ends, np.zeros(1), target, CONFIG).all()


def test_the_nearer_to_its_target_makes_room_sideways():
    swarm = snapshot(HEAD_ON[0], [[1.0, 0.0, 1.0], [-0.5, 0.0, 1.0]])
    detours = next_detours(no_detours(2), swarm, 20, CONFIG, np.random.default_rng(0))
    assert detours.for_whom.tolist() == [1, NOBODY] or detours.for_whom.tolist() == [NOBODY, 0]
    left = np.linalg.norm(swarm.targets - swarm.positions, axis=1)
    who = int(np.flatnonzero(detours.for_whom != NOBODY)[0])
    assert left[who] == left.min()
    assert np.linalg.norm((detours.targets[who] - swarm.positions[who])[1:]) > 0.1
    current = detours.current(swarm.targets)
    assert np.array_equal(current[1 - who], swarm.targets[1 - who])
    assert np.array_equal(current[who], detours.targets[who])


def test_whoever_rests_at_its_target_stays_and_the_other_steps_aside():
    swarm = snapshot(HEAD_ON[0], [[1.0, 0.0, 1.0], [0.25, 0.0, 1.0]])
    detours = next_detours(no_detours(2), swarm, 20, CONFIG, np.random.default_rng(0))
    assert detours.for_whom.tolist() == [0, NOBODY]


def test_detours_last_their_rounds_then_pause():
    swarm, rng = snapshot(*HEAD_ON), np.random.default_rng(0)
    detours = next_detours(no_detours(2), swarm, 20, CONFIG, rng)
    began = detours.since.max()
    busy = []
    for k in range(21, 40):
        detours = next_detours(detours, swarm, k, CONFIG, rng)
        busy.append(bool((detours.for_whom != NOBODY).any()) and detours.since.max() == began)
    assert sum(busy) == CONFIG.detour_rounds - 1 and busy[0]


def test_a_detour_ends_when_the_plan_that_it_was_for_ends_at_its_target():
    swarm, rng = snapshot(*HEAD_ON), np.random.default_rng(0)
    detours = next_detours(no_detours(2), swarm, 20, CONFIG, rng)
    stuck = int(detours.for_whom.max())
    ends = swarm.ends.copy()
    ends[stuck] = swarm.targets[stuck]
    assert (next_detours(detours, swarm, 21, CONFIG, rng).for_whom == stuck).any()
    free = next_detours(detours, swarm._replace(ends=ends), 21, CONFIG, rng)
    assert (free.for_whom == NOBODY).all()


@pytest.mark.parametrize(
    ("trigger", "ages", "first"),
    [
        ("DT", (1, 20), 0),
        ("HT", (1, 4), 1),
        ("WT", (1, 4), 0),
        ("WT", (1, 20), 1),
        ("RR", (1, 4), 1),
    ],
)
def test_who_is_planned_first_by_distance_and_rounds_since_the_last_plan(trigger, ages, first):
    """Distances are 2 m and 0.7 m: 2 x 1 < 0.7 x 4, but 2 x 5 > 0.7 x 8 and 2 x 5 < 0.7 x 24."""
    places, targets = np.array([[-1.5, 0.0, 1.0], [1.5, 0.0, 1.0]]), np.zeros((2, 3))
    targets[:] = [[0.5, 0.0, 1.0], [1.5, 0.7, 1.0]]
    flown = [
        replace(hover(place, 15, 0.2), identity=Identity(21 - age, 0))
        for place, age in zip(places, ages, strict=True)
    ]
    options = PlanningOptions(config=CONFIG, num_drones=2, num_units=1, trigger=trigger)
    assert rank_by_priority(Planner(options).prioritise(flown, targets, 20), 20)[0] == first


def test_places_are_in_the_box_and_depend_on_the_seed_alone():
    box = ((-0.3, -0.3, 0.8), (0.6, 0.3, 1.2))
    config = replace(CONFIG, box=box, detour_noise_m=1.0)
    swarm = snapshot(*HEAD_ON)
    places = [
        next_detours(no_detours(2), swarm, 9, config, np.random.default_rng(s)).targets
        for s in (0, 0, 1)
    ]
    assert np.array_equal(places[0], places[1]) and not np.array_equal(places[0], places[2])
    used = places[0][np.any(places[0] != 0.0, axis=1)]
    assert (used >= np.array(box[0])).all() and (used <= np.array(box[1])).all()
