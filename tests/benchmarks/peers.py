"""Speed of other packages, each in a process of its own, pinned to one core.

    python -m tests.benchmarks.peers gym-pybullet-drones PYB 4 3
    python -m tests.benchmarks.peers crazyflow 48 240 1024 4 3

prints agent-steps per second of CPU time, one number a repetition, as JSON. Their requirements
exclude each other's and ours now and then, so `--peers PYTHON` of the benchmarks names the
interpreter of an environment that has them.
"""

from __future__ import annotations

import contextlib
import importlib
import io
import json
import math
import os
import subprocess
import sys
import time
import warnings
from collections.abc import Callable
from typing import Any

from tests.benchmarks.rows import Row, spread

DRONES_PEER, BATCH_PEER = "gym-pybullet-drones", "crazyflow"
EFFECTS = {"no effects": "PYB", "ground effect, drag, downwash": "PYB_GND_DRAG_DW"}
RATES = {"50/500 Hz": (50, 500), "48/240 Hz": (48, 240)}
ONE_THREAD = {
    "SCIPY_ARRAY_API": "1",
    "XLA_FLAGS": "--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1",
}


def peer_row(python: str, effects: str, drones: int, repetitions: int) -> Row:
    """Agent-steps per second of gym-pybullet-drones, hovering 0.5 m apart, at 48/240 Hz."""
    row = {"what": f"{DRONES_PEER}, {effects}", "drones": drones, "force_rate": 240}
    return row | _measured(python, DRONES_PEER, EFFECTS[effects], drones, repetitions)


def batch_peer_row(python: str, rates: str, envs: int, drones: int, repetitions: int) -> Row:
    """Agent-steps per second of crazyflow's simulator; no forces between its drones."""
    row = {"what": f"{BATCH_PEER} simulator, {rates}, no forces", "drones": drones}
    numbers = (*RATES[rates], envs, drones, repetitions)
    return row | {"environments": envs} | _measured(python, BATCH_PEER, *numbers)


def _measured(python: str, peer: str, *arguments: object) -> Row:
    """Value and spread as a peer's process measured them, or a note that it is not installed."""
    command = [python, "-m", "tests.benchmarks.peers", peer, *map(str, arguments)]
    done = subprocess.run(
        command, env=os.environ | ONE_THREAD, capture_output=True, text=True, check=False
    )
    row: Row = {"unit": "agent-steps/s"}
    if done.returncode == 0:
        return row | spread(json.loads(done.stdout.splitlines()[-1]))
    missing = "ModuleNotFoundError" in done.stderr or "No module named" in done.stderr
    reason = "not installed" if missing else done.stderr.strip().splitlines()[-1]
    return row | {"value": None, "note": reason}


def _rates(step: Callable[[], object], agents: int, steps: int, repetitions: int) -> list[float]:
    """Agent-steps per second of the process's CPU time."""
    found = []
    for _ in range(repetitions):
        begin = time.process_time()
        for _ in range(steps):
            step()
        found.append(agents * steps / (time.process_time() - begin))
    return found


def fly_drones_peer(effects: str, drones: int, repetitions: int) -> list[float]:
    """Fly gym-pybullet-drones' multi-drone hover."""
    numpy = importlib.import_module("numpy")
    with warnings.catch_warnings(), contextlib.redirect_stdout(io.StringIO()):
        warnings.simplefilter("ignore")
        aviary = importlib.import_module("gym_pybullet_drones.envs").MultiHoverAviary
        physics = importlib.import_module("gym_pybullet_drones.utils.enums").Physics
        places, side = numpy.arange(drones), math.ceil(math.sqrt(drones))
        grid = [places // side * 0.5, places % side * 0.5, numpy.ones(drones)]
        env = aviary(
            num_drones=drones,
            initial_xyzs=numpy.stack(grid, axis=1),
            physics=getattr(physics, effects),
            pyb_freq=240,
            ctrl_freq=48,
        )
        hover = numpy.zeros((drones, 4))
        env.reset(seed=0)
        env.step(hover)
        found = _rates(lambda: env.step(hover), drones, max(5, 100 // drones), repetitions)
        env.close()
    return found


def fly_batch_peer(
    decision_rate: int, physics_rate: int, envs: int, drones: int, repetitions: int
) -> list[float]:
    """Fly crazyflow's simulator by attitude commands, physics from first principles."""
    simulator = importlib.import_module("crazyflow.sim").Sim
    jax = importlib.import_module("jax")
    sim = simulator(
        n_worlds=envs,
        n_drones=drones,
        physics="first_principles",
        control="attitude",
        freq=physics_rate,
        attitude_freq=physics_rate,
        device="cpu",
    )
    command = jax.numpy.zeros((envs, drones, 4)).at[..., 3].set(0.3)
    sim.reset()

    def step() -> None:
        sim.attitude_control(command)
        sim.step(physics_rate // decision_rate)
        jax.block_until_ready(sim.data)

    step()
    return _rates(step, envs * drones, 10, repetitions)


def main(arguments: list[str]) -> None:
    """Measure the peer that the arguments name and print its rates."""
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
    fly: dict[str, Callable[..., Any]] = {DRONES_PEER: fly_drones_peer, BATCH_PEER: fly_batch_peer}
    values = [int(text) if text.isdigit() else text for text in arguments[1:]]
    print(json.dumps(fly[arguments[0]](*values)))


if __name__ == "__main__":
    main(sys.argv[1:])
