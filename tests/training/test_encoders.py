"""Encoders: sets do not know an order, torch and numpy agree, every type flies its own network."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("stable_baselines3")

import torch
from stable_baselines3.common.type_aliases import RolloutBufferSamples
from torch.distributions import Normal, kl_divergence

from swarm_envs import swap_v0
from swarm_envs.agents import fly_episode
from swarm_envs.agents.networks import ANY, Network, to_tensors
from swarm_envs.agents.policy import Policy, PolicyAgent, read_policy, write_policy
from swarm_envs.training.rl.learner import make_learner
from swarm_envs.training.rl.ppo import PpoLearner
from swarm_envs.training.rl.rl_config import RlConfig
from swarm_envs.training.rl.run import policy_note

SET = {"encoder": "deep-set", "num_neighbors": 4}
KINDS = {
    "sizes": {"drones": (2, 4), "num_neighbors": 3},
    "mean": {"drones": 4, **SET},
    "max": {"team": ("SSLL", "SL"), "pooling": "max", **SET},
    "max and sum": {"drones": (2, 6), "pooling": "max-sum", "activation": "relu", **SET},
    "sum of each type": {"team": ("SSLL",), "pooling": "sum", "per_type": True, **SET},
    "attention": {"drones": (2, 6), "encoder": "attention", "num_neighbors": 4},
    "attention of types": {
        **{"team": ("SSLL", "SL"), "encoder": "attention", "num_neighbors": 3},
        "activation": "relu",
    },
    "a perceptron each": {"team": ("SSLL",), "per_type": True},
}


def make(**given) -> PpoLearner:
    """A learner whose last layers are no longer small, so that actions tell networks apart."""
    options = {"environments": 4, "n_steps": 16, "batch_size": 64, "hidden": (8, 8), **given}
    config = RlConfig(out=Path("never"), interactions="none", **options)
    learner = PpoLearner(config, "swap_v0")
    with torch.no_grad():
        learner.model.policy.action_net.weight.mul_(50.0)
        learner.model.policy.action_net.bias.add_(0.1)
    return learner


def policy_of(learner: PpoLearner) -> Policy:
    return Policy(policy_note(learner, "swap_v0"), learner.actor(), {})


def saved(learner: PpoLearner, folder: Path) -> Path:
    write_policy(folder / "policy.safetensors", policy_of(learner))
    return folder


def rows_of(learner: PpoLearner) -> np.ndarray:
    """Observation rows of every drone after some decisions."""
    learner.env.reset()
    rng = np.random.default_rng(0)
    for _ in range(5):
        learner.env.step(rng.uniform(-1, 1, (learner.env.num_envs, 3)))
    rows = [core.rows for core in learner.env.cores]
    return np.concatenate([row.reshape(-1, row.shape[-1]) for row in rows])


@pytest.mark.parametrize("kind", KINDS)
def test_what_flies_is_what_was_trained(kind, tmp_path):
    learner = make(**KINDS[kind])
    agent = PolicyAgent(read_policy(saved(learner, tmp_path) / "policy.safetensors"))
    rows = rows_of(learner)
    actions, _ = learner.model.predict(learner.env.observe(rows), deterministic=True)
    np.testing.assert_allclose(agent.act_batch(rows), actions, atol=2e-6)
    assert np.ptp(actions, axis=0).min() > 0.01
    options = {**learner.config.teams[0], "physics": "batch", "interactions": "none"}
    env = swap_v0.parallel_env(**options, horizon_s=0.5, **agent.requires)
    assert fly_episode(env, agent, seed=0)["length_s"] > 0


SETS = [kind for kind, options in KINDS.items() if "encoder" in options]


@pytest.mark.parametrize("kind", SETS)
def test_the_order_of_neighbours_changes_nothing(kind):
    learner = make(**KINDS[kind])
    sizes = learner.sizes
    values = learner.env.observe(rows_of(learner))
    own, around = sizes.split(values)
    swapped = np.concatenate([own, around[:, ::-1].reshape(len(own), -1)], axis=1)
    assert not np.array_equal(swapped, values)
    for network in learner.actor().values():
        np.testing.assert_allclose(network(swapped, sizes), network(values, sizes), atol=2e-6)
    before, after = (
        learner.model.policy.predict_values(torch.from_numpy(v)).detach().numpy()
        for v in (values, swapped)
    )
    np.testing.assert_allclose(after, before, atol=2e-6)


@pytest.mark.parametrize("kind", SETS)
def test_who_is_not_there_is_not_in_the_set(kind):
    """Slots with one neighbour act as one slot with the same neighbour, and none as none."""
    learner = make(**KINDS[kind])
    sizes, network = learner.sizes, next(iter(learner.actor().values()))
    values = learner.env.observe(rows_of(learner))
    own, around = sizes.split(values)
    alone = np.concatenate([own, around[:, 0]], axis=1)
    around[:, 1:] = 0.0
    padded = np.concatenate([own, around.reshape(len(own), -1)], axis=1)
    np.testing.assert_allclose(
        network(padded, sizes), network(alone, sizes._replace(num_neighbors=1)), atol=2e-6
    )
    nobody = np.concatenate([own, np.zeros_like(around).reshape(len(own), -1)], axis=1)
    none = sizes._replace(num_neighbors=0)
    np.testing.assert_allclose(network(nobody, sizes), network(own, none), atol=2e-6)


def test_every_type_flies_by_a_network_of_its_own():
    """Whose network is broken shows in who acts otherwise; a phi that is broken, likewise."""
    learner = make(**KINDS["sum of each type"])
    networks, sizes = learner.actor(), learner.sizes
    rows = rows_of(learner)
    large = learner.env.observe(rows)[:, sizes.own_column("L")] == 1.0
    assert large.mean() == 0.5

    def changed(other: dict[str, Network]) -> np.ndarray:
        note = policy_note(learner, "swap_v0")
        first, second = (PolicyAgent(Policy(note, n, {})) for n in (networks, other))
        return (first.act_batch(rows) != second.act_batch(rows)).any(axis=1)

    mute = tuple((weight, bias + 0.3) for weight, bias in networks["L"].layers)
    assert np.array_equal(changed({**networks, "L": replace(networks["L"], layers=mute)}), large)
    blind = tuple((0.0 * weight, bias) for weight, bias in networks["S"].phi or ())
    assert np.array_equal(changed({**networks, "S": replace(networks["S"], phi=blind)}), ~large)


@pytest.mark.parametrize("encoder", ["mlp", "deep-set", "attention"])
@pytest.mark.parametrize("algo", ["mappo", "sac"])
def test_every_algorithm_has_every_encoder(algo, encoder):
    """The network that flies gives the means that are trained; SAC's through a tanh."""
    options: dict[str, Any] = {} if algo == "sac" else {"batch_size": 64, "n_steps": 16}
    options |= {"algo": algo, "encoder": encoder, "interactions": "none", "hidden": (8, 8)}
    config = RlConfig(out=Path("never"), environments=4, **options)
    learner: Any = make_learner(config, "swap_v0")
    values = learner.env.observe(rows_of(learner))
    seen = torch.from_numpy(values)
    policy = learner.network()
    sac = algo == "sac"
    means = policy.actor.get_action_dist_params(seen)[0].tanh() if sac else policy.means(seen)
    found = learner.actor()[ANY](values, learner.sizes)
    np.testing.assert_allclose(found, means.detach().numpy(), atol=2e-6)


