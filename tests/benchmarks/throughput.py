"""Speed of the environments, and of gym-pybullet-drones beside them where it is installed.

    make bench
    python tests/benchmarks/throughput.py --json speed.json

CPU time, median of repetitions; `make` sets one thread. An agent-step is one drone flying one
decision: 48 a second, on physics at 240 Hz, with `learned` forces as often as `force_rate` says.
`random` starts from the random layout, after 2 s of hovering; `packed` has every drone inside one
interaction volume, which is the worst case. Pairs are ordered and counted per drone.
"""

from __future__ import annotations

import argparse
import contextlib
import importlib
import importlib.util
import io
import json
import platform
import statistics
import subprocess
import sys
import time
import warnings
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from tqdm import tqdm

from swarm_envs import swap_v0
from swarm_envs.envs.parallel import SwarmParallelEnv
from swarm_envs.interactions.forces import active_pairs
from swarm_envs.physics import BatchPhysics, bullet_available
from swarm_envs.state import hover_state
from swarm_envs.vehicles import parse_team

Row = dict[str, Any]
Array = npt.NDArray[np.float64]

PEER = "gym-pybullet-drones"
PEER_PHYSICS = {"no effects": "PYB", "ground effect, drag, downwash": "PYB_GND_DRAG_DW"}
SIZES = {"bullet": (1, 4, 16), "batch": (1, 4, 16, 64)}
HOVER_DECISIONS = 96
"""Flown before the clock starts: 2 s."""
SPACING = 0.14
"""Between neighbours of a packed layer, m: 2 cm more than where small drones touch."""
LAYERS = {1: (1, 0.0), 4: (1, 0.0), 16: (2, 0.3), 64: (8, 0.15)}
"""Layers of a packed swarm and the height between them, m, by number of drones."""


