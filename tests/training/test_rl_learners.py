"""MAPPO's and SAC's parts against closed forms; and that short trainings of two drones do learn."""

from __future__ import annotations

import math
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("stable_baselines3")

import gymnasium
import torch
from gymnasium import spaces
from torch import nn
from torch.distributions import Normal, TanhTransform, TransformedDistribution

from swarm_envs.agents.features import FeatureSizes
from swarm_envs.agents.policy import Policy, PolicyNote
from swarm_envs.training.rl.encoders import EncoderSpec
from swarm_envs.training.rl.learner import make_learner
from swarm_envs.training.rl.mappo import (
    ActorCriticNetworks,
    MappoLearner,
    generalised_advantages,
)
from swarm_envs.training.rl.recipes import evaluate_policy
from swarm_envs.training.rl.rl_config import DaggerConfig, RlConfig, SacConfig
from swarm_envs.training.rl.sac import SacLearner, SoftActorCritic, TwinCritic


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


SPEC = EncoderSpec(FeatureSizes(0, 4, 0, 0), "mlp", "mean", (8,), (), "tanh", ("",))


def test_values_are_in_units_of_the_spread_of_returns():
    torch.manual_seed(0)
    networks = ActorCriticNetworks(SPEC, state=6, actions=3, log_std=-0.7)
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
    networks = ActorCriticNetworks(SPEC, state=6, actions=3, log_std=-1.2)
    means, actions = torch.randn(7, 3), torch.randn(7, 3)
    normal = torch.distributions.Normal(means, math.exp(-1.2))
    wanted = normal.log_prob(actions).sum(-1)
    assert torch.allclose(networks.log_probability(means, actions), wanted, atol=1e-4)


DISCOUNT = 0.6


class Rooms(gymnasium.Env):
    """Spaces for one number seen and one done; nobody steps here."""

    observation_space = spaces.Box(-np.inf, np.inf, (1,), np.float32)
    action_space = spaces.Box(-1.0, 1.0, (1,), np.float32)


def learner(lookahead: int = 1, memory: int = 600, temperature: float = 1e-7) -> SoftActorCritic:
    return SoftActorCritic(
        Rooms(),
        np.full(1, np.nan, np.float32),  # nobody waits
        lookahead,
        DISCOUNT,
        learning_rate=1e-2,
        buffer_size=memory,
        tau=0.2,
        ent_coef=f"auto_{temperature}",
        seed=1,
        device="cpu",
        policy_kwargs={"net_arch": [16, 16], "optimizer_kwargs": {"fused": True}},
    )


def remember(model: SoftActorCritic, seen: float, done: float, after: float, reward: float, **end):
    """One decision; with `ended`, or `cut` by the clock."""
    over = end.get("ended", False) or end.get("cut", False)
    info = {"TimeLimit.truncated": end.get("cut", False)}
    row = (np.array([[value]], np.float32) for value in (seen, after, done))
    model.replay_buffer.add(*row, np.array([reward]), np.array([over]), [info])


def taught(model: SoftActorCritic, rounds: int) -> SoftActorCritic:
    model.set_logger(_Silent())
    for _ in range(rounds):
        model._current_progress_remaining = 1.0
        model.train(10, 64)
    return model


class _Silent:
    def record(self, *_, **__):
        """Nothing."""


def values(model: SoftActorCritic, *rooms: float) -> np.ndarray:
    seen = torch.tensor(rooms)[:, None]
    with torch.no_grad():
        return model.critic(seen, torch.zeros_like(seen)).numpy()


