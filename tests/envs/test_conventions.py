"""What users of CleanRL meet: a row an agent, modes by name, clipped actions, own infos."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode

from swarm_envs import make, swap_v1
from swarm_envs.envs.vector import make_vector
from swarm_envs.training import SharedPolicyVecEnv

OPTIONS: dict[str, Any] = {"num_drones": 3, "horizon_s": 0.5}
START = np.array([[-0.3, 0.0, 1.0], [0.3, 0.0, 1.0], [0.0, -1.5, 1.0]])
MEET = np.array([[0.5, 0.0, 0.0], [-0.5, 0.0, 0.0], [0.0, 0.0, 0.0]], np.float32)


@pytest.mark.parametrize("mode", ["NextStep", "SameStep", AutoresetMode.DISABLED, "Disabled"])
def test_a_row_an_agent_is_the_same_flight(mode):
    """Row e * N + i is drone i of team e, in every mode, over ends of episodes."""
    teams = gymnasium.make_vec("swarm_envs/Swap-v1", num_envs=2, autoreset_mode=mode, **OPTIONS)
    rows = gymnasium.make_vec(
        "swarm_envs/Swap-v1", num_envs=2, autoreset_mode=mode, per_agent=True, **OPTIONS
    )
    assert rows.num_envs == 6
    width = len(make("swap_v1", **OPTIONS).reset(seed=0)[0]["drone_0"])
    assert rows.single_action_space.shape == (3,)
    assert rows.observation_space.shape == (6, width)
    assert rows.metadata["autoreset_mode"] is teams.metadata["autoreset_mode"]
    seen, _ = teams.reset(seed=5)
    own, _ = rows.reset(seed=5)
    rng, ends = np.random.default_rng(0), 0
    for _ in range(60):
        np.testing.assert_array_equal(own, seen.reshape(6, -1))
        actions = rng.uniform(-0.2, 0.2, (6, 3)).astype(np.float32)
        seen, _, over, cut, told = teams.step(actions.reshape(2, -1))
        own, rewards, ended, truncated, infos = rows.step(actions)
        again = ~told["active"].any(axis=1)
        expected = np.where(again[:, None], 0.0, told["rewards"])
        np.testing.assert_array_equal(rewards, expected.reshape(-1))
        np.testing.assert_array_equal(ended, np.repeat(over, 3))
        np.testing.assert_array_equal(truncated, np.repeat(cut, 3))
        if cut.any():
            ends += 1
            length = infos.get("final_info", infos)["episode_metrics"]["length_s"]
            assert length.tolist() == [0.5] * 6
        if rows.metadata["autoreset_mode"] is AutoresetMode.DISABLED and (over | cut).any():
            seen, _ = teams.reset(options={"reset_mask": over | cut})
            own, _ = rows.reset(options={"reset_mask": over | cut})
    assert ends == 2
    teams.close()
    rows.close()


def test_a_row_that_ended_waits_for_its_team():
    envs = make_vector(
        "swap_v1", 2, "SameStep", per_agent=True, num_drones=3, action="velocity",
        on_contact="end_pair", horizon_s=1.0,
    )  # fmt: skip
    envs.reset(seed=0, options={"start": START, "goal": START[::-1]})
    ends, waited = np.zeros(6, int), 0
    for _ in range(48):
        rows, rewards, ended, cut, infos = envs.step(np.tile(MEET, (2, 1)))
        assert not rewards[~infos["active"]].any()
        waited += int((~infos["active"]).sum())
        ends += ended | cut
    assert waited > 4
    assert ends.tolist() == [2, 2, 1] * 2  # once by contact, once with the team
    assert ended.tolist() == [True, True, False] * 2 and cut.tolist() == [False, False, True] * 2
    assert infos["final_info"]["episode_metrics"]["collided_drones"].tolist() == [2] * 6
    assert rows.any(axis=1).all()
    envs.close()


def test_per_agent_must_be_a_flag():
    with pytest.raises(ValueError, match="per_agent"):
        make_vector("swap_v1", 1, per_agent="yes")  # type: ignore[arg-type]


def clipped(**options: Any) -> Any:
    env = make("swap_v1", physics="batch", num_drones=3, **options)
    return env, env.reset(seed=2)[0]


@pytest.mark.parametrize("action", ["acceleration", "rotors"])
def test_actions_are_clipped_if_that_is_wanted(action):
    wild = np.random.default_rng(0).normal(0.0, 2.0, (3, 4 if action == "rotors" else 3))
    (env, rows), (other, _) = clipped(action=action, clip_actions=True), clipped(action=action)
    wide = dict(zip(rows, wild, strict=True))
    with pytest.raises(ValueError, match="clip_actions=True"):
        other.step(wide)
    given = env.step(wide)
    expected = other.step({agent: np.clip(row, -1.0, 1.0) for agent, row in wide.items()})
    np.testing.assert_array_equal(given[0]["drone_1"], expected[0]["drone_1"])
    assert given[1] == expected[1]
    for bad in (np.nan, np.inf):
        with pytest.raises(ValueError, match="finite"):
            env.step({agent: np.full_like(row, bad) for agent, row in wide.items()})
    turns = swap_v1.env(num_drones=3, physics="batch", action=action, clip_actions=True)
    turns.reset(seed=2)
    for row in wild:
        turns.step(row)
    np.testing.assert_array_equal(turns.observe("drone_1"), given[0]["drone_1"])


def test_infos_are_of_their_own():
    env, rows = clipped(horizon_s=0.05)
    *_, infos = env.step({agent: np.zeros(3, np.float32) for agent in rows})
    while env.agents:
        *_, infos = env.step({agent: np.zeros(3, np.float32) for agent in rows})
    batch = SharedPolicyVecEnv("swap_v1", 2, num_drones=3, horizon_s=0.05)
    batch.reset()
    for _ in range(3):
        *_, shared = batch.step(np.zeros((6, 3)))
    for told in (list(infos.values()), shared):
        told[0]["episode_metrics"]["success"] = "changed"
        told[0]["mine"] = True
        assert all("mine" not in info for info in told[1:])
        assert all(info["episode_metrics"]["success"] is False for info in told[1:])
    env.close()
    batch.close()
