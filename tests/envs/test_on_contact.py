"""Contacts end the team's episode or that of those who touch, or drones bounce."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from pettingzoo.test import api_test, parallel_api_test

from swarm_envs import swap_v1
from swarm_envs.agents import fly_episode, load
from swarm_envs.agents.protocol import fly_batch
from swarm_envs.envs.core import SwarmCore
from swarm_envs.envs.joint import make_joint, make_solo
from swarm_envs.envs.vector import make_vector
from swarm_envs.interactions import load as load_forces
from swarm_envs.training import SharedPolicyVecEnv
from swarm_envs.viewing.record import Recorder

START = np.array([[-0.3, 0.0, 1.0], [0.3, 0.0, 1.0], [0.0, -1.5, 1.0]])
GOAL = np.array([[1.5, 0.0, 1.0], [-1.5, 0.0, 1.0], [0.0, 1.2, 1.0]])
PLACED = {"start": START, "goal": GOAL}
MEET = np.array([[0.5, 0.0, 0.0], [-0.5, 0.0, 0.0], [0.0, 0.0, 0.0]], np.float32)
"""Velocities with which the first two collide, while the third waits."""
GO = np.array([0.0, 0.6, 0.0], np.float32)
"""With this the third flies through the place where they met."""


def make(on_contact="end_pair", **options):
    given: dict[str, Any] = {"num_drones": 3, "action": "velocity", "horizon_s": 6.0, **options}
    return swap_v1.parallel_env(on_contact=on_contact, **given)


def meet(env):
    """Fly until two have come into contact; the results of the step in which they did."""
    env.reset(seed=0, options=PLACED)
    for _ in range(60):
        given = env.step(dict(zip(env.agents, MEET, strict=True)))
        if len(env.agents) < 3:
            return given
    raise AssertionError("they did not meet")


def test_who_touches_ends_and_the_others_fly_on_as_if_alone(engine):
    env, alone = make(physics=engine), make("end_team", num_drones=1, physics=engine)
    rows, rewards, terminations, truncations, infos = meet(env)
    assert env.agents == ["drone_2"]
    assert terminations == {"drone_0": True, "drone_1": True, "drone_2": False}
    assert not any(truncations.values())
    assert infos["drone_0"]["contact"]["drone"] == "drone_1"
    assert rewards["drone_0"] < -0.9  # a crash, and less what they came nearer to their goals
    assert infos["drone_2"]["reward_terms"]["crash"] == 0.0
    mask = [f.where.start for f in env.observation_layout if f.name.endswith("mask")]
    assert rows["drone_0"].any() and not rows["drone_2"][mask].any()
    frozen = env.view.state.position[:2].copy()
    alone.reset(seed=0, options={"start": START[2:], "goal": GOAL[2:]})
    for _ in range(round(env.view.time * 48)):
        alone.step({"drone_0": MEET[2]})
    nearest = np.inf
    while env.agents:
        state, lone = env.view.state, alone.view.state
        for ours, theirs in zip(state, lone, strict=True):
            np.testing.assert_allclose(ours[2], theirs[0], atol=1e-9)
        nearest = min(nearest, float(np.linalg.norm(state.position[2] - frozen[0])))
        action = np.clip(GOAL[2] - state.position[2], -0.6, 0.6).astype(np.float32)
        lonely = alone.step({"drone_0": action})
        rows, rewards, terminations, _, infos = env.step({"drone_2": action})
        assert rewards["drone_2"] == pytest.approx(lonely[1]["drone_0"], abs=1e-9)
        assert terminations["drone_2"] == lonely[2]["drone_0"]
    assert nearest < 0.05  # through the place where they ended
    np.testing.assert_array_equal(env.view.state.position[:2], frozen)
    metrics = infos["drone_2"]["episode_metrics"]
    assert terminations["drone_2"] and not metrics["success"]  # done, but two were hurt
    assert (metrics["collided_drones"], metrics["arrived_fraction"]) == (2, 1 / 3)
    assert infos["drone_2"]["reward_terms"]["success"] == 1.0
    env.close()
    alone.close()


def test_snapshots_remember_who_has_ended(engine):
    env = make(physics=engine)
    meet(env)
    kept = env.get_state()
    there = [env.step({"drone_2": GO})[0]["drone_2"] for _ in range(5)]
    env.reset(seed=1)
    assert len(env.agents) == 3
    env.set_state(kept)
    assert env.agents == ["drone_2"]
    again = [env.step({"drone_2": GO})[0]["drone_2"] for _ in range(5)]
    np.testing.assert_array_equal(there, again)
    env.close()


@pytest.mark.filterwarnings("ignore:Agent's m.* observation space value:UserWarning")
@pytest.mark.parametrize("on_contact", ["end_pair", "bounce"])
def test_pettingzoo_accepts_it(on_contact):
    options: dict[str, Any] = {"physics": "batch", "action": "rotors", "horizon_s": 3.0}
    parallel_api_test(make(on_contact, **options), num_cycles=300)
    if on_contact == "end_pair":
        turns = swap_v1.env(num_drones=3, on_contact=on_contact, **options)
        api_test(turns, num_cycles=300)


def test_bouncing_drones_fly_on_hurt():
    env = make("bounce", physics="batch", horizon_s=2.0)
    env.reset(seed=0, options=PLACED)
    crashes, speeds = [], []
    while env.agents:
        speeds.append(env.view.state.velocity[:2, 0].copy())
        _, _, _, truncations, infos = env.step(dict(zip(env.agents, MEET, strict=True)))
        crashes.append([infos[agent]["reward_terms"]["crash"] for agent in env.possible_agents])
    assert all(truncations.values())
    first = int(np.argmax(np.array(crashes)[:, 0]))
    assert crashes[first] == [1.0, 1.0, 0.0]
    assert speeds[first][0] > 0.5 > -0.2 > speeds[first + 1][0]  # it went back
    metrics = infos["drone_0"]["episode_metrics"]
    assert (metrics["collided_drones"], metrics["success"]) == (2, False)


def test_actions_of_those_who_have_left_are_not_used():
    env = make(physics="batch")
    meet(env)
    with pytest.raises(ValueError, match="drone_2"):
        env.step({"drone_0": GO})
    with pytest.raises(ValueError, match="drone_7"):
        env.step({"drone_2": GO, "drone_7": GO})
    kept = env.get_state()
    rows, *_ = env.step({"drone_0": GO, "drone_1": np.full(3, np.nan), "drone_2": GO})
    assert list(rows) == ["drone_2"]
    env.set_state(kept)
    np.testing.assert_array_equal(env.step({"drone_2": GO})[0]["drone_2"], rows["drone_2"])


OPTIONS: dict[str, Any] = {"num_drones": 3, "action": "velocity", "on_contact": "end_pair"}


def test_teams_in_one_row_mask_who_has_ended():
    """One team, and two in a batch: the same rows and rewards."""
    envs = make_vector("swap_v1", 2, "Disabled", horizon_s=2.0, **OPTIONS)
    one = make_joint("swap_v1", physics="batch", horizon_s=2.0, **OPTIONS)
    rows, _ = envs.reset(seed=0, options=PLACED)
    row, _ = one.reset(seed=0, options=PLACED)
    ended, over = None, False
    while not over:
        np.testing.assert_array_equal(row, rows[0])
        rows, rewards, terminated, truncated, infos = envs.step(np.tile(MEET.reshape(-1), (2, 1)))
        row, reward, end, over, info = one.step(MEET.reshape(-1))
        np.testing.assert_allclose(rewards, infos["rewards"].mean(axis=1))
        assert reward == pytest.approx(rewards[0], abs=1e-12) and not end
        for name in ("rewards", "active"):
            np.testing.assert_array_equal(info[name], infos[name][0])
        if ended is not None:
            assert infos["active"].tolist() == [[False, False, True]] * 2
            assert not infos["rewards"][:, :2].any()
            assert not rows.reshape(2, 3, -1)[:, :2].any()
        elif infos["rewards"].min() < -0.9:
            ended = infos
            assert infos["active"].all() and not terminated.any()
    assert ended is not None and truncated.all()
    assert infos["episode_metrics"]["collided_drones"].tolist() == [2, 2]
    assert info["episode_metrics"]["collided_drones"] == 2


def test_a_row_that_ended_waits_for_its_team():
    envs = make_vector("swap_v1", 2, "SameStep", per_agent=True, horizon_s=1.0, **OPTIONS)
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


def test_the_shared_policy_waits_for_its_team():
    env = SharedPolicyVecEnv("swap_v1", 2, horizon_s=2.0, **OPTIONS)
    env.set_options(PLACED)
    env.reset()
    seen: list[Any] = []
    while not seen or not seen[-1][2]:
        rows, rewards, dones, infos = env.step(np.tile(MEET, (2, 1)))
        assert len({id(info) for info in infos}) == 6
        if dones.any() or seen:
            seen.append((rewards[:3], dones.tolist(), dones[2], infos, rows[:3]))
    first, waiting, last = seen[0], seen[1], seen[-1]
    assert first[1] == [True, True, False] * 2
    assert first[3][0]["terminal_observation"].any() and not first[4][:2].any()
    assert not first[3][0]["TimeLimit.truncated"] and "episode_metrics" not in first[3][0]
    assert [info["active"] for info in waiting[3]] == [False, False, True] * 2
    assert not waiting[0][:2].any() and not waiting[4][:2].any() and not any(waiting[1])
    assert all(last[1]) and last[3][0]["episode_metrics"]["collided_drones"] == 2
    assert [info["TimeLimit.truncated"] for info in last[3]] == [False, False, True] * 2
    assert last[4].any(axis=1).all()  # everybody has begun again


def test_solo_ends_with_its_drone():
    env = make_solo("swap_v1", drone=2, physics="batch", **OPTIONS)
    env.reset(seed=0, options=PLACED)
    over = False
    while not over:
        _, _, over, cut, info = env.step(np.array([0.0, 0.0, -1.0], np.float32))
        assert not cut
    assert info["contact"]["floor"] and info["episode_metrics"]["collided_floor"] == 1
    with pytest.raises(RuntimeError, match="ended"):
        env.step(GO)


def test_agents_fly_it_alone_and_at_once():
    """The same metrics one by one, where drones leave, and in a batch, where they are masked."""
    options: dict[str, Any] = {"num_drones": 8, "physics": "batch", "on_contact": "end_pair"}
    agent, seeds = load("straight-line"), [3, 4, 5, 6]
    env = swap_v1.parallel_env(**options, **agent.requires)
    recorder = Recorder()
    alone = [fly_episode(env, agent, seed, recorder) for seed in seeds]
    assert any(0.0 < m["arrived_fraction"] < 1.0 for m in alone)
    assert all(m["success"] == (m["arrived_fraction"] == 1.0) for m in alone)
    core = SwarmCore(env.core.task, env.core.config, len(seeds))
    if hasattr(agent, "act_batch"):
        assert fly_batch(core, agent.act_batch, seeds) == alone


@pytest.mark.parametrize("world", ["ideal", "hall"])
def test_who_has_ended_pushes_nobody_in_the_observed_force(world):
    """Below the place where two met, the third observes the force of flying alone."""
    model = load_forces("learned")
    envs = [make(observe_force=model, world=world, physics="batch") for _ in range(2)]
    below = START - [[0.0, 0.0, 0.0], [0.0, 0.0, 0.0], [0.0, -1.5, 0.35]]
    for env in envs:
        env.reset(seed=0, options={"start": below, "goal": GOAL})
    field = next(f for f in envs[0].observation_layout if f.name == "self.force")
    rng, beneath = np.random.default_rng(0), 0
    for _ in range(60):
        free = np.concatenate([rng.uniform(-1, 1, (2, 3)), np.zeros((1, 3))]).astype(np.float32)
        rows = []
        for env, given in zip(envs, (MEET, free), strict=True):
            actions = MEET if len(env.agents) == 3 else given
            rows.append(env.step({agent: actions[int(agent[-1])] for agent in env.agents})[0])
        if envs[0].agents == ["drone_2"]:
            view, row = envs[0].view, rows[0]["drone_2"]
            own = (view.state.position[None, 2:], view.state.velocity[None, 2:])
            alone = field.scale * model.forces(*own, "S")[0, 0] / (34e-3 * 9.81)
            beneath += 1
            assert np.abs(row[field.where] - alone).max() < 0.03
            assert np.array_equal(row, rows[1]["drone_2"])
    assert beneath > 20
