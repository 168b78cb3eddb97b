"""One tree's side of `benchmarks.against`: measures when it is asked to.

    PYTHONPATH=TREE python -P benchmarks/against_worker.py            answers on a pipe
    PYTHONPATH=TREE python -P benchmarks/against_worker.py first      first steps, once

It runs in trees of other days as well: it uses only what has stayed the same in the package, and
nothing of this folder. A line of JSON asks, a line of JSON answers.
"""

from __future__ import annotations

import importlib
import json
import os
import sys
import time
import traceback
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

import swarm_envs

TASK = "swap_v1" if (Path(swarm_envs.__file__).parent / "swap_v1.py").exists() else "swap_v0"
"""Swaps of the tree that is measured; release 0.1.0 has version 0 alone."""
HOVER_DECISIONS = 96  # flown before the clock starts: 2 s

Call = Callable[[], object]


def environment(engine: str, drones: int, **options: Any) -> Call:
    """A decision of a PettingZoo environment whose drones hover."""
    env = importlib.import_module("swarm_envs").make(
        TASK, num_drones=drones, physics=engine, horizon_s=1e6, end_on_success=False, **options
    )
    still = {agent: np.zeros(3, np.float32) for agent in env.possible_agents}
    env.reset(seed=0)
    for _ in range(HOVER_DECISIONS):
        env.step(still)
    return partial(env.step, still)


def reset(engine: str, drones: int) -> Call:
    """A reset of a PettingZoo environment."""
    env = importlib.import_module("swarm_envs").make(TASK, num_drones=drones, physics=engine)
    env.reset(seed=0)
    return partial(env.reset)


def hovering(envs: int, drones: int, placed: Any = None, threads: int = 1, **options: Any) -> Any:
    """Many environments that have hovered for a while, and zeros as actions."""
    blueprint = importlib.import_module(f"swarm_envs.{TASK}").blueprint
    fixed = {"physics": "batch", "threads": threads, "horizon_s": 1e6, "end_on_success": False}
    task, config, _ = blueprint(num_drones=drones, **fixed, **options)
    core = importlib.import_module("swarm_envs.envs.core").SwarmCore(task, config, envs)
    core.reset(list(range(envs)), **({"options": placed} if placed else {}))
    still = np.zeros((envs, drones, 3))
    for _ in range(HOVER_DECISIONS):
        core.step(still)
    return core, still


def batch(envs: int, drones: int, **options: Any) -> Call:
    """A decision of many environments."""
    core, still = hovering(envs, drones, **options)
    return partial(core.step, still)


def flight(envs: int, drones: int, **options: Any) -> Call:
    """The flight of a decision alone: five physics steps with contacts and counting."""
    core, _ = hovering(envs, drones, **options)
    fly = getattr(core, "flight", core.physics).fly  # of 0.1.0, or of later revisions
    return partial(fly, 5, np.ones(envs, dtype=np.bool_))


MAKERS: dict[str, Callable[..., Call]] = {
    "environment": environment,
    "reset": reset,
    "batch": batch,
    "flight": flight,
}
"""Measurements by name: functions that return a warmed-up function to time."""


def cpu_seconds(call: Call, times: int, clock: Callable[[], float] = time.thread_time) -> float:
    """Time of one call, of this thread's CPU unless the clock is another, s: a run's mean."""
    begin = clock()
    for _ in range(times):
        call()
    return (clock() - begin) / times


def first_steps() -> dict[str, float]:
    """CPU time of this process until each engine has made its first step, s, in turn."""
    found, begin = {}, time.process_time()
    physics = importlib.import_module("swarm_envs.physics")
    swap = importlib.import_module(f"swarm_envs.{TASK}")
    engines = ("bullet", "batch") if physics.bullet_available() else ("batch",)
    for engine in engines:
        env = swap.parallel_env(num_drones=4, physics=engine)
        env.reset(seed=0)
        env.step({agent: np.zeros(3, np.float32) for agent in env.agents})
        found[engine] = time.process_time() - begin
        begin = time.process_time()
    alone = physics.BatchPhysics("SSSS", num_envs=1, interactions="learned")
    alone.step(alone.reset().rotor_thrust.copy())
    found["alone"] = time.process_time() - begin
    return found


def serve() -> None:
    """Answer until the pipe is closed."""
    answers = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)  # what libraries print is no answer
    call: Call | None = None
    for line in sys.stdin:
        order = json.loads(line)
        answer: dict[str, Any]
        try:
            if "make" in order:
                call = None  # frees what was measured before
                call = MAKERS[order["make"]](**order["options"])
                call()
                answer = {"seconds": cpu_seconds(call, 1)}
            else:
                answer = {"seconds": cpu_seconds(call, order["times"])}  # type: ignore[arg-type]
        except Exception as error:  # a tree under construction fails in ways of its own
            traceback.print_exc()
            answer = {"error": " ".join(f"{type(error).__name__}: {error}".split())}
        print(json.dumps(answer), file=answers, flush=True)


if __name__ == "__main__":
    if sys.argv[1:] == ["first"]:
        print(json.dumps(first_steps()))
    else:
        serve()
