"""Threads that share a batch do all of it, each part once, with memory of their own."""

from __future__ import annotations

import functools
import multiprocessing
import sys
import threading
from contextlib import closing

import gymnasium
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from swarm_envs.physics import BatchPhysics
from swarm_envs.physics.workers import Workers, parts
from swarm_envs.training import SharedPolicyVecEnv


@given(st.integers(1, 200), st.integers(1, 40))
def test_parts_are_everything_once_and_as_equal_as_can_be(num_envs: int, count: int) -> None:
    found = parts(num_envs, count)
    assert [e for first, last in found for e in range(first, last)] == list(range(num_envs))
    sizes = [last - first for first, last in found]
    assert len(found) == count
    assert max(sizes) - min(sizes) <= 1


@pytest.mark.parametrize(("num_envs", "threads", "together"), [(1, 2, 1), (5, 2, 32), (64, 3, 8)])
def test_every_environment_is_seen_once_and_no_memory_is_shared(num_envs, threads, together):
    with closing(Workers(num_envs, threads, together)) as workers:
        assert workers.threads == min(num_envs, threads)
        seen: list[int] = []
        users: dict[int, set[int]] = {k: set() for k in range(workers.threads)}

        def call(first: int, last: int, mine: int) -> None:
            seen.extend(range(first, last))
            users[mine].add(threading.get_ident())

        workers.share(call)
    assert sorted(seen) == list(range(num_envs))
    assert all(len(threads) <= 1 for threads in users.values())


def test_what_fails_on_a_thread_is_raised():
    def call(first: int, last: int, mine: int) -> None:
        if mine == 1:
            raise ValueError("no")
        done.wait(5.0)

    done = threading.Event()
    with closing(Workers(64, 2, 1)) as workers, pytest.raises(ValueError, match="no"):
        threading.Timer(0.05, done.set).start()
        workers.share(call)


def batch_physics():
    physics = BatchPhysics("SS", 256, threads=2)
    return functools.partial(physics.step, np.zeros((256, 2, 4)))


def vector_environment():
    env = gymnasium.make_vec("swarm_envs/Swap-v1", num_envs=256, threads=2)
    env.reset(seed=0)
    return functools.partial(env.step, np.zeros(env.action_space.shape, np.float32))


def shared_policy():
    env = SharedPolicyVecEnv("swap_v1", 256, seed=0, threads=2)
    env.reset()
    return functools.partial(env.step, np.zeros((env.num_envs, 3), np.float32))


@pytest.mark.skipif(sys.platform != "linux", reason="processes fork on Linux")
@pytest.mark.filterwarnings("ignore::DeprecationWarning")  # of fork beside threads
@pytest.mark.parametrize("make", [batch_physics, vector_environment, shared_policy])
def test_a_forked_child_steps_with_threads_of_its_own(make):
    step = make()
    step()
    child = multiprocessing.get_context("fork").Process(target=step)
    child.start()
    child.join(60)
    assert child.exitcode == 0, "it hangs or fails"
    step()
