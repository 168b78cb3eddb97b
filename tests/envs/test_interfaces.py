"""What holds through every interface: the same flight to the last bit, seeds, memory, copies."""

from __future__ import annotations

import copy
import hashlib
import pickle
import subprocess
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from swarm_envs import TASKS, swap_v0
from swarm_envs.envs.vector import make_vector
from swarm_envs.interactions import load
from swarm_envs.physics import bullet_available
from tests.helpers.faces import FACES, core_of, everything

SHORT: dict[str, Any] = {"num_drones": 3, "horizon_s": 1.0}
every_task = pytest.mark.parametrize("task", TASKS)
QUICK: dict[str, dict[str, Any]] = {"formation_v0": {"shape_s": 0.25, "travel_s": 0.2}}


def begun(face: Any, task: str, seed: int = 4, **options: Any) -> Any:
    return face.begin(seed, task, **(QUICK.get(task, {}) | options))


def rows(rng: np.random.Generator) -> list[np.ndarray]:
    return list(rng.uniform(-0.3, 0.3, (3, 3)).astype(np.float32))


def actions_at(step: int) -> list[np.ndarray]:
    """A team's actions at a step."""
    return rows(np.random.default_rng(step))


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


def by_name(rows: list[np.ndarray]) -> dict[str, np.ndarray]:
    return {f"drone_{i}": row for i, row in enumerate(rows)}


def test_deterministic_flights_are_the_same_to_the_last_bit(face):
    """After each of 24 decisions, on the engine that `deterministic` chooses."""
    env = face.begin(physics=face.default, deterministic=True)
    reference = swap_v0.parallel_env(deterministic=True, **SHORT)
    assert reference.physics_name == "batch"
    reference.reset(seed=4)
    for step in range(24):
        assert everything(env) == everything(reference)
        face.step(env, actions_at(step))
        reference.step(by_name(actions_at(step)))
    assert everything(env) == everything(reference)


@pytest.mark.skipif(not bullet_available(), reason="pybullet is not installed")
def test_what_deterministic_chooses():
    assert swap_v0.parallel_env().physics_name == "bullet"
    assert swap_v0.parallel_env(deterministic=True).physics_name == "batch"
    assert swap_v0.parallel_env(deterministic=True, physics="bullet").physics_name == "bullet"


def test_deterministic_holds_in_float32_and_on_threads():
    fast = load("learned").with_precision("float32")
    many = make_vector("swap_v0", 5, threads=2, interactions=fast, deterministic=True, **SHORT)
    many.reset(seed=0)
    ones = [swap_v0.parallel_env(interactions=fast, deterministic=True, **SHORT) for _ in range(5)]
    for e, env in enumerate(ones):
        env.reset(seed=e)
    for step in range(24):
        many.step(np.stack([np.concatenate(actions_at(step))] * 5))
        for env in ones:
            env.step(by_name(actions_at(step)))
    for e, env in enumerate(ones):
        assert np.array_equal(many.core.physics.state.position[e], env.view.state.position)
    many.close()


@pytest.mark.parametrize("way", ["deepcopy", "pickle"])
def test_copies_fly_on_alike_and_apart(face, way):
    """Through the end of the episode into the next, which the copy begins as the first does."""
    env = face.begin(horizon_s=0.5)
    for step in range(10):
        face.step(env, actions_at(step))
    twin = copy.deepcopy(env) if way == "deepcopy" else pickle.loads(pickle.dumps(env))  # noqa: S301
    start = everything(twin)
    ends = []
    for each in (env, twin):
        assert everything(each) == start
        for step in range(10, 24):
            face.step(each, actions_at(step))
        each.reset()
        face.step(each, actions_at(0))
        ends.append(everything(each))
    assert ends[0] == ends[1] != start


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
    for array, before in zip(arrays(first), kept, strict=True):
        np.testing.assert_array_equal(array, before)
    for given, mine in zip(sent, seed, strict=True):
        np.testing.assert_array_equal(given, mine)
    for array in arrays(second):
        if array.flags.writeable and array.dtype.kind == "f":
            array[...] = np.nan
    rng = np.random.default_rng(0)
    for _ in range(2):
        face.step(other, rows(rng))
    assert flight(face, env, 3) == flight(face, other, 3)


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
