"""SuperSuit's wrappers of the PettingZoo environments, the ones that once failed."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from gymnasium.spaces import Box

from swarm_envs import crowd_v0, swap_v1

supersuit = pytest.importorskip("supersuit", reason="run by `make test-compat`")

pytestmark = [pytest.mark.slow, pytest.mark.filterwarnings("default")]
QUICK: dict[str, Any] = {"physics": "batch", "horizon_s": 1.0}


def sampled(env):
    return {agent: env.action_space(agent).sample() for agent in env.agents}


def test_dead_drones_stay_until_the_end_and_observe_zeros():
    made = crowd_v0.parallel_env(
        num_drones=5, layout="open", on_contact="end_pair", physics="batch"
    )
    env = supersuit.black_death_v3(made)
    seen, _ = env.reset(seed=0)
    counts = []
    down = np.array([0.0, 0.0, -1.0], np.float32)  # of drone 0 alone
    while env.agents:
        assert set(seen) == set(made.possible_agents)
        counts.append(sum(bool(row.any()) for row in seen.values()))
        others = sampled(env) if len(counts) > 50 else dict.fromkeys(env.agents, 0 * down)
        seen, *_ = env.step(others | {"drone_0": down})
    assert counts[0] == 5 and 4 in counts  # the step that ended the episode took no actions


def test_skipped_frames_are_drawn_by_the_seed():
    lengths = []
    for _ in range(2):
        env = supersuit.frame_skip_v0(swap_v1.parallel_env(num_drones=2, **QUICK), (2, 5))
        env.reset(seed=4)
        steps = 0
        while env.agents:
            env.step(dict.fromkeys(env.agents, np.zeros(3, np.float32)))
            steps += 1
        lengths.append(steps)
    assert lengths[0] == lengths[1] < 20


def test_observations_within_bounds_are_normalized():
    env = supersuit.observation_lambda_v0(
        swap_v1.parallel_env(num_drones=2, **QUICK),
        lambda row, space: np.clip(row, -10.0, 10.0),
        lambda space: Box(-10.0, 10.0, space.shape, space.dtype),
    )
    env = supersuit.normalize_obs_v0(env)
    seen, _ = env.reset(seed=0)
    assert all(env.observation_space(agent).contains(row) for agent, row in seen.items())
    row = swap_v1.parallel_env(num_drones=2, **QUICK).reset(seed=0)[0]["drone_0"]
    assert seen["drone_0"] == pytest.approx((np.clip(row, -10, 10) + 10) / 20, abs=1e-6)


def test_environments_in_one_vector():
    env = supersuit.pettingzoo_env_to_vec_env_v1(swap_v1.parallel_env(num_drones=3, **QUICK))
    many = supersuit.concat_vec_envs_v1(env, 2, num_cpus=0, base_class="gymnasium")
    rows, _ = many.reset(seed=0)
    assert rows.shape == (6, env.observation_space.shape[0])
    rows, rewards, *_ = many.step(np.zeros((6, 3), np.float32))
    assert np.isfinite(rows).all() and rewards.shape == (6,)
