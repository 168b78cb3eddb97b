"""RLlib trains on every task: one iteration of PPO, one policy for all drones."""

from __future__ import annotations

import importlib
from typing import Any

import numpy as np
import pytest

from swarm_envs import TASKS

pytest.importorskip("ray.rllib", reason="run by `make test-compat`")

import ray
from ray.rllib.algorithms.ppo import PPOConfig
from ray.rllib.core.rl_module.default_model_config import DefaultModelConfig
from ray.rllib.env.wrappers.pettingzoo_env import ParallelPettingZooEnv
from ray.tune.registry import register_env

pytestmark = [pytest.mark.slow, pytest.mark.filterwarnings("default")]


def make(options: dict[str, Any]) -> ParallelPettingZooEnv:
    given = dict(options)
    module = importlib.import_module(f"swarm_envs.{given.pop('task')}")
    return ParallelPettingZooEnv(module.parallel_env(physics="batch", **given))


@pytest.fixture(scope="module")
def cluster():
    ray.init(num_cpus=1, include_dashboard=False, object_store_memory=10**8)
    register_env("swarm", make)
    yield
    ray.shutdown()


@pytest.mark.parametrize("task", TASKS)
def test_one_iteration_of_ppo(cluster, task):
    config = (
        PPOConfig()
        .environment("swarm", env_config={"task": task, "num_drones": 3, "horizon_s": 0.5})
        .env_runners(num_env_runners=0)
        .learners(num_learners=0)
        .training(train_batch_size=96, minibatch_size=48, num_epochs=1)
        .multi_agent(policies={"all"}, policy_mapping_fn=lambda agent, episode: "all")
        .rl_module(model_config=DefaultModelConfig(fcnet_hiddens=[32]))
        .debugging(seed=0)
    )
    algorithm = config.build_algo()
    before = algorithm.get_module("all").state_dict()
    before = {name: value.clone() for name, value in before.items()}
    result = algorithm.train()
    runners = result["env_runners"]
    assert runners["num_env_steps_sampled_lifetime"] >= 96
    assert np.isfinite(runners["episode_return_mean"]) and runners["episode_len_max"] <= 24
    after = algorithm.get_module("all").state_dict()
    assert any(not before[name].equal(value) for name, value in after.items())
    algorithm.stop()
