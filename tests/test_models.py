"""Models in memory as agents: Stable-Baselines3, torch modules, functions of rows."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from swarm_envs import swap_v1
from swarm_envs.agents import fly_episode, from_model, load
from swarm_envs.agents.evaluation import evaluate_agent
from swarm_envs.envs.parallel import SwarmParallelEnv
from swarm_envs.training import SharedPolicyVecEnv

torch = pytest.importorskip("torch", reason="the extra `train`")
pytest.importorskip("stable_baselines3", reason="the extra `train`")
OPTIONS: dict[str, Any] = {
    "num_drones": 2,
    "physics": "batch",
    "decision_rate": 10,
    "interactions": "none",
}


@pytest.fixture
def env() -> Iterator[SwarmParallelEnv]:
    made = swap_v1.parallel_env(**OPTIONS)
    yield made
    made.close()


@pytest.mark.parametrize("features", [False, True])
def test_a_model_of_stable_baselines3_flies_as_it_predicts(
    env: SwarmParallelEnv, features: bool
) -> None:
    from stable_baselines3 import PPO

    options = {k: v for k, v in OPTIONS.items() if k != "physics"}
    vec = SharedPolicyVecEnv("swap_v1", 2, seed=0, features=features, **options)
    model = PPO("MlpPolicy", vec, n_steps=8, batch_size=16, n_epochs=1, seed=0, device="cpu")
    agent = from_model(model, env)
    rows, _ = env.reset(seed=3)
    agent.reset(env, 3)
    given = np.stack([*agent.act(rows, None).values()])
    seen = vec.observe(np.stack([*rows.values()]))
    wanted, _ = model.predict(seen, deterministic=True)
    vec.close()
    np.testing.assert_allclose(given, np.clip(wanted, -1.0, 1.0), atol=1e-6)
    assert fly_episode(env, agent, 3)["length_s"] > 0.0


def test_a_module_and_a_function_fly_alike_and_in_batches(env: SwarmParallelEnv) -> None:
    width = env.core.rows.shape[-1]
    layer = torch.nn.Sequential(torch.nn.Linear(width, 3), torch.nn.Tanh())
    weight, bias = (p.detach().numpy() for p in layer[0].parameters())
    module = from_model(layer, env)
    function = from_model(lambda rows: np.tanh(rows @ weight.T + bias), env)
    seeds = [1, 2, 3]
    found = [[e["metrics"] for e in evaluate_agent(env, a, seeds)] for a in (module, function)]
    for one, other in zip(*found, strict=True):
        assert one["length_s"] == other["length_s"]
        assert one["success"] == other["success"]


def test_what_is_no_model_is_refused(env: SwarmParallelEnv) -> None:
    with pytest.raises(TypeError, match="model is 3, but must be a model of Stable-Baselines3"):
        from_model(3, env)
    with pytest.raises(
        ValueError, match="env has observation='dict', but agents of models need flat"
    ):
        from_model(len, swap_v1.parallel_env(**OPTIONS, observation="dict"))
    with pytest.raises(ValueError, match="model must be a function of rows, but its signature"):
        from_model(lambda rows, view: rows[:, :3], env)
    agent = from_model(lambda rows: rows[:1, :3], env)
    env.reset(seed=0)
    with pytest.raises(ValueError, match="must return one row of actions for each row"):
        fly_episode(env, agent, 0)


def test_a_model_of_other_rows_is_refused(env: SwarmParallelEnv) -> None:
    from stable_baselines3 import PPO

    options = {k: v for k, v in OPTIONS.items() if k != "physics"}
    vec = SharedPolicyVecEnv("swap_v1", 1, seed=0, num_neighbors=2, **options)
    model = PPO("MlpPolicy", vec, n_steps=8, batch_size=16, device="cpu")
    with pytest.raises(ValueError, match=r"the model observes \(\d+,\), but rows"):
        from_model(model, env)
    vec.close()


def test_observations_are_normalized_as_in_training(env: SwarmParallelEnv) -> None:
    from stable_baselines3 import PPO
    from stable_baselines3.common.vec_env import VecNormalize

    options = {k: v for k, v in OPTIONS.items() if k != "physics"}
    vec = VecNormalize(SharedPolicyVecEnv("swap_v1", 2, seed=0, **options))
    model = PPO("MlpPolicy", vec, n_steps=8, batch_size=16, n_epochs=1, seed=0, device="cpu")
    model.learn(64)
    rows, _ = env.reset(seed=3)
    stacked = np.stack([*rows.values()])
    given = from_model(model, env).act_batch(stacked)
    wanted, _ = model.predict(vec.normalize_obs(stacked), deterministic=True)
    np.testing.assert_allclose(given, np.clip(wanted, -1.0, 1.0), atol=1e-6)
    vec.close()


def test_a_function_of_a_file_is_an_agent(env: SwarmParallelEnv, tmp_path: Path) -> None:
    file = tmp_path / "mine.py"
    file.write_text("def still(rows):\n    return 0.0 * rows[:, :3]\n")
    agent = load(f"{file}:still")
    assert fly_episode(env, agent, 0)["length_s"] > 0.0
    with pytest.raises(ValueError, match="from_model"):
        load(tmp_path / "model.zip")
