"""Stable-Baselines3's VecEnv: the flights of PettingZoo to the last bit, SB3's rules, PPO."""

from __future__ import annotations

import pickle
import sys
from typing import Any

import numpy as np
import pytest

import swarm_envs.training
from swarm_envs import TASKS, swap_v1
from swarm_envs.agents.features import feature_sizes, features_of
from swarm_envs.envs.joint import make_joint, make_solo
from swarm_envs.envs.options import batch_of

pytest.importorskip("stable_baselines3")

from stable_baselines3 import PPO
from stable_baselines3.common.env_checker import check_env
from stable_baselines3.common.evaluation import evaluate_policy
from stable_baselines3.common.vec_env import VecCheckNan, VecMonitor, VecNormalize

from swarm_envs.training import SharedPolicyVecEnv
from tests.helpers.living import living

ENVS, DRONES = 3, 2
QUICK: dict[str, Any] = {"num_drones": DRONES, "horizon_s": 0.5}


def quick(**options: Any) -> SharedPolicyVecEnv:
    return SharedPolicyVecEnv("swap_v1", num_envs=ENVS, **{**QUICK, "seed": 7, **options})


def some_actions(rng: np.random.Generator, step: int) -> np.ndarray:
    """Gentle ones, but for the last team, which at times leaves the arena."""
    actions = rng.uniform(-0.3, 0.3, (ENVS * DRONES, 3)).astype(np.float32)
    if step > 12:
        actions[-DRONES:] = 1.0
    return actions


def same(ours: Any, theirs: Any) -> bool:
    """Return True if two observations of a drone are the same."""
    if isinstance(theirs, dict):
        return all(np.array_equal(ours[name], part) for name, part in theirs.items())
    return np.array_equal(ours, theirs)


def row(batch: Any, k: int) -> Any:
    """Observation k of a batch."""
    return {n: part[k] for n, part in batch.items()} if isinstance(batch, dict) else batch[k]


@pytest.mark.parametrize("observation", ["flat", "dict"])
@pytest.mark.parametrize("horizon_s", [0.5, 4.0])
def test_flights_ends_and_resets_are_those_of_pettingzoo(observation, horizon_s):
    """Each environment beside a parallel one of the seed it must have, through several episodes."""
    options = {**QUICK, "horizon_s": horizon_s, "observation": observation}
    many = quick(**options)
    ones = [swap_v1.parallel_env(physics="batch", **options) for _ in range(ENVS)]
    seen = many.reset()
    rows = [env.reset(seed=7 + e)[0] for e, env in enumerate(ones)]
    rng, cut_ends, crash_ends = np.random.default_rng(0), 0, 0
    for step in range(120):
        actions = some_actions(rng, step)
        before, (seen, rewards, dones, infos) = seen, many.step(actions)
        for e, env in enumerate(ones):
            places = {f"drone_{i}": e * DRONES + i for i in range(DRONES)}
            assert all(same(row(before, k), rows[e][agent]) for agent, k in places.items())
            rows[e], reward, ended, cut, info = env.step({a: actions[k] for a, k in places.items()})
            for agent, k in places.items():
                assert rewards[k] == np.float32(reward[agent])
                assert dones[k] == (ended[agent] or cut[agent])
                assert infos[k]["TimeLimit.truncated"] is cut[agent]
                assert ("terminal_observation" in infos[k]) == dones[k]
                if dones[k]:
                    assert same(infos[k]["terminal_observation"], rows[e][agent])
                    assert infos[k]["episode_metrics"] == info[agent]["episode_metrics"]
                    assert infos[k]["is_success"] is info[agent]["episode_metrics"]["success"]
            if not env.agents:
                cut_ends, crash_ends = cut_ends + cut["drone_0"], crash_ends + ended["drone_0"]
                rows[e] = env.reset()[0]
    assert crash_ends >= 1 and (cut_ends >= 3 or horizon_s > 1)


def test_seeds():
    env = quick()
    first = env.reset()
    assert len(np.unique(first, axis=0)) == ENVS * DRONES  # every one begins elsewhere
    assert not np.array_equal(env.reset(), first)  # goes on
    assert env.seed(7) == [7, 7, 8, 8, 9, 9]
    assert np.array_equal(env.reset(), first)
    shifted = quick(seed=8).reset()
    assert np.array_equal(shifted[:-DRONES], first[DRONES:])
    assert not np.array_equal(quick(seed=None).reset(), quick(seed=None).reset())
    assert env.seed(None) == [None] * 6


