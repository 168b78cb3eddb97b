"""Gymnasium's interfaces: its own checks, the core's flights, a row an agent, clipped actions."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AutoresetMode
from gymnasium.wrappers import TimeAwareObservation
from gymnasium.wrappers.vector import RecordEpisodeStatistics

from swarm_envs import TASKS, gymnasium_name, make, register, swap_v1
from swarm_envs.envs.joint import make_joint, make_solo
from swarm_envs.envs.vector import SwarmVectorEnv, make_vector

QUICK: dict[str, Any] = {"num_drones": 2, "physics": "batch", "horizon_s": 0.5}


def team_actions(rng: np.random.Generator, env: Any) -> np.ndarray:
    return rng.uniform(-0.3, 0.3, env.action_space.shape).astype(np.float32)


@pytest.mark.filterwarnings("ignore:.*Box observation space m")  # ours are not normalised
@pytest.mark.parametrize("task", TASKS)
def test_gymnasiums_own_check(task):
    env = gymnasium.make(gymnasium_name(task), **QUICK)
    check_env(env.unwrapped, skip_render_check=True)
    solo = gymnasium.make(gymnasium_name(task, "Solo"), **QUICK)
    check_env(solo.unwrapped, skip_render_check=True)


def test_names_are_found_by_make_and_by_make_vec():
    register()  # again: nothing is registered twice, which would be a warning
    env = gymnasium.make("swarm_envs/Swap-v1", num_drones=3, physics="batch", layout="circle")
    assert env.unwrapped.core.task.layout == "circle"  # type: ignore[attr-defined]
    many = gymnasium.make_vec("swarm_envs/Ring-v1", num_envs=3, num_drones=5, horizon_s=1.0)
    assert many.unwrapped.core.task.name == "ring_v1"  # type: ignore[attr-defined]
    assert many.spec is not None and many.spec.max_episode_steps == 48
    assert many.observation_space.shape is not None and many.observation_space.shape[0] == 3


def test_one_joint_env_flies_what_pettingzoo_flies(engine):
    joint = make_joint("swap_v1", **{**QUICK, "physics": engine})
    parallel = swap_v1.parallel_env(num_drones=2, physics=engine, horizon_s=0.5)
    seen, _ = joint.reset(seed=4)
    rows, _ = parallel.reset(seed=4)
    rng, over = np.random.default_rng(0), False
    while not over:
        assert np.array_equal(seen, np.concatenate(list(rows.values())))
        action = team_actions(rng, joint)
        seen, reward, ended, cut, info = joint.step(action)
        halves = dict(zip(parallel.agents, action.reshape(2, 3), strict=True))
        rows, rewards, *_ = parallel.step(halves)
        assert list(info["rewards"]) == list(rewards.values())
        assert reward == np.mean(list(rewards.values()))
        over = ended or cut
    assert cut and info["episode_metrics"]["length_s"] == 0.5
    with pytest.raises(RuntimeError, match="the episode has ended"):
        joint.step(action)
    joint.close()
    parallel.close()


def test_a_solo_drone_flies_among_the_others():
    solo = make_solo("swap_v1", drone=1, others=lambda row: np.full(3, 0.2), **QUICK)
    parallel = swap_v1.parallel_env(**QUICK)
    seen, _ = solo.reset(seed=1)
    rows, _ = parallel.reset(seed=1)
    for _ in range(24):
        assert np.array_equal(seen, rows["drone_1"])
        own = np.array([0.1, -0.1, 0.0])
        seen, reward, _, _, info = solo.step(own)
        rows, rewards, _, _, infos = parallel.step({"drone_0": np.full(3, 0.2), "drone_1": own})
        assert reward == rewards["drone_1"] and info == infos["drone_1"]
    with pytest.raises(ValueError, match="drone is 2, but the team has drones 0 to 1"):
        make_solo("swap_v1", drone=2, **QUICK)


@pytest.mark.parametrize("mode", AutoresetMode)
def test_gymnasium_joins_the_infos_of_a_crash_and_of_a_flight_without_contact(mode):
    given: Any = {**QUICK, "horizon_s": 5.0}
    vector: Any = {"autoreset_mode": mode}
    name = gymnasium_name("swap_v1", "Solo")
    env: Any = gymnasium.make_vec(name, 2, "sync", vector_kwargs=vector, **given)
    env.reset(seed=[1, 2])
    ended = np.zeros(2, np.bool_)
    while not ended.any():
        *_, ended, _, infos = env.step(np.array([[0.0, 0.0, 0.0], [0.0, 0.0, -1.0]], np.float32))
    infos = infos.get("final_info", infos)
    assert infos["_contact"].tolist() == infos["contact"]["floor"].tolist() == [False, True]
    env.close()


@pytest.mark.parametrize("most", [None, 5])
@pytest.mark.parametrize("mode", AutoresetMode)
def test_vector_modes_are_those_of_gymnasium(mode, most):
    """Against Gymnasium's own SyncVectorEnv over single environments: every array, every step."""
    options = {**QUICK, "horizon_s": 0.25, "max_episode_steps": most}
    ours = make_vector("swap_v1", 3, mode, **options)
    options |= {"vectorization_mode": "sync", "vector_kwargs": {"autoreset_mode": mode}}
    theirs: Any = gymnasium.make_vec("swarm_envs/Swap-v1", 3, **options)
    assert ours.single_observation_space == theirs.single_observation_space
    assert ours.action_space == theirs.action_space
    assert ours.metadata["autoreset_mode"] is mode
    mine, _ = ours.reset(seed=7)
    other, _ = theirs.reset(seed=7)
    rng, ends = np.random.default_rng(0), 0
    for step in range(40):
        assert np.array_equal(mine, other), step
        actions = team_actions(rng, ours)
        if step % 5 == 0:
            actions[0] = 1.0  # a team that leaves before the others
        mine, rewards, ended, cut, infos = ours.step(actions)
        other, *rest, other_infos = theirs.step(actions)
        for a, b in zip((rewards, ended, cut), map(np.asarray, rest), strict=True):
            assert np.array_equal(a, b)
        over = ended | cut
        ends += int(over.sum())
        if over.any():
            if mode is AutoresetMode.SAME_STEP:
                for e in np.flatnonzero(over):
                    assert np.array_equal(infos["final_obs"][e], other_infos["final_obs"][e])
            elif most is None:  # the metrics of an episode that Gymnasium cuts are ours alone
                lengths = infos["episode_metrics"]["length_s"]
                assert np.array_equal(lengths, other_infos["episode_metrics"]["length_s"])
            if mode is AutoresetMode.DISABLED:
                with pytest.raises(RuntimeError, match="have ended; reset them by"):
                    ours.step(actions)
                for env in (ours, theirs):
                    env.reset(options={"reset_mask": over.copy()})
                mine, other = ours.core.rows.reshape(3, -1), theirs._observations
    assert ends >= 6


