"""MAPPO: what its critic sees, advantages, and values in units of the spread of returns."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("stable_baselines3")

import torch

from swarm_envs.training.rl.mappo import (
    ActorCriticNetworks,
    MappoLearner,
    generalised_advantages,
)
from swarm_envs.training.rl.rl_config import RlConfig


def test_the_critic_sees_itself_first_and_the_team_in_turn():
    config = RlConfig(out=Path("never"), algo="mappo", drones=3, environments=2, batch_size=96)
    learner = MappoLearner(config, "swap_v0")
    learner.core.reset([0, 1])
    observed = learner._observations()
    seen, states = learner._states(observed).numpy(), learner.core.team_state()
    for e in range(2):
        for i in range(3):
            others = [states[e, (i + k) % 3] for k in (1, 2)]
            assert np.array_equal(seen[e, i], np.concatenate([observed[e, i].numpy(), *others]))


def test_advantages_are_weighed_sums_of_later_errors_of_the_episode():
    draws, decay = np.random.default_rng(0), 0.8
    errors, ended = draws.normal(size=(12, 5)), draws.random((12, 5)) < 0.2
    found = generalised_advantages(torch.from_numpy(errors), torch.from_numpy(ended), decay)
    for column in range(5):
        for t in range(12):
            last = next((k for k in range(t, 12) if ended[k, column]), 11)
            later = np.arange(t, last + 1)
            expected = float(np.sum(decay ** (later - t) * errors[later, column]))
            assert float(found[t, column]) == pytest.approx(expected, abs=1e-12)


def test_values_are_in_units_of_the_spread_of_returns():
    torch.manual_seed(0)
    networks = ActorCriticNetworks(observed=4, state=6, hidden=(8,), actions=3, deviation=0.5)
    returns = 40.0 + 3.0 * torch.randn(10_000)
    networks.note_returns(returns)
    mean, deviation = networks.spread()
    assert float(mean) == pytest.approx(float(returns.mean()), rel=1e-4)
    assert float(deviation) == pytest.approx(float(returns.std()), rel=1e-2)
    for _ in range(400):
        networks.note_returns(-returns)
    assert float(networks.spread()[0]) == pytest.approx(-float(returns.mean()), rel=0.02)
    seen = torch.randn(5, 6)
    mean, deviation = networks.spread()
    foreseen = networks.critic(seen)[:, 0] * deviation + mean
    assert torch.allclose(networks.value(seen), foreseen)


def test_a_decision_is_as_probable_as_the_normal_distribution_says():
    networks = ActorCriticNetworks(observed=4, state=6, hidden=(8,), actions=3, deviation=0.3)
    means, actions = torch.randn(7, 3), torch.randn(7, 3)
    normal = torch.distributions.Normal(means, 0.3)
    wanted = normal.log_prob(actions).sum(-1)
    assert torch.allclose(networks.log_probability(means, actions), wanted, atol=1e-4)
