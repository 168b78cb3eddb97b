"""MAPPO's and SAC's parts against closed forms; and that short trainings of two drones do learn."""

from __future__ import annotations

from copy import deepcopy
from functools import partial
from itertools import pairwise, product
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("stable_baselines3")

import gymnasium
import torch
from gymnasium import spaces
from stable_baselines3 import PPO
from stable_baselines3.common.logger import Logger
from torch import nn
from torch.distributions import Normal, TanhTransform, TransformedDistribution

from swarm_envs.agents.evaluation import frozen_seeds
from swarm_envs.agents.policy import Policy
from swarm_envs.training.rl.learner import make_learner
from swarm_envs.training.rl.mappo import SpreadLinear
from swarm_envs.training.rl.recipes import evaluate_policy
from swarm_envs.training.rl.rl_config import DaggerConfig, RlConfig, SacConfig
from swarm_envs.training.rl.run import policy_note
from swarm_envs.training.rl.sac import SoftActorCritic, TwinCritic


def small(algo: str, **options: Any) -> Any:
    """A learner with episodes that end one drone after another."""
    given: dict[str, Any] = {"environments": 8, "seed": 3, "on_contact": "end_pair", "algo": algo}
    given |= {} if algo in ("sac", "dagger") else {"n_steps": 16, "batch_size": 64}
    given |= {"interactions": "none", **options}
    return make_learner(RlConfig(out=Path("never"), **given), "swap_v1")


@pytest.mark.parametrize("algo", ["ppo", "mappo"])
def test_what_is_drawn_is_as_probable_as_stable_baselines3_says(algo):
    made = small(algo, drones=(2, 4))
    policy, seen = made.model.policy, torch.from_numpy(made.env.reset())
    actions, values, log_probs = policy(seen)
    found = policy.evaluate_actions(seen, actions)
    torch.testing.assert_close((values, log_probs), found[:2], atol=1e-5, rtol=1e-5)
    assert torch.equal(policy(seen, deterministic=True)[0], policy._predict(seen, True))


@pytest.mark.parametrize("encoder", ["mlp", "deep-set"])
def test_the_update_is_that_of_stable_baselines3(encoder):
    """From the same rollout and draws, its own method leads to the same weights."""
    made = small("ppo", encoder=encoder, ent_coef=0.1)
    made.fly(range(1))
    model, found = made.model, []
    before = deepcopy((model.policy.state_dict(), model.policy.optimizer.state_dict()))
    for update in (model.train, partial(PPO.train, model)):
        model.policy.load_state_dict(before[0])
        model.policy.optimizer.load_state_dict(deepcopy(before[1]))
        np.random.seed(1)  # noqa: NPY002  # what Stable-Baselines3 draws from
        update()
        found.append(deepcopy(model.policy.state_dict()))
        assert model.logger.name_to_value["train/approx_kl"] > 1e-3
    for name, tensor in found[0].items():
        torch.testing.assert_close(tensor, found[1][name], atol=1e-6, rtol=1e-5)
        assert not torch.equal(tensor, before[0][name])


def test_a_critic_of_the_team_sees_itself_first_and_the_others_in_turn():
    made = small("mappo", drones=(2, 3))
    made.env.reset()
    seen, features = made.env._observations(), made.sizes.width
    width = made.env.core.team_state().shape[-1]
    for core, begin in zip(made.env.cores, (0, 8), strict=True):
        states, drones = core.team_state(), core.num_drones
        own = made.env.observe(core.rows)
        for e, i in product(range(4), range(drones)):
            others = [states[e, (i + k) % drones] for k in range(1, drones)]
            others += [np.zeros(width, np.float32)] * (3 - drones)
            expected = np.concatenate([own[e, i], *others])
            assert np.array_equal(seen[begin + e * drones + i], expected)
    changed = torch.from_numpy(seen.copy())
    changed[:, features:] += 1.0
    policy = made.model.policy
    assert torch.equal(policy.means(changed), policy.means(torch.from_numpy(seen)))
    assert (policy.predict_values(changed) != policy.predict_values(torch.from_numpy(seen))).all()


def test_values_are_in_units_of_the_spread_of_returns():
    torch.manual_seed(0)
    layer, returns = SpreadLinear(nn.Linear(6, 1)), 40.0 + 3.0 * torch.randn(10_000)
    layer.note_returns(returns)
    mean, deviation = layer.spread()
    assert float(mean) == pytest.approx(float(returns.mean()), rel=1e-4)
    assert float(deviation) == pytest.approx(float(returns.std()), rel=1e-2)
    for _ in range(400):
        layer.note_returns(-returns)
    mean, deviation = layer.spread()
    assert float(mean) == pytest.approx(-float(returns.mean()), rel=0.02)
    seen = torch.randn(5, 6)
    assert torch.allclose(layer(seen), layer.linear(seen) * deviation + mean)


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
    model.set_logger(Logger(None, []))
    for _ in range(rounds):
        model._current_progress_remaining = 1.0
        model.train(10, 64)
    return model


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
    given = {"on_contact": "end_team", "steps": 200, "seed": 0, "sac": options}
    made = small("sac", drones=2, environments=4, **given)
    made.fly(range(2))
    first = made.tensors()["memory.actions"].clone()
    assert first.shape == (10, 8, 3)
    made.fly(range(2, 4))
    memory = made.tensors()["memory.actions"]
    assert memory.shape == (15, 8, 3)  # 120 decisions, 8 at a time
    assert torch.equal(memory[5:10], first[5:])  # the others were written over
    assert not torch.equal(memory[:5], first[:5])
    cut = made.tensors()["memory.timeouts"]
    assert cut[9].all() and not cut[5:9].any()  # no return reaches into the next segment
    made.fly(range(4, 5))
    assert not any(name.startswith("memory") for name in made.tensors())


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
    options: dict[str, dict[str, Any]] = {
        "ppo": {"n_steps": 48, "batch_size": 96, "n_epochs": 1, "steps": 48 * 24},
        "sac": {"sac": SacConfig(train_freq=48, learning_starts=600, gradient_steps=2)},
        "dagger": {"dagger": DaggerConfig(train_freq=100, gradient_steps=1, guided=0.0, noise=0.5)},
    }
    made = small(algo, drones=6, environments=4, interactions="learned", **options[algo])
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


EASY: dict[str, Any] = {
    **{
        "seed": 1,
        "steps": 200_000,
        "n_steps": 16,
        "batch_size": 1024,
        "n_epochs": 8,
        "learning_rate": 3e-3,
    },
    **{"num_neighbors": 1, "second_stage": 0.0, "checkpoint_rollouts": 1000},
}
SAC = {"algo": "sac", "layout": "circle", "steps": 800_000}


@pytest.mark.parametrize("options", [EASY, pytest.param(SAC, marks=pytest.mark.slow)])
def test_two_drones_learn_to_swap(options):
    """By PPO in 200,000 decisions; by SAC on a circle, as docs/rl.md says, in a few minutes."""
    made = make_learner(RlConfig(out=Path("never"), drones=2, **options), "swap_v0")
    config, seeds = made.config, frozen_seeds(1, 64)
    layout, flown = str(config.layout), {"num_drones": 2, "force_rate": 48}

    def success() -> float:
        policy = Policy(policy_note(made, "swap_v0"), made.actor(), {})
        return evaluate_policy(policy, "swap_v0", (layout,), seeds, flown)[f"{layout}_success"]

    assert success() < 0.1
    for segment in config.segments():
        entry = made.fly(segment)
    assert entry["step"] == config.rollouts * config.rollout_steps >= config.steps
    assert success() > 0.6