@pytest.mark.parametrize("algo", ["mappo", "dagger"])
def test_other_algorithms_begin_as_another_policy_too(algo, tmp_path):
    first = make(drones=4, **SET)
    start = str(saved(first, tmp_path))
    options: dict[str, Any] = {"algo": algo, "start": start, "hidden": (8, 8), **SET}
    options |= {"batch_size": 64, "n_steps": 16} if algo == "mappo" else {}
    config = RlConfig(out=Path("never"), environments=12, interactions="none", **options)
    found = to_tensors(make_learner(config, "swap_v0").actor())
    for name, tensor in to_tensors(first.actor()).items():
        assert np.array_equal(found[name], tensor), name


def test_a_policy_begins_as_another_and_is_drawn_back_to_it(tmp_path):
    """By the gradient of the divergence of normal distributions of the same deviation."""
    first = make(drones=4, **SET)
    config = replace(first.config, start=str(saved(first, tmp_path)), start_kl=3.0, seed=9)
    learner: Any = make_learner(config, "swap_v0")
    values = learner.env.observe(rows_of(learner))
    before = first.model.predict(values, deterministic=True)[0]
    np.testing.assert_allclose(learner.model.predict(values, deterministic=True)[0], before)
    model, seen = learner.model, torch.from_numpy(values)
    with torch.no_grad():
        model.policy.action_net.bias += 0.2
        means = model.policy.means(seen)
    zeros = torch.zeros(len(values))
    batch = RolloutBufferSamples(seen, means + 0.1, zeros, zeros, zeros, zeros)
    found = []
    for model.start_kl in (0.0, 3.0):
        model.policy.log_std.grad = torch.zeros(3)
        found.append([model._loss_gradient(means, batch)[0], model.policy.log_std.grad])
    at, log_std = means.clone().requires_grad_(), model.policy.log_std.detach().requires_grad_()
    away = kl_divergence(Normal(at, log_std.exp()), Normal(means - 0.2, log_std.exp()))
    (3.0 * away.sum(-1).mean()).backward()
    for k, wanted in enumerate((at.grad, log_std.grad)):
        torch.testing.assert_close(found[1][k] - found[0][k], wanted, atol=1e-6, rtol=1e-4)
    with pytest.raises(ValueError, match="the policy to start from has networks"):
        make(drones=4, start=str(tmp_path))


def test_two_types_learn_apart():
    """What only large drones have flown changes their network, and not the small ones'."""
    learner = make(team=("SSLL",), per_type=True)
    policy = learner.model.policy
    values = torch.from_numpy(learner.env.observe(rows_of(learner)))
    large = values[:, learner.sizes.own_column("L")] == 1.0
    small_before = policy.get_distribution(values[~large]).mode().detach()
    optimiser = torch.optim.SGD(policy.pi_features_extractor.parameters(), lr=0.1)
    policy.get_distribution(values[large]).mode().square().sum().backward()
    optimiser.step()
    assert torch.equal(policy.get_distribution(values[~large]).mode(), small_before)


def test_types_that_are_not_there_are_refused():
    with pytest.raises(ValueError, match="--per-type needs vehicles of several types"):
        make(per_type=True)
    learner = make(team=("SSLL",), per_type=True)
    agent = PolicyAgent(policy_of(learner))
    options = {"team": "SSSS*", "physics": "batch", "interactions": "none", **agent.requires}
    env = swap_v0.parallel_env(**options)
    with pytest.raises(ValueError, match=r"trained for vehicles S, L, but the team has S\*"):
        fly_episode(env, agent, seed=0)
