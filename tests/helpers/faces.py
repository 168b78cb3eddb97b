"""Every interface in one form, so that a test can be held to all of them."""

from __future__ import annotations

import importlib
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from swarm_envs.envs.core import SwarmCore
from swarm_envs.envs.joint import make_joint, make_solo
from swarm_envs.envs.vector import make_vector
from tests.helpers.living import living


class Face(NamedTuple):
    """An interface to a task, flown by three drones unless it is told otherwise."""

    name: str
    make: Callable[..., Any]  # from a task's name and options; two environments if it makes many
    step: Callable[[Any, list[Any]], Any]
    """Fly with a team's actions, a row for each drone, in every environment; all that it gives."""
    reset: Callable[..., object] = lambda env, **given: env.reset(**given)
    """Begin an episode, with a seed or options."""
    default: str | None = None  # the engine that flies by default, where it is not Bullet
    place: str = ""  # what it says after a drone's name to tell in which environment

    def begin(self, seed: int = 4, task: str = "swap_v1", **options: Any) -> Any:
        """An environment in which an episode has begun."""
        given = {"physics": "batch", "num_drones": 3, "horizon_s": 1.0}
        env = self.make(task, **(given | options))
        self.reset(env, seed=seed)
        return env


def parallel(task: str, **options: Any) -> Any:
    return importlib.import_module(f"swarm_envs.{task}").parallel_env(**options)


def all_at_once(env: Any, rows: list[Any]) -> Any:
    return env.step(dict(zip(env.possible_agents, rows, strict=True)))


def turns(task: str, **options: Any) -> Any:
    return importlib.import_module(f"swarm_envs.{task}").env(**options)


def in_turns(env: Any, rows: list[Any]) -> Any:
    """Return the observations of all agents, in the order of the parallel interface."""
    for row in rows:
        env.step(row)
    seen = {agent: env.observe(agent) for agent in env.possible_agents}
    return seen, env.rewards, env.terminations, env.truncations, env.infos


class Pilot:
    """Flies the other drones of a solo environment; each in turn gets what is next."""

    def __init__(self) -> None:
        self.rows: list[Any] = []

    def __call__(self, observation: Any) -> Any:
        return self.rows.pop(0)


def solo(task: str, **options: Any) -> Any:
    return make_solo(task, drone=0, others=Pilot(), **options)


def step_solo(env: Any, rows: list[Any]) -> Any:
    env.others.rows = list(rows)  # it is asked for every drone's; the first is then put in
    return env.step(rows[0])


def shared_policy(task: str, **options: Any) -> Any:
    from swarm_envs.training import SharedPolicyVecEnv

    return SharedPolicyVecEnv(task, num_envs=2, **options)


def reset_shared(env: Any, seed: Any = None, options: Any = None) -> Any:
    if seed is not None:
        env.seed(seed)
    if options is not None:
        env.set_options(options)
    try:
        return env.reset()
    finally:
        env.set_options()


def joined(rows: list[Any]) -> Any:
    return np.concatenate(rows)


FACES = [
    Face("parallel", parallel, all_at_once),
    Face("turns", turns, in_turns),
    Face("joint", make_joint, lambda env, rows: env.step(joined(rows))),
    Face("solo", solo, step_solo),
    Face(
        "vector",
        lambda task, **options: make_vector(task, 2, **options),
        lambda env, rows: env.step(np.stack([joined(rows)] * 2)),
        default="batch",
        place=" in environment 0",
    ),
    Face(
        "shared policy",
        shared_policy,
        lambda env, rows: env.step(np.stack(rows * 2)),
        reset_shared,
        default="batch",
        place=" in environment 0",
    ),
]


def core_of(env: Any) -> SwarmCore:
    """Return the core beneath an interface."""
    core: SwarmCore = (
        getattr(env, "core", None) or getattr(env.unwrapped, "core", None) or env.parallel.core
    )
    return core


def everything(env: Any) -> bytes:
    """All that changes in its first environment."""
    return b"".join(array[0].tobytes() for array in living(core_of(env)).values())
