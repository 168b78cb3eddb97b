"""Minari's collector around an environment of Gymnasium: its episodes are those that flew."""

from __future__ import annotations

import gymnasium
import numpy as np
import pytest

import swarm_envs  # noqa: F401 -- registers the environments

minari = pytest.importorskip("minari", reason="run by `make test-compat`")

pytestmark = [pytest.mark.slow, pytest.mark.filterwarnings("default")]


@pytest.mark.parametrize("name", ["swarm_envs/Swap-v1", "swarm_envs/SwapSolo-v1"])
def test_a_collector_records_the_flights(monkeypatch, tmp_path, name):
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path))
    env = gymnasium.make(name, num_drones=2, physics="batch", horizon_s=0.5)
    collector = minari.DataCollector(env)
    flown = []
    for seed in range(2):
        rows, _ = collector.reset(seed=seed)
        over, episode = False, [rows]
        while not over:
            rows, _, terminated, truncated, _ = collector.step(collector.action_space.sample())
            episode.append(rows)
            over = terminated or truncated
        flown.append(np.array(episode))
    dataset = collector.create_dataset("swarm/test-v0")
    kept = [episode.observations for episode in dataset.iterate_episodes()]
    assert len(kept) == 2
    for mine, theirs in zip(flown, kept, strict=True):
        assert np.array_equal(mine, theirs)
