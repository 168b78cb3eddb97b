"""What holds for every task through every interface: spaces, seeds, starts, rewards, memory."""

from __future__ import annotations

import hashlib
import subprocess
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from swarm_envs import TASKS
from tests.helpers.faces import FACES, core_of

every_task = pytest.mark.parametrize("task", TASKS)
QUICK: dict[str, dict[str, Any]] = {"formation_v0": {"shape_s": 0.25, "travel_s": 0.2}}


def begun(face: Any, task: str, seed: int = 4, **options: Any) -> Any:
    return face.begin(seed, task, **(QUICK.get(task, {}) | options))


def rows(rng: np.random.Generator) -> list[np.ndarray]:
    return list(rng.uniform(-0.3, 0.3, (3, 3)).astype(np.float32))


def arrays(value: Any) -> Iterator[np.ndarray]:
    """Every array in what an interface gave."""
    if isinstance(value, np.ndarray):
        yield value
    elif isinstance(value, Mapping):
        for part in value.values():
            yield from arrays(part)
    elif isinstance(value, list | tuple):
        for part in value:
            yield from arrays(part)


def as_bytes(value: Any) -> bytes:
    """All of it: arrays to the last bit, the rest in words."""
    with np.printoptions(threshold=sys.maxsize, floatmode="unique"):
        return (
            b"".join(a.tobytes() + str(a.dtype).encode() for a in arrays(value))
            + repr(value).encode()
        )


def flight(face: Any, env: Any, steps: int = 20) -> bytes:
    """Digest of what an environment gives from here on, across an end where there is one."""
    rng, digest = np.random.default_rng(0), hashlib.sha256()
    for _ in range(steps):
        digest.update(as_bytes(face.step(env, rows(rng))))
    return digest.digest()


def space_of(face: Any, env: Any) -> Any:
    """The space of what a reset or step gives as observation, or of each entry of it."""
    if face.name in ("parallel", "turns"):
        return env.observation_space("drone_1")
    return env.observation_space


@every_task
def test_spec(face, task):
    """Observations and actions lie in their spaces; rewards and ends are of the right kind."""
    env, rng = begun(face, task), np.random.default_rng(0)
    observations, rewards, ends, *rest = face.step(env, rows(rng))
    space = space_of(face, env)
    if face.name in ("parallel", "turns"):
        assert set(observations) == set(rewards) == set(ends) == set(rest[0]) == set(rest[1])
        assert all(space.contains(row) for row in observations.values())
        assert all(type(reward) is float for reward in rewards.values())
        assert all(type(end) is bool for end in [*ends.values(), *rest[0].values()])
        assert env.action_space("drone_0").contains(rows(rng)[0])
    elif face.name in ("joint", "solo"):
        assert space.contains(observations)
        assert type(rewards) is float
        assert type(ends) is type(rest[0]) is bool
        width = 9 if face.name == "joint" else 3
        assert env.action_space.shape == (width,)
    elif face.name == "vector":
        assert space.contains(observations)
        assert rewards.shape == ends.shape == rest[0].shape == (2,)
        assert (rewards.dtype, ends.dtype, rest[0].dtype) == (np.float64, np.bool_, np.bool_)
        assert env.action_space.shape == (2, 9)
    else:
        assert all(space.contains(row) for row in observations)
        assert observations.shape[0] == rewards.size == ends.size == len(rest[0]) == 6
        assert (rewards.dtype, ends.dtype) == (np.float32, np.bool_)
        assert env.action_space.shape == (3,)


@every_task
def test_same_seed_same_bytes(face, task):
    one, other = begun(face, task), begun(face, task)
    first = flight(face, one)
    assert flight(face, other) == first
    face.reset(one, seed=4)
    assert flight(face, one) == first
    face.reset(one, seed=5)
    assert flight(face, one) != first


@every_task
def test_starts_are_random(face, task):
    env, starts = begun(face, task), set()
    for seed in range(6):
        face.reset(env, seed=10 * seed)
        starts.add(core_of(env).physics.state.position[0].round(9).tobytes())
    for _ in range(6):
        face.reset(env)  # goes on with the generator
        starts.add(core_of(env).physics.state.position[0].round(9).tobytes())
    assert len(starts) == 12


@every_task
def test_what_is_returned_is_the_caller_s(face, task):
    """It neither changes later, nor does changing it change the flight."""
    env, other, rng = begun(face, task), begun(face, task), np.random.default_rng(0)
    first, seed = face.step(env, sent := rows(rng)), [row.copy() for row in sent]
    kept = [array.copy() for array in arrays(first)]
    storage = [core_of(env).rows, *core_of(env).world]
    assert np.shares_memory(core_of(env).world.drones, core_of(env).physics.state.position)
    for array in arrays(first):
        assert not any(np.shares_memory(array, mine) for mine in storage)
    second = face.step(env, rows(rng))
    for array, copy in zip(arrays(first), kept, strict=True):
        np.testing.assert_array_equal(array, copy)
    for given, mine in zip(sent, seed, strict=True):
        np.testing.assert_array_equal(given, mine)
    for array in arrays(second):
        if array.flags.writeable and array.dtype.kind == "f":
            array[...] = np.nan
    rng = np.random.default_rng(0)
    for _ in range(2):
        face.step(other, rows(rng))
    assert flight(face, env, 3) == flight(face, other, 3)


@every_task
def test_rewards_are_those_of_the_core(face, task):
    """Bounded by the weights, and summed from the terms where an interface tells them."""
    env, rng = begun(face, task), np.random.default_rng(0)
    twin = begun(FACES[0], task)
    weights = twin.core.task.reward_weights
    highest = sum(abs(weight) for weight in weights.values())
    for _ in range(10):
        sent = rows(rng)
        told, like = face.step(env, sent), twin.step(dict(zip(twin.agents, sent, strict=True)))
        wanted = np.array(list(like[1].values()))
        for agent, info in like[4].items():
            total = sum(weights[name] * term for name, term in info["reward_terms"].items())
            assert like[1][agent] == pytest.approx(total)
        rewards = told[1]
        if isinstance(rewards, dict):
            ours, expected = np.array(list(rewards.values())), wanted
        elif face.name in ("joint", "vector"):
            ours, expected = np.ravel(rewards)[:1], wanted.mean()
            np.testing.assert_array_equal(told[4]["rewards"].reshape(-1, 3)[0], wanted)
        elif face.name == "solo":
            ours, expected = rewards, wanted[0]
        else:
            ours, expected = rewards[:3], wanted.astype(np.float32)
        np.testing.assert_allclose(ours, expected, rtol=1e-15)
        assert np.abs(wanted).max() <= highest


def digests() -> list[str]:
    """One for each task through each interface that is installed here."""
    out = []
    for face in FACES:
        for task in TASKS:
            try:
                out.append(flight(face, begun(face, task), 6).hex())
            except ImportError:
                out.append("not installed")
    return out


def test_same_bytes_in_another_process():
    helpers = str(Path(__file__).parents[1] / "helpers")
    script = (
        f"import runpy, sys; sys.path.insert(0, {helpers!r}); "
        f"here = runpy.run_path({__file__!r}); print(*here['digests'](), sep='\\n')"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert done.stdout.split("\n")[:-1] == digests()