def test_what_was_refused_can_be_closed():
    """As Gymnasium 1.1 does when it is deleted."""
    object.__new__(SwarmVectorEnv).close_extras()


def test_options_of_a_batch_and_of_a_team_in_one_box():
    with pytest.raises(ValueError, match="unknown autoreset_mode 'Same'"):
        make_vector("swap_v1", num_envs=2, autoreset_mode="Same", **QUICK)
    with pytest.raises(ValueError, match="unknown render_mode 'rgb'"):
        make_vector("swap_v1", num_envs=2, render_mode="rgb", **QUICK)
    with pytest.raises(ValueError, match="per_agent"):
        make_vector("swap_v1", 1, per_agent="yes")  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="but must be 'flat' for a team in one Box"):
        make_joint("swap_v1", observation="dict", **QUICK)


OPTIONS: dict[str, Any] = {"num_drones": 3, "horizon_s": 0.5}


@pytest.mark.parametrize("mode", ["NextStep", "SameStep", AutoresetMode.DISABLED, "Disabled"])
def test_a_row_an_agent_is_the_same_flight(mode):
    """Row e * N + i is drone i of team e, in every mode, over ends of episodes."""
    options = {"num_envs": 2, "autoreset_mode": mode, **OPTIONS}
    teams = gymnasium.make_vec("swarm_envs/Swap-v1", **options)
    rows = gymnasium.make_vec("swarm_envs/Swap-v1", per_agent=True, **options)
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
        seen, _, terminated, truncated, by_team = teams.step(actions.reshape(2, -1))
        own, rewards, *ends_of_rows, infos = rows.step(actions)
        again = ~by_team["active"].any(axis=1)
        expected = np.where(again[:, None], 0.0, by_team["rewards"])
        np.testing.assert_array_equal(rewards, expected.reshape(-1))
        np.testing.assert_array_equal(ends_of_rows[0], np.repeat(terminated, 3))
        np.testing.assert_array_equal(ends_of_rows[1], np.repeat(truncated, 3))
        if truncated.any():
            ends += 1
            length = infos.get("final_info", infos)["episode_metrics"]["length_s"]
            assert length.tolist() == [0.5] * 6
        over = terminated | truncated
        if over.any() and rows.metadata["autoreset_mode"] is AutoresetMode.DISABLED:
            seen, _ = teams.reset(options={"reset_mask": over})
            own, _ = rows.reset(options={"reset_mask": over})
    assert ends == 2


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
    pytest.importorskip("stable_baselines3", reason="the extra `train`")
    from swarm_envs.training import SharedPolicyVecEnv

    env, rows = clipped(horizon_s=0.05)
    while env.agents:
        *_, infos = env.step({agent: np.zeros(3, np.float32) for agent in rows})
    batch = SharedPolicyVecEnv("swap_v1", 2, num_drones=3, horizon_s=0.05)
    batch.reset()
    for _ in range(3):
        *_, shared = batch.step(np.zeros((6, 3)))
    for first, *others in (list(infos.values()), shared):
        first["episode_metrics"]["success"] = "changed"
        first["mine"] = True
        assert all("mine" not in info for info in others)
        assert all(info["episode_metrics"]["success"] is False for info in others)


