"""Short lives of environments for the soak: options, random actions, the twin, agents, failures."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np

from swarm_envs import make
from swarm_envs.agents import fly_episode, load
from swarm_envs.envs.core import SwarmCore
from swarm_envs.envs.options import blueprint_of
from swarm_envs.envs.randomization import Randomization
from swarm_envs.motors import BatteryModel
from swarm_envs.physics import BulletPhysics
from swarm_envs.tasks.obstacles import Column

EVERYTHING = Randomization(
    mass=(0.9, 1.1),
    inertia=(0.8, 1.2),
    motor_rate=(0.8, 1.2),
    thrust=(0.9, 1.0),
    force_scale=(0.7, 1.3),
    battery=(0.3, 1.0),
    gust_acceleration=0.3,
    position_noise_m=0.005,
    velocity_noise=0.02,
    attitude_noise_rad=0.01,
    body_rate_noise=0.05,
)
"""Domain randomisation with every part on."""
DRAWN: dict[str, Any] = {"randomization": EVERYTHING, "battery": BatteryModel()}
ROTA: tuple[dict[str, Any], ...] = (
    {"action": "acceleration", "decision_rate": 10},
    {"action": "velocity", "decision_rate": 48, "interactions": "wake", **DRAWN},
    {"action": "ctbr", "decision_rate": 48, "observation": "dict"},
    {"action": "rotors", "decision_rate": 120, **DRAWN},
    {"action": "setpoint", "decision_rate": 24, "interactions": "none"},
    {"action": "acceleration", "decision_rate": 10, "team": "LSS*SS", "force_rate": 48, **DRAWN},
    {"action": "acceleration", "decision_rate": 24, "obstacles": (Column((0.0, 0.9), 0.1),)},
)
"""Options of the lives, in turn."""
AGENTS = {
    "swap": ("hover", "random", "straight-line", "tracking", "detour", "swap-ppo"),
    "ring": ("hover", "random", "tracking", "tracking-compensated"),
    "formation": ("hover", "random", "straight-line", "tracking"),
}
"""Who flies an episode through PettingZoo between the lives, in turn."""


class Life(NamedTuple):
    """What a life found."""

    drift: float
    """Largest difference of position or velocity from the twin before a contact, m or m/s."""
    compared: int
    """Decisions of environments at which it was measured."""
    episodes: int
    """How many ended."""


def actions(core: SwarmCore, rng: np.random.Generator, before: np.ndarray | None) -> np.ndarray:
    """Random actions: half of each row anew, half as before, so that flights go somewhere."""
    shape = (core.num_envs, core.num_drones, core.mode.width)
    if not core.mode.bounded:  # set-points: somewhere near the goal, then all else nearly at rest
        near = core.world.drones["goal"] + rng.normal(0.0, 0.3, (*shape[:2], 3))
        return np.concatenate([near, rng.normal(0.0, 0.05, (*shape[:2], 11))], axis=2)
    drawn = rng.uniform(-1.0, 1.0, shape)
    if core.mode.name in ("rotors", "ctbr"):  # about hover, or all would fall within a second
        drawn *= 0.1
    return drawn if before is None else np.where(rng.random(shape) < 0.5, drawn, before)


def live(
    task: str, options: dict[str, Any], engines: dict[str, int], seed: int, steps: int
) -> Life:
    """Fly random actions on two engines at once; the second has some of the first's environments.

    Args:
        task: such as `swap_v0`.
        options: of the environments.
        engines: number of environments of each engine, the one that is soaked first.
        seed: of resets and actions.
        steps: decisions.

    Raises:
        AssertionError: something is not finite, or the engines disagree about an end.
    """
    cores = [
        SwarmCore(*blueprint_of(task, physics=name, **options)[:2], count)
        for name, count in engines.items()
    ]
    try:
        return _fly(cores[0], cores[1], np.random.default_rng(seed), steps)
    finally:
        for core in cores:
            core.close()


def _fly(core: SwarmCore, twin: SwarmCore, rng: np.random.Generator, steps: int) -> Life:
    shared, given, drift, compared = twin.num_envs, None, 0.0, 0
    _begin(core, twin, np.ones(core.num_envs, dtype=np.bool_), rng)
    episodes = 0
    for _ in range(steps):
        given = actions(core, rng, given)
        result, other = core.step(given), twin.step(given[:shared])
        for name in ("observations", "rewards", "reward_terms"):
            assert np.isfinite(getattr(result, name)).all(), f"{name} is not finite"
        ended = result.terminated | result.truncated
        whole = ~result.terminated[:shared] & ~other.terminated
        for one, two in zip(core.physics.state[:2], twin.physics.state[:2], strict=True):
            assert np.isfinite(one[~result.terminated]).all(), "the state is not finite"
            gap = np.abs(one[:shared] - two)[whole]
            drift, compared = max(drift, float(gap.max(initial=0.0))), compared + len(gap)
        if drift < 1e-9:  # else the drift is reported, and ends may well differ
            assert (ended[:shared] == (other.terminated | other.truncated)).all(), "ends differ"
        for metrics in core.metrics_of(np.flatnonzero(ended).tolist()):
            numbers = [v for v in metrics.values() if isinstance(v, int | float)]
            assert np.isfinite(numbers).all(), f"a metric is not finite: {metrics}"
            episodes += 1
        if ended.any():
            _begin(core, twin, ended, rng)
    return Life(drift, compared // 2, episodes)


def _begin(core: SwarmCore, twin: SwarmCore, where: np.ndarray, rng: np.random.Generator) -> None:
    seeds = rng.integers(2**31, size=core.num_envs).tolist()
    core.reset(seeds, where)
    if where[: twin.num_envs].any():
        twin.reset(seeds[: twin.num_envs], where[: twin.num_envs])


def fly_agent(task: str, name: str, physics: str, seed: int) -> None:
    """An episode of an agent that ships, through PettingZoo."""
    agent = load(name)
    env = make(task, **{"physics": physics, "horizon_s": 2.0, **agent.requires})
    try:
        fly_episode(env, agent, seed)
    finally:
        env.close()


def fail(task: str, physics: str) -> None:
    """Leave environments behind as programs with mistakes do: nothing is closed."""
    env = make(task, physics=physics)
    env.reset(seed=0)
    try:
        env.step({agent: np.full(3, np.nan) for agent in env.agents})
    except ValueError:
        pass
    else:
        raise AssertionError("an action that is no number was taken")
    wrong: Iterator[dict[str, Any]] = iter(({"num_envs": -1}, {"obstacles": [[1.0]]}))
    for options in wrong:
        try:
            BulletPhysics("SS", **options)
        except ValueError:
            continue
        raise AssertionError(f"BulletPhysics took {options}")