@pytest.mark.parametrize("lookahead", [1, 2, 5])
def test_values_are_discounted_returns_and_only_the_clock_is_bootstrapped(lookahead):
    """Three rooms in a row, a reward of 1 a step: an end stops it, a time-out goes on."""
    model, draws = learner(lookahead), np.random.default_rng(0)
    for _ in range(100):
        for room in (0.0, 1.0, 2.0):
            after = (room + 1.0) if room < 2.0 else 0.0
            remember(model, room, draws.uniform(-1, 1), after, 1.0, cut=room == 2.0)
        for room in (-3.0, -2.0, -1.0):
            remember(model, room, draws.uniform(-1, 1), room + 1.0, 1.0, ended=room == -1.0)
    found = values(taught(model, 20), 0.0, 1.0, 2.0, -3.0, -2.0, -1.0)
    forever = 1.0 / (1.0 - DISCOUNT)
    ending = [1.0 + DISCOUNT + DISCOUNT**2, 1.0 + DISCOUNT, 1.0]
    np.testing.assert_allclose(found, [[forever] * 3 + ending] * 2, atol=0.1)


def test_the_actor_finds_the_best_action_of_each_place():
    model, draws = learner(memory=3000), np.random.default_rng(0)
    for seen, done in draws.uniform(-1.0, 1.0, (3000, 2)):
        remember(model, seen, done, 0.0, -((done - 0.7 * seen) ** 2), ended=True)
    taught(model, 30)
    seen = np.linspace(-0.9, 0.9, 7, dtype=np.float32)[:, None]
    acted, _ = model.predict(seen, deterministic=True)
    np.testing.assert_allclose(acted, 0.7 * seen, atol=0.12)


@pytest.mark.parametrize(
    ("deviation", "rises"), [(0.01, True), (0.08, True), (0.1, False), (0.5, False)]
)
def test_the_temperature_seeks_its_entropy(deviation, rises):
    """-1 for one number: that of a normal deviation of exp(-1) / sqrt(2 pi e) = 0.089."""
    model = learner(temperature=0.1)
    with torch.no_grad():
        for layer in (model.actor.mu, model.actor.log_std):
            layer.weight.zero_()
            layer.bias.zero_()
        model.actor.log_std.bias.fill_(float(np.log(deviation)))
    model._update_actor(torch.zeros(20_000, 1))
    assert (float(model.log_ent_coef.detach().exp()) > 0.1) is rises


def test_densities_are_those_of_a_squashed_normal():
    model = learner()
    seen = torch.linspace(-2.0, 2.0, 64)[:, None]
    actions, found = model._sample_actions(seen)
    mean, log_deviation, _ = model.actor.get_action_dist_params(seen)
    squashed = TransformedDistribution(Normal(mean, log_deviation.exp()), TanhTransform())
    torch.testing.assert_close(found, squashed.log_prob(actions).sum(1), atol=1e-4, rtol=1e-4)


def test_twin_critics_are_two_networks():
    twins, rows = TwinCritic(5, (16, 8)), torch.randn(32, 5)
    both = twins(rows[:, :3], rows[:, 3:])
    for number in (0, 1):
        layers: list[nn.Module] = []
        for place, (into, out) in enumerate(pairwise((5, 16, 8, 1))):
            linear = nn.Linear(into, out)
            linear.weight.data = twins.weights[place][number].T
            linear.bias.data = twins.biases[place][number, 0]
            layers += [linear, nn.LayerNorm(out, elementwise_affine=False), nn.ReLU()]
        alone = nn.Sequential(*layers[:-2])
        torch.testing.assert_close(both[number], alone(rows)[:, 0])
    assert not torch.equal(both[0], both[1])


def test_sac_remembers_the_latest_decisions_and_checkpoints_of_its_end_none():
    options = SacConfig(train_freq=5, learning_starts=1000, buffer_size=120)
    config = RlConfig(
        out=Path("never"), algo="sac", drones=2, environments=4, steps=200, sac=options
    )
    learner = SacLearner(config, "swap_v0")
    learner.fly(range(2))
    first = learner.tensors()["memory.actions"].clone()
    assert first.shape == (10, 8, 3)
    learner.fly(range(2, 4))
    memory = learner.tensors()["memory.actions"]
    assert memory.shape == (15, 8, 3)  # 120 decisions, 8 at a time
    assert torch.equal(memory[5:10], first[5:])  # the others were written over
    assert not torch.equal(memory[:5], first[:5])
    cut = learner.tensors()["memory.timeouts"]
    assert cut[9].all() and not cut[5:9].any()  # no return reaches into the next segment
    learner.fly(range(4, 5))
    assert not any(name.startswith("memory") for name in learner.tensors())