@pytest.mark.parametrize("task", TASKS)
@pytest.mark.parametrize("suffix", ["", "Solo"])
def test_entries_have_the_time_limit_of_their_options_in_decisions(task, suffix):
    name = gymnasium_name(task, suffix)
    assert gymnasium.spec(name).max_episode_steps is None, "no second time limit"
    env = gymnasium.make(name, physics="batch", decision_rate=10, horizon_s=2.05)
    assert env.spec is not None and env.spec.max_episode_steps == 21
    space: Any = TimeAwareObservation(env, flatten=False).observation_space
    assert space["time"].high == 21


@pytest.mark.parametrize("wrapped", [False, True])
@pytest.mark.parametrize("by_row", [False, True])
def test_masks_and_seeds_of_rows_are_those_of_their_teams(wrapped, by_row):
    made = make_vector("swap_v1", 3, "Disabled", per_agent=True, num_drones=2, horizon_s=0.2)
    env: Any = RecordEpisodeStatistics(made) if wrapped else made
    first, _ = env.reset(seed=[4, 4, 5, 5, 6, 6] if by_row else [4, 5, 6])
    ended = np.zeros(6, np.bool_)
    while not ended.any():
        *_, terminated, truncated, _ = env.step(np.zeros(env.action_space.shape, np.float32))
        ended = terminated | truncated
    if wrapped and not by_row:
        return  # the wrapper counts rows, and refuses masks of teams itself
    mask = ended if by_row else ended.reshape(3, 2).all(axis=1)
    again, _ = env.reset(seed=[4, 4, 5, 5, 6, 6], options={"reset_mask": mask})
    np.testing.assert_array_equal(again, first)
    with pytest.raises(ValueError, match="rows of a team are reset together"):
        made.reset(options={"reset_mask": np.array([1, 0, 1, 1, 0, 0], np.bool_)})
    with pytest.raises(ValueError, match=r"unknown reset option 'mask'; valid: .*'reset_mask'"):
        made.reset(options={"mask": mask})
