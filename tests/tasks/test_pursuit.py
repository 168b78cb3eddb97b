"""Pursuit: where goals are and what the score is, by plain geometry, seen from outside."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import swarm_envs
from swarm_envs.agents import load
from swarm_envs.envs.parallel import SwarmParallelEnv
from swarm_envs.state import FloatArray
from swarm_envs.tasks.obstacles import Column
from swarm_envs.tasks.pursuit import PURSUIT_LAYOUTS, PursuitTask
from swarm_envs.vehicles import parse_team
from tests.tasks.test_crowd import apart

every_layout = pytest.mark.parametrize("layout", PURSUIT_LAYOUTS)
AGENTS = {"moving": "tracking", "swap-goals": "straight-line+filter", "chase": "tracking"}


def pursuit(layout: str, agent: Any, **options: Any) -> SwarmParallelEnv:
    given = {"physics": "batch", "layout": layout, "num_drones": 4, "horizon_s": 7.0}
    return swarm_envs.make("pursuit_v0", **{**given, **agent.requires, **options})


def flown(layout: str, seed: int, **options: Any) -> tuple[FloatArray, FloatArray, dict[str, Any]]:
    """Positions (T, N, 3), goals (T, N, 3) after each decision, and the metrics at the end."""
    agent = load(AGENTS[layout])
    env = pursuit(layout, agent, **options)
    observations, _ = env.reset(seed=seed)
    agent.reset(env, seed)
    rows = [(env.view.state.position.copy(), env.view.goals.copy())]
    while env.agents:
        observations, *_, infos = env.step(agent.act(observations, env.view))
        rows.append((env.view.state.position.copy(), env.view.goals.copy()))
    metrics = next(iter(infos.values()))["episode_metrics"]
    env.close()
    return np.array([p for p, _ in rows]), np.array([g for _, g in rows]), metrics


@every_layout
def test_the_score_is_the_share_of_time_near_the_goals(layout):
    positions, goals, metrics = flown(layout, seed=2)
    near = np.linalg.norm(positions - goals, axis=-1)[1:] < 0.2
    assert metrics["length_s"] == pytest.approx(7.0)
    assert metrics["share_on_goal"] == pytest.approx(near.mean())
    assert 0.1 < near.mean() <= 1.0
    least = 0.5 if layout == "swap-goals" else 0.9
    assert metrics["success"] == (near.mean() >= least and metrics["collided_drones"] == 0)


def test_progress_is_of_the_goal_that_was_had():
    """At a swap, too."""
    agent = load("straight-line+filter")
    env = pursuit("swap-goals", agent, change_s=1.0, horizon_s=2.5)
    observations, _ = env.reset(seed=0)
    agent.reset(env, 0)
    while env.agents:
        goals, before = env.view.goals.copy(), env.view.state.position.copy()
        observations, *_, infos = env.step(agent.act(observations, env.view))
        after = np.linalg.norm(env.view.state.position - goals, axis=1)
        covered = (np.linalg.norm(before - goals, axis=1) - after) / 2.0
        for i, info in enumerate(infos.values()):
            assert info["reward_terms"]["progress"] == pytest.approx(covered[i], abs=1e-12)


def test_who_ends_is_on_no_goal_any_more():
    """Everybody falls: what counts is the time before."""
    env = swarm_envs.make("pursuit_v0", physics="batch", num_drones=2, action="rotors")
    env.reset(seed=0)
    near = 0.0
    while env.agents:
        fly = set(env.agents)
        env.step({agent: np.full(4, -1.0) for agent in env.agents})
        away = np.linalg.norm(env.view.state.position - env.view.goals, axis=-1)
        near += sum(away[int(name[-1])] < 0.2 for name in fly & set(env.agents))
    metrics = env.core.metrics()
    assert metrics["collided_floor"] == 2 and not metrics["success"]
    assert metrics["share_on_goal"] == pytest.approx(near / 2 / (20.0 * 48))


@pytest.mark.parametrize("layout", ["moving", "chase"])
@pytest.mark.parametrize("n", [1, 8, 32])
def test_goals_on_ellipses_are_apart_inside_and_as_fast_as_drawn(layout, n):
    task = PursuitTask(parse_team("S" * n), layout=layout, speed_m_s=(1.0, 1.0))
    low, high = task.arena
    for seed in range(6):
        placed = task.place(np.random.default_rng(seed))
        start, goals, orbit, chased = placed.start, placed.goals, placed.orbit, placed.chased
        assert orbit is not None
        np.testing.assert_allclose(start, goals[0])
        assert n == 1 or apart(start) >= 0.4 - 1e-9
        assert (np.minimum(start - low, high - start) > 0.29).all()
        leads = np.ones(n, np.bool_) if chased is None else chased < 0
        assert leads.sum() == (n if layout == "moving" else 1)
        angles = np.linspace(0.0, 2.0 * np.pi, 2000)
        i = int(leads.argmax())
        way = np.outer(np.cos(angles), orbit.first[i]) + np.outer(np.sin(angles), orbit.second[i])
        speed = np.linalg.norm(np.diff(way, axis=0), axis=1) / (angles[1] / abs(orbit.rate[i]))
        assert speed.max() == pytest.approx(1.0, rel=0.04)  # or a little more, where it climbs
        carried = start - start[i] + orbit.center[i] + way[:, None]
        assert (np.minimum(carried - low, high - carried) > 0.29).all()


def test_chasers_goals_are_beside_others_wherever_these_are():
    agent = load("hover")
    env = pursuit("chase", agent, num_drones=6)
    env.reset(seed=4)
    start, goals = env.view.state.position.copy(), env.view.goals.copy()
    np.testing.assert_allclose(start, goals, atol=1e-9)
    chased = env.core.world.drones["chased"][0].astype(int)
    assert (chased >= 0).sum() == 5
    for i in range(6):  # nobody chases himself, not even over others
        seen = {i}
        while chased[i] >= 0:
            i = chased[i]
            assert i not in seen
            seen.add(i)
    follows = chased >= 0
    offset = (goals - start[chased])[follows]
    drift = {a: np.array([0.3, 0.1 * k, 0.0], np.float32) for k, a in enumerate(env.agents)}
    for _ in range(40):
        env.step(drift)
        state = env.view.state
        reference = env.view.reference(env.view.time)
        expected = state.position[chased][follows] + offset
        np.testing.assert_allclose(env.view.goals[follows], expected, atol=1e-12)
        np.testing.assert_array_equal(reference.velocity[follows], state.velocity[chased][follows])
    assert np.linalg.norm(env.view.state.position - start, axis=1).min() > 0.1


def test_goals_beside_others_are_drawn_free_of_obstacles():
    """Those of chasers move with whom they chase: where they are at the start is what counts."""
    task = PursuitTask(parse_team("SSSS"), layout="chase", obstacles=(Column((0.0, 0.0), 0.2),))
    for seed in range(5):
        start, *_ = task.place(np.random.default_rng(seed))
        assert (np.linalg.norm(start[:, :2], axis=1) > 0.2 + 0.15 + task.radius).all()


def test_swapped_goals_are_always_anothers():
    task = PursuitTask(parse_team("SSSSS"), layout="swap-goals", change_s=4.0)
    for seed in range(10):
        start, goals, *_ = task.place(np.random.default_rng(seed))
        assert goals.shape == (5, 5, 3) and apart(start) >= 0.4
        for before, after in zip([start, *goals], goals, strict=False):
            assert {tuple(p) for p in before} == {tuple(p) for p in after}
            assert (before != after).any(axis=1).all()
    given = goals[0] + [0.0, 0.0, 0.1]
    start, kept, *_ = task.place(np.random.default_rng(0), goal=given)
    np.testing.assert_array_equal(kept[0], given)
    _, seen, _ = flown("swap-goals", 0, change_s=2.0, horizon_s=7.0)
    changes = (np.diff(seen, axis=0) != 0.0).any(axis=-1)
    assert changes.all(axis=1).nonzero()[0].tolist() == [95, 191, 287]
    with pytest.raises(ValueError, match="in 'chase' goals move; leave it out"):
        PursuitTask(parse_team("S"), layout="chase").place(np.random.default_rng(0), goal=start[:1])