def drawn(made: Any, algo: str) -> tuple[np.ndarray, int]:
    """Observations that a learner learns from, and of how many decisions they are."""
    if algo == "ppo":
        buffer = made.model.rollout_buffer
        rows = torch.cat([batch.observations for batch in buffer.get(32)])
        return rows.numpy(), len(rows)
    if algo == "sac":
        buffer = made.model.replay_buffer
        flew = (buffer.observations[: buffer.pos] != made.env.waiting).any(-1)
        return buffer.sample(500).observations.numpy(), int(flew.sum())
    return made._memory["seen"][: made._filled].numpy(), made._filled


@pytest.mark.parametrize("algo", ["ppo", "sac", "dagger"])
def test_who_waits_for_its_team_is_not_learned_from(algo):
    """Decisions of drones that flew are counted from outside; no zeros of others are drawn."""
    options: dict[str, Any] = {"n_steps": 48, "batch_size": 96, "n_epochs": 1, "steps": 48 * 24}
    if algo == "sac":
        options = {"sac": SacConfig(train_freq=48, learning_starts=600, gradient_steps=2)}
    if algo == "dagger":
        options = {"dagger": DaggerConfig(train_freq=100, gradient_steps=1, guided=0.0, noise=0.5)}
    config = RlConfig(
        out=Path("never"), algo=algo, drones=6, environments=4, on_contact="end_pair", **options
    )
    made: Any = make_learner(config, "swap_v1")
    waits: list[int] = []
    for core in made.env.cores:
        fly = core.step

        def counted(actions, fly=fly):
            result = fly(actions)
            waits.append(int((~result.active).sum()))
            return result

        core.step = counted
    made.fly(range(1))
    rows, flew = drawn(made, algo)
    sizes = [core.num_envs * core.num_drones for core in made.env.cores]
    assert sum(waits) > 5 and flew == len(waits) // len(sizes) * sum(sizes) - sum(waits)
    if algo != "dagger":  # which makes features itself
        assert (rows != made.env.waiting).any(axis=1).all()
    made.close()


MARGIN = 0.5
"""By how much success must rise over the untrained policy's."""


PPO: dict[str, Any] = {
    **{"steps": 200_000, "n_steps": 16, "batch_size": 1024, "n_epochs": 8, "learning_rate": 3e-3},
    **{"num_neighbors": 1, "second_stage": 0.0, "checkpoint_rollouts": 1000},
}
SAC = {"algo": "sac", "layout": "circle", "steps": 800_000}


@pytest.mark.parametrize("options", [PPO, pytest.param(SAC, marks=pytest.mark.slow)])
def test_two_drones_learn_to_swap(options):
    """By PPO in 200,000 decisions; by SAC on a circle, as docs/rl.md says, in a few minutes."""
    config = RlConfig(out=Path("never"), drones=2, **options)
    learner = make_learner(config, "swap_v0")
    layout = str(learner.config.layout)
    seeds = [int(word) for word in np.random.SeedSequence(1).generate_state(64)]
    note = PolicyNote("swap_v0", 2, "acceleration", 10, config.num_neighbors)

    def success() -> float:
        policy, flown = Policy(note, learner.actor(), {}), {"num_drones": 2, "force_rate": 48}
        return evaluate_policy(policy, "swap_v0", (layout,), seeds, flown)[f"{layout}_success"]

    before = success()
    for segment in config.segments():
        entry = learner.fly(segment)
    assert entry["step"] == config.rollouts * config.rollout_steps >= config.steps
    assert before < 0.1
    assert success() > before + MARGIN
