"""Fly a task for an hour with random actions: `python -m tests.robustness.soak --task swap`.

It asserts that resident memory stays flat, that the two engines fly the same flight until
something touches, that no Bullet client is left behind by `close()` or by an exception, and that no
number is NaN. Exit code 1 if not.
"""

from __future__ import annotations

import argparse
import gc
import itertools
import os
import resource
import sys
import time
from collections import Counter, defaultdict
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from tqdm import tqdm

from swarm_envs import make
from swarm_envs.agents import fly_episode, load
from swarm_envs.envs.core import SwarmCore
from swarm_envs.envs.options import blueprint_of
from swarm_envs.motors import BatteryModel
from swarm_envs.physics import BulletPhysics
from swarm_envs.physics.bullet import import_bullet
from swarm_envs.tasks.obstacles import Column
from tests.helpers.frozen import EVERYTHING

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
    "swap": ("hover", "random", "straight-line", "tracking", "detour", "swap-dagger"),
    "ring": ("hover", "random", "tracking", "tracking-compensated"),
    "formation": ("hover", "random", "straight-line", "tracking"),
}
"""Who flies an episode through PettingZoo between the lives, in turn."""


class Life(NamedTuple):
    """What a life found."""

    drift: float
    """Largest difference of position or velocity from the twin before a contact, m or m/s."""
    compared: int  # Decisions of environments at which it was measured
    episodes: int  # How many ended


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


DRIFT_M = 1e-9  # Largest difference between the engines before a contact, m or m/s
GROWTH_MIB = 6.0
"""Growth of resident memory over what was measured after the warm-up, fitted by a line, MiB."""
ENGINES = {"bullet": {"bullet": 3, "batch": 3}, "batch": {"batch": 32, "bullet": 1}}
"""Environments of the engine that is soaked, and of its twin."""
CLIENTS = 1024  # Bullet numbers its clients up to this


def resident_mib() -> float:
    """Memory that the process holds now."""
    gc.collect()
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
    return pages * resource.getpagesize() / 2**20


def open_clients() -> int:
    """Number of Bullet clients that are connected."""
    bullet = import_bullet()
    info = (bullet.getConnectionInfo(client) for client in range(CLIENTS))
    return sum(bool(entry["isConnected"]) for entry in info)


def soak(options: argparse.Namespace) -> dict[str, Any]:
    """Live, fly and fail until the time is up, in whole rounds of the rota.

    Returns:
        `memory_mib` by time in hours; `drift`, the largest by options; and counts.
    """
    memory: list[tuple[float, float]] = []
    drift: dict[str, float] = defaultdict(float)
    counts = Counter[str]()
    begun, before = time.monotonic(), open_clients()
    hours, agents = options.minutes / 60.0, itertools.cycle(AGENTS[options.task])
    task = f"{options.task}_v0"
    words = np.random.default_rng(options.seed)
    with tqdm(total=round(3600 * hours), unit="s", mininterval=1.0) as bar:
        while (passed := (time.monotonic() - begun) / 3600) < hours or len(memory) < 4:
            for entry in ROTA:
                seed = int(words.integers(2**31))
                life = live(task, entry, ENGINES[options.backend], seed, options.steps)
                name = " ".join([entry["action"], *sorted(set(entry) - {"action"})])
                drift[name] = max(drift[name], life.drift)
                counts += Counter(lives=1, episodes=life.episodes, compared=life.compared)
            fly_agent(task, next(agents), options.backend, int(words.integers(2**31)))
            fail(task, options.backend)
            memory.append((passed, resident_mib()))  # collects what `fail` left behind
            left = open_clients() - before
            assert left == 0, f"{left} Bullet clients were left connected"
            bar.update(round(3600 * min(passed, hours)) - bar.n)
            bar.set_postfix_str(f"{memory[-1][1]:.1f} MiB, drift {max(drift.values()):.1e}")
    return {"memory_mib": memory, "drift": dict(drift), **counts}


def growth(memory: list[tuple[float, float]]) -> float:
    """By how much a line through resident memory grows after the first third, MiB."""
    hours, mib = np.array(memory[len(memory) // 3 :]).T
    return float(np.polyfit(hours, mib, 1)[0] * (hours[-1] - hours[0]))


def main() -> int:
    """Soak, print, and write what was asked for."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--task", default="swap", choices=AGENTS)
    parser.add_argument("--backend", default="bullet", choices=ENGINES, help="the other is beside")
    parser.add_argument("--minutes", type=float, default=60.0, help="how long")
    parser.add_argument("--steps", type=int, default=200, help="decisions of a life")
    parser.add_argument("--seed", type=int, default=0, help="of everything that is drawn")
    found = soak(parser.parse_args())
    grown, drift = growth(found["memory_mib"]), max(found["drift"].values())
    for name, value in {**found, "growth_mib": grown}.items():
        print(f"{name:12} {value}")
    return 1 if grown > GROWTH_MIB or drift > DRIFT_M else 0


if __name__ == "__main__":
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    sys.exit(main())
