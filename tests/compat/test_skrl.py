"""skrl wraps the parallel, the joint and the vector environment: what it gives is our flight."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from swarm_envs import swap_v1

pytest.importorskip("skrl", reason="run by `make test-compat`")

import torch
from skrl import config
from skrl.envs.wrappers.torch import wrap_env

pytestmark = [pytest.mark.slow, pytest.mark.filterwarnings("default")]
OPTIONS: dict[str, Any] = {"num_drones": 3, "physics": "batch", "horizon_s": 1.0}


@pytest.mark.parametrize("more", [{}, {"action": "rotors", "on_contact": "end_pair"}], ids=str)
def test_a_parallel_environment(monkeypatch, more):
    """With `end_pair` drones fall one after another, and each leaves what the wrapper gives."""
    monkeypatch.setattr(config.torch, "key", 3)  # seeds what is wrapped
    env = wrap_env(swap_v1.parallel_env(**OPTIONS, **more), wrapper="pettingzoo")
    ours = swap_v1.parallel_env(**OPTIONS, **more)
    assert env.max_num_agents == 3 and env.possible_agents == ours.possible_agents
    assert env.state_space("drone_0") == ours.state_space
    seen, _ = env.reset()
    rows, _ = ours.reset(seed=3)
    rng, width, counts = np.random.default_rng(0), ours.core.mode.width, set()
    while ours.agents:
        counts.add(len(ours.agents))
        assert list(seen) == list(rows)
        for agent, row in seen.items():
            assert np.array_equal(row.numpy()[0], rows[agent])
        for state in env.state().values():
            assert np.array_equal(state.numpy()[0], ours.state())
        actions = {agent: rng.uniform(-0.3, 0.3, width).astype(np.float32) for agent in ours.agents}
        rows, rewards, ended, cut, _ = ours.step(actions)
        given = {agent: torch.as_tensor(action)[None] for agent, action in actions.items()}
        seen, reward, terminated, truncated, _ = env.step(given)
        for agent in rows:
            assert reward[agent].item() == np.float32(rewards[agent])
            assert terminated[agent].item() == ended[agent]
            assert truncated[agent].item() == cut[agent]
    assert (len(counts) > 1) == bool(more)
    env.close()