def test_options_of_the_next_reset():
    env = quick()
    start = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 1.0]])
    env.set_options({"start": start})
    env.reset()
    assert np.array_equal(env.core.physics.state.position, np.repeat(start[None], ENVS, axis=0))
    env.reset()  # once only
    assert not np.array_equal(env.core.physics.state.position[0], start)
    other = [{"start": start}] * DRONES + [{}] * (2 * DRONES)
    env.set_options(other)
    env.seed(7)
    seeded = env.reset()
    assert np.array_equal(env.core.physics.state.position[0], start)
    assert np.array_equal(seeded[DRONES:], quick().reset()[DRONES:])
    env.set_options([{"start": start}] + [{}] * 5)
    with pytest.raises(ValueError, match="options of sub-environments 0 to 1 differ"):
        env.reset()
    core, before = env.core, living(env.core)
    env.set_options([{"start": start}] * DRONES + [{"team": "SX"}] * (2 * DRONES))
    with pytest.raises(ValueError, match="unknown vehicle token 'X'"):
        env.reset()
    for name, array in living(core).items():
        assert array.tobytes() == before[name].tobytes()  # none of them has begun
    env.set_options([{}] * DRONES + [{"team": "LS"}] * DRONES + [{}] * DRONES)
    env.reset()
    assert ["".join(v.token for v in task.team) for task in core.tasks] == ["SS", "LS", "SS"]
    env.set_options([{}])
    with pytest.raises(ValueError, match="options has 1 entries, but must have 6"):
        env.reset()


@pytest.mark.filterwarnings("ignore:Your observation (neighbors|obstacles) has an unconventional")
@pytest.mark.parametrize("task", TASKS)
def test_sb3s_check_of_gymnasium_environments(task):
    options = {**QUICK, "physics": "batch"}
    check_env(make_joint(task, **options), skip_render_check=True)
    check_env(make_solo(task, **options), skip_render_check=True)
    check_env(make_solo(task, observation="dict", **options), skip_render_check=True)


@pytest.mark.parametrize(
    ("observation", "policy"), [("flat", "MlpPolicy"), ("dict", "MultiInputPolicy")]
)
def test_ppo_learns_a_little(observation, policy, tmp_path):
    """Through SB3's wrappers, which watch for NaN; the saved policy loads and is evaluated."""
    bare = quick(observation=observation, seed=None)
    env = VecNormalize(VecMonitor(VecCheckNan(bare, raise_exception=True)), norm_obs=False)
    model = PPO(policy, env, n_steps=32, batch_size=64, n_epochs=1, seed=3, device="cpu")
    before = [p.detach().clone() for p in model.policy.parameters()]
    model.learn(2 * 32 * ENVS * DRONES)
    assert model.num_timesteps == 2 * 32 * ENVS * DRONES
    after = list(model.policy.parameters())
    assert any(not old.equal(new) for old, new in zip(before, after, strict=True))
    assert all(p.isfinite().all() for p in after)
    assert model.ep_info_buffer is not None and model.ep_info_buffer[0]["l"] <= 24
    model.save(tmp_path / "policy.zip")
    loaded = PPO.load(tmp_path / "policy.zip", device="cpu")
    other = VecMonitor(quick(observation=observation))
    returns, lengths = evaluate_policy(loaded, other, 4, return_episode_rewards=True)
    assert np.isfinite(returns).all() and max(lengths) <= 24


TEAMS = {"interactions": "none", "num_neighbors": 2, "horizon_s": 0.5, "decision_rate": 10}


def test_teams_side_by_side_fly_as_they_would_alone():
    blueprints = [batch_of("swap_v1", num_drones=n, **TEAMS) for n in (2, 3)]
    both = SharedPolicyVecEnv(blueprints, 3)
    alone = [SharedPolicyVecEnv(found, 3) for found in blueprints]
    assert [both.seed(5)[k] for k in (0, 1, 2, 6, 7)] == [5, 5, 6, 11, 11]
    for env, seed in zip(alone, (5, 5 + 2 * 3), strict=True):
        env.seed(seed)
    assert np.array_equal(both.reset(), np.concatenate([env.reset() for env in alone]))
    rng, ended = np.random.default_rng(0), 0
    for _ in range(12):
        actions = rng.uniform(-1, 1, (both.num_envs, both.action_space.shape[0]))
        *arrays, infos = both.step(actions)
        apart = [alone[0].step(actions[:6]), alone[1].step(actions[6:])]
        for k, array in enumerate(arrays):
            assert np.array_equal(array, np.concatenate([one[k] for one in apart]))
        expected = [info for one in apart for info in one[3]]
        assert [info.keys() for info in infos] == [info.keys() for info in expected]
        ended += sum("episode_metrics" in info for info in infos)
    assert ended == 2 * both.num_envs  # two episodes of half a second
    assert both.get_attr("num_drones") == [2] * 6 + [3] * 9
    (metrics,) = both.env_method("metrics", 0, indices=[7])
    assert metrics["length_s"] == alone[1].core.metrics(0)["length_s"]
    for wrong in (np.zeros((14, 3)), np.zeros((16, 3))):
        with pytest.raises(ValueError, match="must be numbers of shape"):
            both.step(wrong)
    start = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 1.0]])
    both.set_options([{"start": start}] * 2 + [{}] * 13)
    both.reset()
    assert np.array_equal(both.core.physics.state.position[0], start)


