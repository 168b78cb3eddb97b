"""Speed of other packages, each in a process of its own, pinned to one core.

    PYTHON benchmarks/peers.py gym-pybullet-drones PYB 4 3
    PYTHON benchmarks/peers.py crazyflow 48 240 1024 4 3

prints agent-steps per second of CPU time, one number a repetition, as JSON. Their requirements
exclude each other's and ours now and then, so `--peers PYTHON` of the benchmarks names the
interpreter of an environment that has them. This file runs there as it is, so at its top it
imports nothing of ours and nothing that we require.
"""

from __future__ import annotations

import contextlib
import importlib
import inspect
import io
import json
import math
import os
import shutil
import subprocess
import sys
import tempfile
import time
import traceback
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

Row = dict[str, Any]  # as in `benchmarks.rows`

DRONES_PEER, BATCH_PEER = "gym-pybullet-drones", "crazyflow"
MODULES = {DRONES_PEER: "gym_pybullet_drones", BATCH_PEER: "crazyflow"}
"""The module of each peer; if it is missing, the peer is not installed."""
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
    """Value and spread as a peer's process measured them, or a note why there are none."""
    from benchmarks.rows import spread  # ours: the peer's interpreter never comes here

    row: Row = {"unit": "agent-steps/s"}
    found = Path(shutil.which(python) or python).absolute()
    command = [str(found), "-I", str(Path(__file__).absolute()), peer, *map(str, arguments)]
    environ = os.environ | ONE_THREAD
    try:
        with tempfile.TemporaryDirectory() as folder:  # for the logs that peers write
            done = subprocess.run(
                command, env=environ, cwd=folder, capture_output=True, text=True, check=False
            )
    except OSError as error:
        return row | {"value": None, "note": str(error)}
    answer = json.loads(done.stdout.splitlines()[-1]) if done.returncode == 0 else {}
    if "rates" in answer:
        return row | spread(answer["rates"])
    ended = f"the process ended with status {done.returncode}"
    last = (done.stderr.strip().splitlines() or [ended])[-1]
    return row | {"value": None, "note": answer.get("note", last)}


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
    taken = inspect.signature(simulator).parameters
    sim = simulator(
        n_worlds=envs,
        n_drones=drones,
        **{"dynamics" if "dynamics" in taken else "physics": "first_principles"},  # since 0.4
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
    """Measure the peer that the arguments name; print its rates, or why there are none."""
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
    fly: dict[str, Callable[..., Any]] = {DRONES_PEER: fly_drones_peer, BATCH_PEER: fly_batch_peer}
    peer = arguments[0]
    values = [int(text) if text.isdigit() else text for text in arguments[1:]]
    answer: dict[str, Any]
    try:
        answer = {"rates": fly[peer](*values)}
    except Exception as error:  # a peer fails in ways of its own, which the table shows
        traceback.print_exc()
        missing = isinstance(error, ModuleNotFoundError) and error.name == MODULES[peer]
        text = " ".join(f"{type(error).__name__}: {error}".split())
        answer = {"note": "not installed" if missing else text}
    print(json.dumps(answer))


if __name__ == "__main__":
    main(sys.argv[1:])
