"""Run with `pytest`: checks that the agent can be graded. Points need more than this."""

import numpy as np
from swap import MyAgent

import swarm_envs
from swarm_envs.agents import fly_episode


def test_it_flies_an_episode():
    options = {"layout": "random", "team": "SSSSSSSSLLLLLLLL", "physics": "batch"}
    env = swarm_envs.make("swap_v1", **options, **MyAgent.requires)
    metrics = fly_episode(env, MyAgent(), seed=1)
    assert metrics["length_s"] > 0.5


def test_a_drone_alone_accelerates_toward_its_goal():
    agent = MyAgent()
    env = swarm_envs.make("swap_v1", num_drones=1, physics="batch", **MyAgent.requires)
    rows, _ = env.reset(seed=0)
    agent.reset(env, 0)
    (action,) = agent.act(rows, None).values()
    (row,) = rows.values()
    assert np.dot(action, row[agent.at["task.goal"]]) > 0.0
