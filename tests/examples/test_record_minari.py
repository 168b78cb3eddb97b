"""The example that records a dataset: Minari loads it, and its environment flies the same again."""

from __future__ import annotations

import re
from typing import Any

import numpy as np
import pytest

from swarm_envs import swap_v1
from swarm_envs.agents import fly_episode, load

minari = pytest.importorskip("minari", reason="the extra `minari`")
pytest.importorskip("h5py")
pytestmark = pytest.mark.filterwarnings("default::UserWarning")


@pytest.mark.parametrize("agent", ["roundabout", "tracking"])
def test_the_recovered_environment_repeats_every_flight(agent, tmp_path, monkeypatch, capsys):
    from examples.record_minari import Options, main

    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path))
    options = Options(agent=agent, drones=2, episodes=2, seed=3, name="swap/tiny-v0")
    successes = [flown(agent, seed) for seed in (3, 4)]
    assert main(options) == sum(successes) / 2
    printed = capsys.readouterr().out
    assert f"{sum(successes)} of 2 flights succeeded; wrote {tmp_path}" in printed
    assert "minari.load_dataset('swap/tiny-v0')" in printed
    dataset = minari.load_dataset("swap/tiny-v0")
    env = dataset.recover_environment()
    about = [*dataset.storage.get_episode_metadata([0, 1])]
    for episode, success, seed in zip(dataset, successes, (3, 4), strict=True):
        assert about[seed - 3]["seed"] == seed
        assert np.all(episode.infos["success"] == success)
        check_repeats(env, episode, seed)
    env.close()
    with pytest.raises(ValueError, match="choose another --name"):
        main(options)


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ({"name": "a/b-v0"}, "--name is 'a/b-v0', but must be"),
        ({"name": "bad name"}, "--name is 'bad name', but must be"),
        ({"name": "swap/unversioned"}, "--name is 'swap/unversioned', but must be"),
        ({"episodes": 0}, "--episodes is 0, but must be"),
        ({"seed": -1}, "--seed is -1, but must be"),
        ({"env": "CartPole-v1"}, "unknown --env 'CartPole-v1'"),
        ({"env": "swarm_envs/Swap-v0"}, "did you mean 'swarm_envs/Swap-v1'"),
        ({"env": "swarm_envs/SwapSolo-v1"}, "unknown --env 'swarm_envs/SwapSolo-v1'"),
        ({"agent": "nope"}, "unknown agent 'nope'"),
    ],
)
def test_what_cannot_be_recorded_is_refused_before_anything_is_written(
    wrong, said, tmp_path, monkeypatch
):
    from examples.record_minari import Options, main

    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path))
    with pytest.raises(ValueError, match=re.escape(said)):
        main(Options(**wrong))
    assert not [*tmp_path.iterdir()]


def flown(name: str, seed: int) -> bool:
    agent = load(name)
    env = swap_v1.parallel_env(num_drones=2, physics="batch", **agent.requires)
    return bool(fly_episode(env, agent, seed=seed)["success"])


def check_repeats(env: Any, episode: Any, seed: int) -> None:
    assert not (episode.terminations | episode.truncations)[:-1].any()
    observed, _ = env.reset(seed=seed)
    np.testing.assert_array_equal(observed, episode.observations[0])
    for t, action in enumerate(episode.actions):
        observed, reward, terminated, truncated, _ = env.step(action)
        np.testing.assert_array_equal(observed, episode.observations[t + 1])
        assert reward == pytest.approx(episode.rewards[t], abs=1e-12)
    assert terminated or truncated
