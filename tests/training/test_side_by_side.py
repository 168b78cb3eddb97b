"""Teams side by side fly as they would alone, and threads change nothing of what is learned."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("stable_baselines3")

import torch

from swarm_envs.training import SharedPolicyVecEnv
from swarm_envs.training.rl.config import TrainConfig
from swarm_envs.training.rl.ppo import PpoLearner
from swarm_envs.training.rl.recipes import completed
from swarm_envs.training.rl.side_by_side import SideBySide

OPTIONS = {"interactions": "none", "num_neighbors": 2, "horizon_s": 0.5, "decision_rate": 10}


def make(drones: int, envs: int) -> SharedPolicyVecEnv:
    return SharedPolicyVecEnv("swap_v0", envs, num_drones=drones, **OPTIONS)


def test_teams_side_by_side_fly_as_they_would_alone():
    both, alone = SideBySide([make(2, 3), make(3, 2)]), [make(2, 3), make(3, 2)]
    both.seed(5)
    for env, seed in zip(alone, (5, 5 + 2 * 3), strict=True):
        env.seed(seed)
    assert np.array_equal(both.reset(), np.concatenate([env.reset() for env in alone]))
    rng, ended = np.random.default_rng(0), 0
    for _ in range(12):
        actions = rng.uniform(-1, 1, (both.num_envs, both.action_space.shape[0]))
        *arrays, infos = both.step(actions)
        apart = [
            env.step(part) for env, part in zip(alone, (actions[:6], actions[6:]), strict=True)
        ]
        for k, array in enumerate(arrays):
            assert np.array_equal(array, np.concatenate([one[k] for one in apart]))
        told = [info for one in apart for info in one[3]]
        assert [info.keys() for info in infos] == [info.keys() for info in told]
        ended += sum("episode_metrics" in info for info in infos)
    assert ended == 2 * both.num_envs  # two episodes of half a second
    assert both.get_attr("num_drones") == [2] * 6 + [3] * 6
    (metrics,) = both.env_method("metrics", 0, indices=[7])
    assert metrics["length_s"] == alone[1].core.metrics(0)["length_s"]
    both.close()
    for env in alone:
        env.close()


def test_parts_must_be_alike():
    parts = [make(2, 1), SharedPolicyVecEnv("swap_v0", 1, **{**OPTIONS, "num_neighbors": 3})]
    with pytest.raises(ValueError, match="part 1 observes"):
        SideBySide(parts)
    with pytest.raises(ValueError, match="parts is empty"):
        SideBySide([])
    for part in parts:
        part.close()


def test_threads_change_no_byte_of_what_is_learned():
    weights = []
    for threads in (1, 2):
        small: dict[str, Any] = {
            "environments": 8,
            "rollout": 16,
            "batch_size": 128,
            "passes": 2,
            "steps": 3000,
        }
        plain = TrainConfig(out=Path("never"), drones=(2, 4), threads=threads, **small)
        learner = PpoLearner(completed(plain, "swap_v0"), "swap_v0")
        learner.fly(range(2))
        weights.append([p.detach().clone() for p in learner.model.policy.parameters()])
        assert learner.env.cores[0].physics.workers.threads == threads
        learner.close()
    assert all(torch.equal(one, two) for one, two in zip(*weights, strict=True))
