"""RLlib trains one policy for all drones, which flies as any other."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from swarm_envs import swap_v1
from swarm_envs.agents import load
from swarm_envs.agents.features import features_of
from swarm_envs.agents.networks import Network
from swarm_envs.agents.policy import Policy, PolicyAgent
from swarm_envs.cli import main

pytest.importorskip("ray.rllib", reason="run by `make test-compat`")

import ray
import torch
from ray.tune.registry import register_env

from examples import rllib_ppo
from examples.rllib_ppo import FeatureEnv, RllibConfig

pytestmark = [pytest.mark.slow, pytest.mark.filterwarnings("default")]


@pytest.fixture(scope="module")
def cluster():
    ray.init(num_cpus=1, include_dashboard=False, object_store_memory=10**8)
    yield
    ray.shutdown()


def tiny(out: Path) -> RllibConfig:
    size: dict[str, Any] = {"steps": 300, "batch": 120, "minibatch": 120, "passes": 1}
    return RllibConfig(
        out=out,
        drones=2,
        num_neighbors=1,
        interactions="none",
        evaluation_episodes=4,
        hidden=(8, 8),
        **size,
    )


@pytest.mark.parametrize("on_contact", ["end_team", "end_pair"])
def test_our_trainer_leaves_a_policy_that_evaluate_flies(
    cluster, tmp_path, monkeypatch, on_contact
):
    step, alone = FeatureEnv.step, []

    def watched(env, actions):
        given = step(env, actions)
        alone.append(len(env.agents) == 1)
        return given

    made = partial(swap_v1.parallel_env, on_contact=on_contact)
    monkeypatch.setattr(swap_v1, "parallel_env", made)
    monkeypatch.setattr(FeatureEnv, "step", watched)
    report = rllib_ppo.train_with_rllib(tiny(tmp_path / "run"))
    assert any(alone) == (on_contact == "end_pair")
    assert report["steps"] >= 300 and 0.0 <= report["chosen"]["random_success"] <= 1.0
    agent = load(str(tmp_path / "run"))
    assert isinstance(agent, PolicyAgent)
    assert agent.policy.provenance["steps"] == report["steps"]
    given = ["--drones", "2", "--episodes", "2", "--horizon-s", "0.5", "--interactions", "none"]
    assert main(["evaluate", "--agent", str(tmp_path / "run"), *given]) == 0


def test_the_policy_that_is_written_acts_as_rllib_s_module(cluster, tmp_path):
    config = tiny(tmp_path)
    register_env(rllib_ppo.ENVIRONMENT, rllib_ppo.make_env)
    algorithm = rllib_ppo.algorithm_config(config).build_algo()
    module = algorithm.get_module(rllib_ppo.SHARED)
    agent = PolicyAgent(Policy(config.note(), Network(rllib_ppo.actor(module, 3)), {}))
    env = swap_v1.parallel_env(num_drones=2, physics="batch", **agent.requires)
    rows = np.stack(list(env.reset(seed=3)[0].values()))
    told = features_of(rows, 1)
    assert told.shape[1] == config.note().sizes.width
    with torch.no_grad():
        given = module.forward_inference({"obs": torch.as_tensor(told)})["action_dist_inputs"]
    expected = np.clip(given[:, :3].numpy(), -1.0, 1.0)
    np.testing.assert_allclose(agent.act_batch(rows), expected, atol=1e-6)
    algorithm.stop()
