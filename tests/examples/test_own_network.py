"""The example of a network of one's own, in Python and on the command line."""

from __future__ import annotations

import re

import numpy as np
import pytest

from swarm_envs import swap_v1
from swarm_envs.cli import main

pytestmark = pytest.mark.filterwarnings("default")


def test_it_is_trained_and_evaluated(tmp_path, monkeypatch, capsys):
    torch = pytest.importorskip("torch")
    pytest.importorskip("stable_baselines3")
    from examples import own_network

    monkeypatch.chdir(tmp_path)
    own_network.main(["--steps", "512", "--envs", "4"])
    agent = own_network.Trained()
    env = swap_v1.parallel_env(physics="batch", **agent.requires)
    observations, _ = env.reset(seed=1)
    agent.reset(env, 1)
    given, space = agent.act(observations, env.view), agent.model.observation_space
    rows = torch.tensor(np.array([*observations.values()]))
    actions = agent.model.policy.get_distribution(rows).mode().detach().numpy()
    np.testing.assert_allclose(np.array([*given.values()]), actions.clip(-1.0, 1.0), atol=1e-6)
    network = agent.model.policy.features_extractor
    assert isinstance(network, own_network.Pooled)
    where = network.where
    other = rows.clone()  # the same neighbors in another order
    other[:, where] = rows[:, where].unflatten(1, (3, -1)).flip(1).flatten(1)
    seen = network(rows)[:, space.shape[0] :]
    torch.testing.assert_close(seen, network(other)[:, space.shape[0] :])
    assert not torch.allclose(seen, network(0.5 * rows)[:, space.shape[0] :])
    words = ["--agent", f"{own_network.__file__}:Trained", "--drones", "4", "--episodes", "2"]
    assert main(["evaluate", *words]) == 0
    assert re.search(r"Trained +\d", capsys.readouterr().out)
