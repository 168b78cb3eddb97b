"""AgileRL's vector of parallel environments, each in a process of its own: our flights."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from swarm_envs import swap_v1

pytest.importorskip("agilerl", reason="run by `make test-compat`")

from agilerl.vector.pz_async_vec_env import AsyncPettingZooVecEnv

pytestmark = [pytest.mark.slow, pytest.mark.filterwarnings("default")]


def make():
    return swap_v1.parallel_env(num_drones=3, physics="batch", horizon_s=1.0)


def test_a_vector_of_environments_flies_as_each_alone():
    many = AsyncPettingZooVecEnv([make, make])
    alone = [make(), make()]
    seen: Any = many.reset(seed=5)[0]
    rows = [env.reset(seed=5 + e)[0] for e, env in enumerate(alone)]
    rng = np.random.default_rng(0)
    for _ in range(8):
        for agent, both in seen.items():
            assert np.array_equal(both, [row[agent] for row in rows])
        actions = {
            agent: rng.uniform(-0.2, 0.2, (2, 3)).astype(np.float32) for agent in many.agents
        }
        step: Any = many.step(actions)
        seen, rewards = step[:2]
        for e, env in enumerate(alone):
            rows[e], own, *_ = env.step({agent: both[e] for agent, both in actions.items()})
            assert [rewards[agent][e] for agent in own] == pytest.approx(list(own.values()))
    for _ in range(30):  # beyond the end of the episodes
        seen = many.step({agent: np.zeros((2, 3), np.float32) for agent in many.agents})[0]
    many.close()
    assert all(np.isfinite(both).all() for both in seen.values())
