"""PettingZoo's contracts, all at once and in turns: its own tests, seeds, the same flight."""

from __future__ import annotations

import copy
import importlib
import warnings
from types import SimpleNamespace
from typing import Any

import numpy as np
import pettingzoo
import pytest
from pettingzoo.test import (
    api_test,
    max_cycles_test,
    parallel_api_test,
    render_test,
    seed_test,
    state_test,
)
from pettingzoo.utils.conversions import aec_to_parallel

from swarm_envs import TASKS, swap_v1
from swarm_envs.envs.parallel import RENDER_MODES, SwarmParallelEnv

DRONES = 3


def task_of(task: str, **options: Any) -> Any:
    """A task's two functions, with options that the tests of PettingZoo cannot give."""
    module = importlib.import_module(f"swarm_envs.{task}")
    given = {"num_drones": DRONES, "physics": "batch", **options}

    def named(make: Any) -> Any:
        return lambda max_cycles=None, **more: make(
            **given, **({} if max_cycles is None else {"horizon_s": max_cycles / 48}), **more
        )

    return SimpleNamespace(env=named(module.env), parallel_env=named(module.parallel_env))


def row(*numbers: float) -> np.ndarray:
    return np.array(numbers, np.float32)


@pytest.mark.parametrize("task", TASKS)
def test_pettingzoos_own_tests(task):
    module = task_of(task)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        parallel_api_test(module.parallel_env(), num_cycles=60)
        seed_test(module.env, num_cycles=30)
        max_cycles_test(module)
        warnings.filterwarnings("ignore", "Environment's m.* state space value is")  # no bounds
        state_test(module.env(), module.parallel_env(), num_cycles=20)
        warnings.filterwarnings("ignore", "Agent's m.*imum observation space value is")
        api_test(module.env(), num_cycles=60)


@pytest.mark.parametrize("action", ["acceleration", "rotors", "setpoint"])
def test_pettingzoos_test_of_every_action(engine, action):
    env = swap_v1.parallel_env(team="LS", physics=engine, action=action)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        parallel_api_test(env, num_cycles=300)
    env.close()
    env.close()


@pytest.mark.parametrize("task", TASKS)
def test_pettingzoos_render_test(task, monkeypatch):
    """In pictures alone: a window needs a display."""
    monkeypatch.setattr("swarm_envs.envs.parallel.RENDER_MODES", ("rgb_array",))
    assert RENDER_MODES[0] == "rgb_array"
    render_test(lambda render_mode: task_of(task).env(render_mode="rgb_array"))


def test_reset_without_a_seed_goes_on_with_the_generator():
    env = swap_v1.parallel_env(num_drones=2, physics="batch")
    starts = []
    for seed in (4, None, None, 4, None):
        env.reset(seed=seed)
        starts.append(env.view.state.position.copy())
    np.testing.assert_array_equal(starts[0], starts[3])
    np.testing.assert_array_equal(starts[1], starts[4])
    assert not np.array_equal(starts[0], starts[1])
    assert not np.array_equal(starts[1], starts[2])
    other = swap_v1.parallel_env(num_drones=2, physics="batch")
    other.reset()  # of no seed ever
    assert not any(np.array_equal(other.view.state.position, start) for start in starts)


def test_view_is_read_only():
    env = swap_v1.parallel_env(num_drones=2, physics="batch")
    env.reset(seed=1)
    view = env.view
    arrays = [*view.state, *view.setpoint, *view.reference(0.5), view.goals, view.oracle_force]
    for array in arrays:
        with pytest.raises(ValueError, match="read-only"):
            array[...] = 0.0


@pytest.mark.skipif(not hasattr(pettingzoo, "register"), reason="a PettingZoo without registry")
@pytest.mark.parametrize("task", TASKS)
def test_known_to_pettingzoo(task):
    env = pettingzoo.make("parallel", f"swarm_envs/{task}", num_drones=2, physics="batch")
    assert isinstance(env, SwarmParallelEnv) and env.metadata["name"] == task
    turns = pettingzoo.make("aec", f"swarm_envs/{task}", num_drones=2, physics="batch")
    assert turns.possible_agents == env.possible_agents
    assert isinstance(turns.unwrapped, SwarmParallelEnv)
    assert turns.state_space == env.state_space


def test_the_same_flight_as_the_parallel_environment(engine):
    """A whole episode: observations, rewards, ends, infos and states, to the last bit."""
    module = task_of("swap_v1", physics=engine, horizon_s=0.5)
    turns, parallel = module.env(), module.parallel_env()
    turns.reset(seed=4)
    rows, infos = parallel.reset(seed=4)
    rewards = dict.fromkeys(rows, 0.0)
    ends = cuts = dict.fromkeys(rows, False)
    rng = np.random.default_rng(0)
    agents = list(parallel.agents)
    while parallel.agents or turns.agents:
        actions = {}
        for agent in agents:
            assert turns.agent_selection == agent
            seen, reward, end, cut, info = turns.last()
            assert np.array_equal(seen, rows[agent]) and info == infos[agent]
            assert (reward, end, cut) == (rewards[agent], ends[agent], cuts[agent])
            assert np.array_equal(turns.state(), parallel.state())
            over = end or cut
            actions[agent] = None if over else rng.uniform(-0.3, 0.3, 3).astype(np.float32)
            turns.step(actions[agent])
        if parallel.agents:
            rows, rewards, ends, cuts, infos = parallel.step(actions)
    assert all(cuts.values()) and "episode_metrics" in infos["drone_0"]
    assert aec_to_parallel(turns) is turns.unwrapped
    turns.close()
    parallel.close()


def test_refusals():
    env = task_of("swap_v1", horizon_s=1 / 48).env()
    with pytest.raises(AttributeError, match="reset"):
        env.agents  # noqa: B018
    env.reset(seed=1)
    for _ in range(DRONES):
        env.step(row(0, 0, 0))
    with pytest.raises(ValueError, match="episode of 'drone_0' has ended; its only action is None"):
        env.step(row(0, 0, 0))


def test_copied_amid_a_round_of_decisions(engine):
    """Of which one has been made; tests/envs/test_interfaces.py copies between rounds."""
    env = task_of("swap_v1", physics=engine).env()
    env.reset(seed=2)
    for _ in range(DRONES * 5 + 1):
        env.step(row(0.2, -0.1, 0.1))
    twin = copy.deepcopy(env)
    for each in (env, twin):
        assert each.agent_selection == "drone_1"
        for _ in range(DRONES * 5):
            each.step(row(-0.2, 0.1, 0.1))
    assert np.array_equal(env.state(), twin.state())
    assert np.array_equal(env.observe("drone_2"), twin.observe("drone_2"))
    env.close()
    twin.close()
