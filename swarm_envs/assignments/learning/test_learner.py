"""Run with `pytest`: checks that the learner can be graded. Points need more than this."""

import numpy as np
from learner import MyLearner

import swarm_envs
from swarm_envs.agents import fly_episode


def test_it_learns_for_a_while_and_flies():
    learner = MyLearner()
    learner.train(8.0)
    env = swarm_envs.make(
        "swap_v1", layout="random", num_drones=8, physics="batch", **MyLearner.requires
    )
    metrics = fly_episode(env, learner, seed=1)
    assert np.isfinite(metrics["length_s"])
