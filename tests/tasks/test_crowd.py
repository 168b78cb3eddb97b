"""Crowd: what counts as reached, what throughput is, and where sites are, by plain geometry."""

from __future__ import annotations

import dataclasses
from typing import Any, cast

import numpy as np
import pytest

import swarm_envs
from swarm_envs.agents import load
from swarm_envs.agents.evaluation import score_episodes
from swarm_envs.envs.parallel import SwarmParallelEnv
from swarm_envs.state import FloatArray
from swarm_envs.tasks.base import ByScore
from swarm_envs.tasks.crowd import CROWD_LAYOUTS, CrowdTask, crowd_obstacles, next_site
from swarm_envs.tasks.obstacles import Box, Column
from swarm_envs.vehicles import parse_team


def crowd(**options: Any) -> SwarmParallelEnv:
    return swarm_envs.make("crowd_v0", **{"physics": "batch", **options})


def apart(points: FloatArray) -> float:
    """Smallest distance between two of the points (N, 3)."""
    away = np.linalg.norm(points[:, None] - points, axis=-1)
    return float(away[np.triu_indices(len(points), 1)].min())


def beside(obstacle: Box | Column, points: FloatArray) -> FloatArray:
    """Level distance (N,) to an obstacle that reaches from floor to ceiling."""
    if isinstance(obstacle, Column):
        away: FloatArray = np.linalg.norm(points[:, :2] - obstacle.center, axis=1)
        return away - obstacle.radius
    low, high = np.array(obstacle.low[:2]), np.array(obstacle.high[:2])
    outside = np.maximum(np.maximum(low - points[:, :2], points[:, :2] - high), 0.0)
    return np.asarray(np.linalg.norm(outside, axis=1))


@pytest.mark.parametrize("layout", CROWD_LAYOUTS)
@pytest.mark.parametrize("n", [1, 16, 40])
def test_sites_are_apart_and_free(layout, n):
    task = CrowdTask(parse_team("S" * n), layout=layout)
    low, high = task.arena
    starts = []
    for seed in range(8):
        start, goals, *_ = task.place(np.random.default_rng(seed))
        sites = goals.reshape(-1, 3)
        assert len(sites) == 3 * n and apart(sites) >= 0.5
        assert {tuple(p) for p in start} <= {tuple(p) for p in sites}
        assert (sites[:, 2] >= 0.5).all()
        assert (np.minimum(sites - low, high - sites) >= 0.3 - 1e-9).all()
        for obstacle in task.obstacles:
            assert beside(obstacle, sites).min() >= 0.15 + task.radius[0]
        starts.append(start)
    spread = np.concatenate(starts).std(axis=0) / (high - low)
    if n > 1:
        assert (spread > [0.2, 0.2, 0.12]).all()  # of an even draw: 0.25, 0.25, 0.17


def test_density_is_that_of_sixteen():
    for layout in ("forest", "buildings"):
        few, many = (len(crowd_obstacles(layout, n)) for n in (16, 128))
        assert 4 <= many / few <= 7  # four times the ground
    given = Column((0.0, 0.0), 0.1)
    task = CrowdTask(parse_team("SSSS"), layout="open", obstacles=(given,))
    assert task.obstacles == task.with_team(parse_team("LLLL")).obstacles == (given,)
    forest = CrowdTask(parse_team("SSSS"))
    assert forest.with_team(parse_team("LLLL")).obstacles == forest.obstacles


@pytest.mark.parametrize("reach_m", [(1.0, 3.0), (1.0, 1.6)])
def test_goals_reached_are_counted_as_by_hand(reach_m):
    """Flown by a script, and followed from outside by positions and goals alone."""
    agent = load("straight-line+filter")
    env = crowd(num_drones=6, layout="open", reach_m=reach_m, horizon_s=10.0, **agent.requires)
    observations, _ = env.reset(seed=3)
    agent.reset(env, 3)
    core, count, by_reward = env.core, 0, 0.0
    sites = {tuple(p) for p in core.world.goals[0].reshape(-1, 3)}
    while env.agents:
        before = env.view.goals.copy()
        observations, _, _, _, infos = env.step(agent.act(observations, env.view))
        position, after = env.view.state.position, env.view.goals
        reached = np.linalg.norm(position - before, axis=1) < 0.15
        count += int(reached.sum())
        by_reward += sum(info["reward_terms"]["reached"] for info in infos.values())
        np.testing.assert_array_equal((after != before).any(axis=1), reached)
        assert {tuple(p) for p in after} <= sites and apart(after) >= 0.5
        free = core.world.goals[0, 1:].reshape(-1, 3)
        for i in reached.nonzero()[0]:
            assert env.view.reference(env.view.time).position[i].tolist() == after[i].tolist()
            away = np.linalg.norm(np.vstack([free, after[i]]) - position[i], axis=1)
            fits = (away >= reach_m[0]) & (away <= reach_m[1])
            assert fits[-1] or not fits.any() or tuple(before[i]) in {tuple(p) for p in free[fits]}
    metrics = infos["drone_0"]["episode_metrics"]
    assert metrics["goals_reached"] == count == by_reward > 10
    assert metrics["length_s"] == pytest.approx(10.0)
    assert metrics["throughput_per_min"] == pytest.approx(count / 6 / (10.0 / 60.0))
    report = score_episodes([{"seed": 3, "metrics": metrics, "act_us": [1]}])
    assert report["throughput_per_min"] == metrics["throughput_per_min"]


