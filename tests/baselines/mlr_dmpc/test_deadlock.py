"""Deadlocks: contact forces push, never pull; and who makes room for whom."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from swarm_envs.baselines.mlr_dmpc.mlr_dmpc_config import MlrDmpcConfig
from swarm_envs.baselines.mlr_dmpc.unit_planner import (
    NOBODY,
    SwarmSnapshot,
    deadlocked,
    next_detours,
    no_detours,
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


def test_nobody_makes_room_where_all_can_fly():
    swarm = snapshot([[0.0, 0.0, 1.0], [1.0, 0.0, 1.0]], [[1.0, 1.0, 1.0], [0.0, 1.0, 1.0]])
    detours = next_detours(no_detours(2), swarm, 20, CONFIG, np.random.default_rng(0))
    assert (detours.for_whom == NOBODY).all()
