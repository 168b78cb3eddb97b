"""Run with `pytest`: checks that the controller can be graded. Points need more than this."""

from controller import MyController

import swarm_envs
from swarm_envs.agents import fly_episode


def test_it_flies_without_a_crash():
    options = {"layout": "stacked", "num_drones": 3, "world": "hall", "physics": "batch"}
    env = swarm_envs.make("swap_v1", **options, **MyController.requires)
    metrics = fly_episode(env, MyController(), seed=1)
    assert metrics["collided_drones"] + metrics["collided_floor"] + metrics["tumbled"] == 0
    assert metrics["worst_height_error_m"] < 0.3