def test_the_next_site_is_free_and_any_of_those_within_reach():
    rng = np.random.default_rng(0)
    goals = rng.uniform(-2.0, 2.0, (3, 5, 3))
    flat, position = goals.reshape(-1, 3), np.zeros(3)
    away = np.linalg.norm(flat, axis=1)
    fits = {k for k in range(5, 15) if 1.0 <= away[k] <= 2.4}
    drawn = {int(next_site(position, goals, 1.0, 2.4, u)) for u in rng.uniform(size=300)}
    assert drawn == fits and 2 <= len(fits) < 10
    assert {int(next_site(position, goals, 9.0, 9.5, u)) for u in rng.uniform(size=300)} == set(
        range(5, 15)
    )


@pytest.mark.parametrize(("least", "won"), [(6.0, True), (60.0, False)])
def test_success_is_a_throughput_at_the_clock(least, won):
    task = CrowdTask(parse_team("S"), layout="open", success=ByScore(0.15, least))
    agent = load("straight-line")
    env = SwarmParallelEnv(task, crowd(horizon_s=10.0, **agent.requires).core.config)
    observations, _ = env.reset(seed=0)
    agent.reset(env, 0)
    while env.agents:
        observations, _, ends, truncations, infos = env.step(agent.act(observations, None))
    metrics = infos["drone_0"]["episode_metrics"]
    assert metrics["success"] is won and metrics["stages_reached"] == won
    assert truncations["drone_0"] and not ends["drone_0"]
    assert infos["drone_0"]["reward_terms"]["success"] == won


@pytest.mark.parametrize("on_contact", ["end_pair", "bounce"])
@pytest.mark.parametrize("task", ["crowd_v0", "pursuit_v0"])
def test_no_score_is_a_success_once_a_drone_is_hurt(task, engine, on_contact):
    """One of four is flown into the floor: no more is asked of the score than zero."""
    agent, given = load("hover"), {"physics": engine, "on_contact": on_contact}
    given |= {"num_drones": 4, "horizon_s": 3.0, **agent.requires}
    layout = "open" if task == "crowd_v0" else "moving"
    made = swarm_envs.make(task, layout=layout, **given)
    easy: Any = dataclasses.replace(cast(Any, made.core.task), success=ByScore(0.15, 0.0))
    for falls in (True, False):
        env = SwarmParallelEnv(easy, made.core.config)
        observations, _ = env.reset(seed=0)
        agent.reset(env, 0)
        while env.agents:
            actions = agent.act(observations, None)
            if falls and "drone_2" in actions:
                actions["drone_2"] = np.array([0.0, 0.0, -1.0], np.float32)
            observations, *_, infos = env.step(actions)
        metrics = infos["drone_0"]["episode_metrics"]
        assert (metrics["collided_floor"] == 1) is falls
        assert metrics["success"] is not falls and metrics["stages_reached"] == (not falls)
        assert infos["drone_0"]["reward_terms"]["success"] == (not falls)


def test_progress_is_of_the_goal_that_was_flown_to():
    """Also in the decision in which a goal is reached, after which the next is far."""
    agent = load("straight-line")
    env = crowd(num_drones=1, layout="open", **agent.requires)
    observations, _ = env.reset(seed=0)
    agent.reset(env, 0)
    places, seen = [env.view.state.position[0].copy()], 0
    while seen < 3:
        goal = env.view.goals[0].copy()
        observations, _, _, _, infos = env.step(agent.act(observations, None))
        places.append(env.view.state.position[0].copy())
        old, new = (np.linalg.norm(p - goal) for p in places[-2:])
        terms = infos["drone_0"]["reward_terms"]
        assert terms["progress"] == pytest.approx((old - new) / 2.0)
        seen += int(terms["reached"])
