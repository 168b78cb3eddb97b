"""Gates: who is in a gate, when it counts, and what the score is, seen from outside."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import swarm_envs
from swarm_envs.agents import load
from swarm_envs.envs.parallel import SwarmParallelEnv
from swarm_envs.tasks.gates import GatesTask
from swarm_envs.vehicles import parse_team

AGENT = load("straight-line")


def gates(**options: Any) -> SwarmParallelEnv:
    given = {"physics": "batch", "world": "ideal", "interactions": "none", "num_drones": 2}
    return swarm_envs.make("gates_v0", **{**given, **AGENT.requires, **options})


def test_columns_stand_between_posts_there_and_back():
    task = GatesTask(parse_team("SSS"), gap_m=(0.3, 0.4))
    tops, sides = set(), set()
    for seed in range(20):
        start, goals, *_ = task.place(np.random.default_rng(seed))
        assert goals.shape == (8, 3, 3)
        for column in (start, *goals):
            assert np.ptp(column[:, :2], axis=0).max() == 0.0
            gaps = np.diff(np.sort(column[:, 2]))
            assert gaps[0] == pytest.approx(gaps[1]) and 0.3 <= gaps[0] <= 0.4
            assert 0.4 <= column[:, 2].min() <= 0.8
            assert column[:, 2].argsort().tolist() == start[:, 2].argsort().tolist()
        np.testing.assert_array_equal(goals[:4], goals[:3:-1])
        for x, y in goals[:, 0, :2]:
            rows = task.obstacle_rows  # a column's begins with its kind and its centre
            beside = np.sort(np.hypot(x - rows[:, 1], y - rows[:, 2]))
            np.testing.assert_allclose(beside[:2], 0.35)
        tops.add(int(start[:, 2].argmax()))
        sides.add(float(start[0, 0]))
    assert tops == {0, 1, 2} and sides == {-1.65, 1.65}
    assert len(task.obstacles) == 8
    assert task.with_team(parse_team("LLL")).obstacles == task.obstacles


def test_a_gate_counts_when_all_are_in_it_at_once():
    env = gates()
    observations, _ = env.reset(seed=3)
    AGENT.reset(env, 3)
    places, passed, alone = env.core.world.goals[0].copy(), 0, 0
    while env.agents:
        np.testing.assert_array_equal(env.view.goals, places[passed])
        actions = AGENT.act(observations, None)
        if passed == 1 and env.view.time < 6.0:
            actions["drone_1"] = -np.clip(env.view.state.velocity[1], -0.2, 0.2).astype(np.float32)
        observations, _, ends, _, infos = env.step(actions)
        inside = np.linalg.norm(env.view.state.position - places[passed], axis=1) < 0.05
        alone += bool(inside[0] and not inside[1])
        passed += bool(inside.all())
        terms = infos["drone_0"]["reward_terms"]
        assert terms["success"] == (1.0 / 8.0 if inside.all() else 0.0)
    metrics = infos["drone_0"]["episode_metrics"]
    assert ends["drone_0"] and metrics["success"] and passed == 8 and alone > 20
    assert metrics["places_passed"] == 16
    assert metrics["gates_per_min"] == pytest.approx(8 / (metrics["length_s"] / 60.0))


def test_unfinished_slaloms_are_scored_by_the_clock():
    env = gates(horizon_s=5.0)
    observations, _ = env.reset(seed=3)
    AGENT.reset(env, 3)
    places, passed = env.core.world.goals[0].copy(), 0
    while env.agents:
        observations, *_, infos = env.step(AGENT.act(observations, None))
        away = np.linalg.norm(env.view.state.position - places[passed], axis=1)
        passed += bool((away < 0.05).all())
    metrics = infos["drone_0"]["episode_metrics"]
    assert not metrics["success"] and 1 <= passed < 8
    assert metrics["gates_per_min"] == pytest.approx(passed / (5.0 / 60.0))


def test_who_is_left_flies_on_and_counts_for_less():
    env = gates(horizon_s=20.0)
    observations, _ = env.reset(seed=3)
    AGENT.reset(env, 3)
    while env.agents:
        actions = AGENT.act(observations, None)
        if "drone_1" in env.agents:
            actions["drone_1"] = np.array([0.0, 0.0, -1.0], np.float32)
        observations, *_ = env.step(actions)
    metrics = env.core.metrics()
    assert metrics["collided_floor"] == 1 and not metrics["success"]
    assert metrics["places_passed"] == 8
    assert metrics["gates_per_min"] == pytest.approx(4 / (metrics["length_s"] / 60.0))


def test_what_it_refuses():
    with pytest.raises(ValueError, match=r"a column of 6 drones .* but must stay below 2\.2 m"):
        GatesTask(parse_team("SSSSSS"))
    with pytest.raises(ValueError, match="goals are the gates; leave it out"):
        GatesTask(parse_team("S")).place(np.random.default_rng(0), goal=np.ones((1, 3)))