def test_features_are_observed_in_place_of_rows():
    """Of the last observation of an episode too."""
    plain = quick(num_neighbors=1, physics="batch")
    env = quick(num_neighbors=1, physics="batch", features=True)
    assert np.array_equal(env.reset(), features_of(plain.reset(), 1))
    assert env.observation_space.shape == (feature_sizes(1).width,)
    rng, ends = np.random.default_rng(0), 0
    for step in range(40):
        actions = some_actions(rng, step)
        rows, _, _, expected = plain.step(actions)
        seen, _, _, infos = env.step(actions)
        assert np.array_equal(seen, features_of(rows, 1))
        for info, other in zip(infos, expected, strict=True):
            if "terminal_observation" in info:
                ends += 1
                last = features_of(other["terminal_observation"], 1)
                assert np.array_equal(info["terminal_observation"], last)
    assert ends


def test_features_are_no_dictionaries():
    with pytest.raises(ValueError, match="features=True replaces the row, but observation is"):
        SharedPolicyVecEnv("swap_v1", 1, features=True, observation="dict")


def test_an_environment_flies_a_blueprint_and_takes_no_options_beside():
    found = batch_of("swap_v1", num_drones=3, horizon_s=0.5)
    env = SharedPolicyVecEnv(found, num_envs=2, seed=0)
    assert env.core.task is found.task
    assert env.reset().shape[0] == 6
    with pytest.raises(TypeError, match=r"num_drones: give options to the blueprint"):
        SharedPolicyVecEnv(found, num_drones=3)
    other = batch_of("swap_v1", num_drones=3, num_neighbors=1)
    with pytest.raises(ValueError, match="team 1 has observation"):
        SharedPolicyVecEnv([found, other])
    with pytest.raises(ValueError, match="task is empty"):
        SharedPolicyVecEnv([])
    mixed: list[Any] = [other, "swap_v1"]
    with pytest.raises(TypeError, match="must be a task's name"):
        SharedPolicyVecEnv(mixed)
    with pytest.raises(ValueError, match=r"task 'swap_v9'; .* 'swap_v1'"):
        SharedPolicyVecEnv("swap_v9")
    with pytest.raises(ValueError, match="render_mode is 'rgb_array', but env"):
        quick(render_mode="rgb_array")


def test_without_stable_baselines3_it_says_what_to_install(monkeypatch):
    for name in [name for name in sys.modules if name.split(".")[0] == "stable_baselines3"]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "stable_baselines3", None)
    monkeypatch.delitem(sys.modules, "swarm_envs.training.shared_policy")
    with pytest.raises(ImportError, match=r"SharedPolicyVecEnv needs .* 'swarm-envs\[train\]'"):
        swarm_envs.training.SharedPolicyVecEnv  # noqa: B018
    with pytest.raises(AttributeError, match="has no attribute 'SharedPolicyEnv'"):
        swarm_envs.training.SharedPolicyEnv  # noqa: B018


def test_out_of_turn():
    env = quick()
    actions = np.zeros((6, 3))
    with pytest.raises(RuntimeError, match=r"no episode has begun; call reset\(\) first"):
        env.step(actions)
    with pytest.raises(AttributeError, match="cannot set 'time' on single drones"):
        env.set_attr("time", 3)
    assert env.get_attr("num_drones", indices=[0, 1]) == [DRONES, DRONES]
    assert env.env_method("metrics", 0, indices=2)[0]["success"] is False
    assert env.env_is_wrapped(VecMonitor) == [False] * 6
    env.reset()
    env.close()
    with pytest.raises(RuntimeError, match="closed environment"):
        pickle.dumps(env)
