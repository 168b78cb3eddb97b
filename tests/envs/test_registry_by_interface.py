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