def packed(num_drones: int) -> Array:
    """Positions (N, 3) inside one interaction volume (0.35, 0.35, 1.1 m), m, where none touch."""
    layers, gap = LAYERS[num_drones]
    in_layer = -(-num_drones // layers)
    side = int(np.ceil(np.sqrt(in_layer)))
    layer, place = np.divmod(np.arange(num_drones), in_layer)
    row, column = np.divmod(place, side)
    middle = (side - 1) / 2
    return np.stack([(row - middle) * SPACING, (column - middle) * SPACING, 0.8 + gap * layer], 1)


def pairs_per_drone(env: SwarmParallelEnv) -> float:
    """Mean number of drones inside a drone's interaction volume."""
    window = env.core.physics.interactions.field.window
    return active_pairs(window, np.ascontiguousarray(env.view.state.position)) / env.num_agents


def cpu_seconds(call: Callable[[], object], times: int) -> float:
    """CPU time of one call, s: the mean over a run of them."""
    begin = time.process_time()
    for _ in range(times):
        call()
    return (time.process_time() - begin) / times


def environment_row(engine: str, num_drones: int, start: str, repetitions: int) -> Row:
    """Agent-steps per second of a PettingZoo environment; every repetition has its own start."""
    env = swap_v0.parallel_env(
        num_drones=num_drones,
        physics=engine,
        interactions="learned",
        horizon_s=1e6,
        end_on_success=False,
    )
    still = {agent: np.zeros(3, np.float32) for agent in env.possible_agents}
    options = {"start": packed(num_drones)} if start == "packed" else None
    steps = max(20, 800 // num_drones)
    rates, pairs = [], []
    for seed in range(repetitions):
        env.reset(seed=seed, options=options)
        for _ in range(HOVER_DECISIONS):
            env.step(still)
        pairs.append(pairs_per_drone(env))
        rates.append(num_drones / cpu_seconds(lambda: env.step(still), steps))
    if not env.agents:
        raise RuntimeError(f"{num_drones} drones from {start!r} did not stay in the air")
    force_rate = env.core.config.force_rate
    env.close()
    return {
        "what": f"{engine} environment, {start}",
        "drones": num_drones,
        "pairs": statistics.mean(pairs),
        "force_rate": force_rate,
        "value": statistics.median(rates),
        "low": min(rates),
        "high": max(rates),
        "unit": "agent-steps/s",
    }


def peer_row(effects: str, num_drones: int, repetitions: int) -> Row:
    """Agent-steps per second of the peer, at the same rates, its drones hovering 0.5 m apart."""
    row: Row = {
        "what": f"{PEER}, {effects}",
        "drones": num_drones,
        "pairs": None,
        "force_rate": 240,
        "unit": "agent-steps/s",
    }
    if importlib.util.find_spec("gym_pybullet_drones") is None:
        return row | {"value": None, "note": "not installed"}
    with warnings.catch_warnings(), contextlib.redirect_stdout(io.StringIO()):
        warnings.simplefilter("ignore")
        aviary = importlib.import_module("gym_pybullet_drones.envs").MultiHoverAviary
        physics = importlib.import_module("gym_pybullet_drones.utils.enums").Physics
        places = np.arange(num_drones)
        side = int(np.ceil(np.sqrt(num_drones)))
        grid = np.stack([places // side * 0.5, places % side * 0.5, np.ones(num_drones)], axis=1)
        env = aviary(
            num_drones=num_drones,
            initial_xyzs=grid,
            physics=getattr(physics, PEER_PHYSICS[effects]),
            pyb_freq=240,
            ctrl_freq=48,
        )
        hover = np.zeros((num_drones, 4))
        rates = []
        for seed in range(repetitions):
            env.reset(seed=seed)
            env.step(hover)
            steps = max(5, 100 // num_drones)
            rates.append(num_drones / cpu_seconds(lambda: env.step(hover), steps))
        env.close()
    return row | {"value": statistics.median(rates), "low": min(rates), "high": max(rates)}


def reset_row(engine: str, num_drones: int, repetitions: int) -> Row:
    """Milliseconds of a reset."""
    env = swap_v0.parallel_env(num_drones=num_drones, physics=engine)
    env.reset(seed=0)
    times = [1e3 * cpu_seconds(env.reset, 20) for _ in range(repetitions)]
    env.close()
    return {
        "what": f"{engine} environment, reset",
        "drones": num_drones,
        "value": statistics.median(times),
        "low": min(times),
        "high": max(times),
        "unit": "ms",
    }


def physics_row(num_envs: int, num_drones: int, repetitions: int) -> Row:
    """Drone-physics-steps per second of the compiled engine alone, drones as in `random`."""
    team = parse_team("S" * num_drones)
    rng = np.random.default_rng(0)
    position = rng.uniform([-1.7, -1.7, 0.5], [1.7, 1.7, 2.0], (num_envs, num_drones, 3))
    physics = BatchPhysics(team, num_envs)
    hover = hover_state(team, position)
    window = physics.interactions.field.window
    rates = []
    for _ in range(repetitions):
        physics.reset(hover)
        physics.step(hover.rotor_thrust)
        one = cpu_seconds(lambda: physics.step(hover.rotor_thrust), 20)
        rates.append(num_envs * num_drones / one)
    return {
        "what": f"BatchPhysics.step, {num_envs} environments",
        "drones": num_drones,
        "pairs": sum(active_pairs(window, p) for p in position) / (num_envs * num_drones),
        "force_rate": 240,
        "value": statistics.median(rates),
        "low": min(rates),
        "high": max(rates),
        "unit": "drone-physics-steps/s",
    }


def import_row(module: str, repetitions: int) -> Row:
    """Seconds of CPU that a fresh process takes to import a module."""
    script = (
        f"import time; t = time.process_time(); import {module}; print(time.process_time() - t)"
    )
    command = [sys.executable, "-c", script]
    times = [float(subprocess.check_output(command, text=True)) for _ in range(repetitions)]
    return {
        "what": f"import {module}",
        "value": statistics.median(times),
        "low": min(times),
        "high": max(times),
        "unit": "s",
    }


def jobs(repetitions: int) -> Iterator[Callable[[], Row]]:
    """Everything that is measured, in the order of the table."""
    engines = [engine for engine in SIZES if engine != "bullet" or bullet_available()]
    for start in ("random", "packed"):
        for engine in engines:
            for n in SIZES[engine]:
                if start == "random" or n > 1:
                    yield partial(environment_row, engine, n, start, repetitions)
    for effects in PEER_PHYSICS:
        for n in SIZES["bullet"]:
            yield partial(peer_row, effects, n, repetitions)
    for engine in engines:
        yield partial(reset_row, engine, 16, repetitions)
    yield partial(physics_row, 1024, 4, repetitions)
    for module in ("swarm_envs", "swarm_envs.swap_v0"):
        yield partial(import_row, module, repetitions)


def number(value: float | None, digits: int = 1) -> str:
    """A cell of the table."""
    if value is None:
        return ""
    return f"{value:,.0f}" if abs(value) >= 100 else f"{value:.{digits}f}"


def table(rows: list[Row]) -> str:
    """The rows as aligned text."""
    cells = [("", "drones", "pairs a drone", "force rate", "median", "min - max", "unit")]
    for row in rows:
        spread = f"{number(row['low'], 2)} - {number(row['high'], 2)}" if "low" in row else ""
        median = row.get("note") or number(row["value"], 2)
        counts = [number(row.get(key), digits) for key, digits in (("drones", 0), ("pairs", 2))]
        rate = number(row.get("force_rate"), 0)
        cells.append((row["what"], *counts, rate, median, spread, row["unit"]))
    widths = [max(len(line[k]) for line in cells) for k in range(len(cells[0]))]
    return "\n".join(
        "  ".join(
            cell.ljust(width) if k in (0, 6) else cell.rjust(width)
            for k, (cell, width) in enumerate(zip(line, widths, strict=True))
        ).rstrip()
        for line in cells
    )


def main(arguments: list[str] | None = None) -> None:
    """Measure, print the table, and write it as JSON if asked to."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--json", type=Path, help="also write the rows there")
    parser.add_argument("--repetitions", type=int, default=7, help="runs of each (default 7)")
    options = parser.parse_args(arguments)
    if options.repetitions < 1:
        parser.error(f"--repetitions is {options.repetitions}, but must be at least 1")
    rows = [job() for job in tqdm(list(jobs(options.repetitions)), unit="row")]
    print(table(rows))
    if options.json is not None:
        machine = {"python": platform.python_version(), "processor": platform.machine()}
        partial = options.json.with_suffix(".partial")
        partial.write_text(json.dumps({"machine": machine, "rows": rows}, indent=2) + "\n")
        partial.replace(options.json)


if __name__ == "__main__":
    main()
