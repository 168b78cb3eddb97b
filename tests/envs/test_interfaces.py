"""Every interface flies the same flight to the last bit; copies fly on alike and apart."""

from __future__ import annotations

import copy
import pickle
from typing import Any

import numpy as np
import pytest

from swarm_envs import swap_v0
from swarm_envs.envs.vector import make_vector
from swarm_envs.interactions import load
from swarm_envs.physics import bullet_available
from tests.helpers.faces import everything

QUICK: dict[str, Any] = {"num_drones": 3, "horizon_s": 1.0}


def good(step: int) -> list[np.ndarray]:
    rng = np.random.default_rng(step)
    return list(rng.uniform(-0.3, 0.3, (3, 3)).astype(np.float32))


def by_name(rows: list[np.ndarray]) -> dict[str, np.ndarray]:
    return {f"drone_{i}": row for i, row in enumerate(rows)}


def test_deterministic_flights_are_the_same_to_the_last_bit(face):
    """After each of 24 decisions, on the engine that `deterministic` chooses."""
    env = face.begin(physics=face.default, deterministic=True)
    reference = swap_v0.parallel_env(deterministic=True, **QUICK)
    assert reference.physics_name == "batch"
    reference.reset(seed=4)
    for step in range(24):
        assert everything(env) == everything(reference)
        face.step(env, good(step))
        reference.step(by_name(good(step)))
    assert everything(env) == everything(reference)


@pytest.mark.skipif(not bullet_available(), reason="pybullet is not installed")
def test_what_deterministic_chooses():
    assert swap_v0.parallel_env().physics_name == "bullet"
    assert swap_v0.parallel_env(deterministic=True).physics_name == "batch"
    assert swap_v0.parallel_env(deterministic=True, physics="bullet").physics_name == "bullet"


def test_deterministic_holds_in_float32_and_on_threads():
    fast = load("learned").with_precision("float32")
    many = make_vector("swap_v0", 5, threads=2, interactions=fast, deterministic=True, **QUICK)
    many.reset(seed=0)
    ones = [swap_v0.parallel_env(interactions=fast, deterministic=True, **QUICK) for _ in range(5)]
    for e, env in enumerate(ones):
        env.reset(seed=e)
    for step in range(24):
        many.step(np.stack([np.concatenate(good(step))] * 5))
        for env in ones:
            env.step(by_name(good(step)))
    for e, env in enumerate(ones):
        assert np.array_equal(many.core.physics.state.position[e], env.view.state.position)
    many.close()


@pytest.mark.parametrize("way", ["deepcopy", "pickle"])
def test_copies_fly_on_alike_and_apart(face, way):
    """Through the end of the episode into the next, which the copy begins as the first does."""
    env = face.begin(horizon_s=0.5)
    for step in range(10):
        face.step(env, good(step))
    twin = copy.deepcopy(env) if way == "deepcopy" else pickle.loads(pickle.dumps(env))  # noqa: S301
    start = everything(twin)
    ends = []
    for each in (env, twin):
        assert everything(each) == start
        for step in range(10, 24):
            face.step(each, good(step))
        each.reset()
        face.step(each, good(0))
        ends.append(everything(each))
    assert ends[0] == ends[1] != start
