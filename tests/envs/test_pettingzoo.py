"""PettingZoo's contract: its own test, spaces, seeds, the same bytes for the same seed."""

from __future__ import annotations

import warnings

import numpy as np
import pytest
from pettingzoo.test import parallel_api_test

from swarm_envs import swap_v0

STEPS = 500


@pytest.mark.parametrize("action", ["acceleration", "rotors", "setpoint"])
def test_api(engine, action):
    env = swap_v0.parallel_env(team="LS", physics=engine, action=action)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        parallel_api_test(env, num_cycles=300)
        env.reset(seed=5)
        parallel_api_test(env, num_cycles=100)
    env.close()


def test_reset_without_a_seed_goes_on_with_the_generator():
    env = swap_v0.parallel_env(num_drones=2, physics="batch")
    starts = []
    for seed in (4, None, None, 4, None):
        env.reset(seed=seed)
        starts.append(env.view.state.position.copy())
    np.testing.assert_array_equal(starts[0], starts[3])
    np.testing.assert_array_equal(starts[1], starts[4])
    assert not np.array_equal(starts[0], starts[1])
    assert not np.array_equal(starts[1], starts[2])


def test_unseeded_environments_differ():
    starts = []
    for _ in range(2):
        env = swap_v0.parallel_env(num_drones=2, physics="batch")
        env.reset()
        starts.append(env.view.state.position.copy())
    assert not np.array_equal(starts[0], starts[1])


def test_spaces_are_the_same_objects_at_every_call():
    env = swap_v0.parallel_env(num_drones=3, physics="batch")
    for agent in env.possible_agents:
        assert env.action_space(agent) is env.action_space(agent)
        assert env.observation_space(agent) is env.observation_space(agent)
    samples = [env.action_space(agent).sample() for agent in env.possible_agents]
    assert not np.array_equal(samples[0], samples[1])


def test_view_is_read_only():
    env = swap_v0.parallel_env(num_drones=2, physics="batch")
    env.reset(seed=1)
    view = env.view
    arrays = [*view.state, *view.setpoint, *view.reference(0.5), view.goals, view.oracle_force]
    for array in arrays:
        with pytest.raises(ValueError, match="read-only"):
            array[...] = 0.0


def test_render_and_close_twice():
    pytest.importorskip("pybullet")  # which draws
    env = swap_v0.parallel_env(team="LS", physics="batch", render_mode="rgb_array")
    env.reset(seed=1)
    picture = env.render()
    assert picture is not None
    assert picture.dtype == np.uint8
    assert picture.ndim == 3
    assert picture.shape[2] == 3
    assert len(np.unique(picture)) > 10  # something is in it
    env.close()
    env.close()
    silent = swap_v0.parallel_env(team="LS", physics="batch")
    silent.reset(seed=1)
    assert silent.render() is None
