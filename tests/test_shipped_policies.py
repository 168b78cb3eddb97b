"""The policies that ship for formations and rings: what they were made for, they do."""

from __future__ import annotations

import numpy as np
import pytest

from swarm_envs import formation_v0, ring_v0
from swarm_envs.agents import Agent, fly_episode, load
from swarm_envs.agents.evaluation import evaluate, frozen_seeds
from swarm_envs.envs.parallel import SwarmParallelEnv

SEEDS = frozen_seeds(11, 64)


def successes(env: SwarmParallelEnv, agent: Agent, seeds: list[int]) -> float:
    flown = evaluate(env, agent, seeds)
    return float(np.mean([episode["metrics"]["success"] for episode in flown]))


def formation(agent: Agent, layout: str, **options) -> SwarmParallelEnv:
    given = {"num_drones": 8, "layout": layout, "physics": "batch", **agent.requires, **options}
    return formation_v0.parallel_env(**given)


def test_places_that_were_matched_are_always_reached():
    agent = load("formation-ppo")
    env = formation(agent, "cube")
    assert successes(env, agent, SEEDS[:32]) == 1.0
    env.close()


def test_drawn_places_are_reached_far_more_often_than_straight_ahead():
    rates = []
    for name in ("formation-ppo", "straight-line"):
        agent = load(name)
        env = formation(agent, "shuffle", force_rate=48)
        rates.append(successes(env, agent, SEEDS))
        env.close()
    assert rates[0] > 0.6
    assert rates[0] > rates[1] + 0.25


def test_who_hovers_below_others_is_held_up_against_their_downwash():
    """The set-point hangs above a drone of the lower layer, where the uncompensated one sinks."""
    agent = load("formation-ppo")
    env = formation(agent, "cube", end_on_success=False, horizon_s=8.0)
    fly_episode(env, agent, seed=0)
    position, goal = env.view.state.position, env.view.goals
    lower = goal[:, 2] < goal[:, 2].mean()
    assert lower.sum() == 4
    assert np.abs(position - goal).max() < 0.1
    lift = (env.view.setpoint.position - position)[:, 2]
    assert lift[lower].min() > 0.15 > np.abs(lift[~lower]).max()
    env.close()
    tracking = load("tracking")
    env = formation(tracking, "cube", end_on_success=False, horizon_s=8.0)
    fly_episode(env, tracking, seed=0)
    sunk = (env.view.goals - env.view.state.position)[lower, 2]
    assert sunk.min() > 0.1
    env.close()


def test_heights_on_rings_are_kept_better_than_without_compensation():
    worst = {}
    for name, count in (("ring-ppo", 8), ("tracking", 1)):
        agent = load(name)
        env = ring_v0.parallel_env(num_drones=5, physics="batch", **agent.requires)
        flown = [fly_episode(env, agent, seed) for seed in SEEDS[:count]]
        assert all(metrics["success"] for metrics in flown)
        worst[name] = max(metrics["worst_height_error_m"] for metrics in flown)
        env.close()
    assert worst["ring-ppo"] < 0.5 * worst["tracking"]
    assert worst["tracking"] == pytest.approx(0.09, abs=0.02)
