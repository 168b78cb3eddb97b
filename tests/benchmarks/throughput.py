"""Speed of the environments, and of gym-pybullet-drones beside them where it is installed.

    make bench
    python -m tests.benchmarks.throughput --json speed.json --peers PYTHON

CPU time, median of repetitions; `make` sets one thread. An agent-step is one drone flying one
decision: 48 a second, on physics at 240 Hz, with `learned` forces as often as `force_rate` says.
`random` starts from the random layout, after 2 s of hovering; `packed` has every drone inside one
interaction volume, which is the worst case. Pairs are ordered and counted per drone.
"""

from __future__ import annotations

import argparse
import statistics
import subprocess
import sys
from collections.abc import Iterator, Sequence
from functools import partial

import numpy as np
import numpy.typing as npt

from swarm_envs import swap_v0
from swarm_envs.envs.parallel import SwarmParallelEnv
from swarm_envs.interactions.forces import active_pairs
from swarm_envs.physics import BatchPhysics, bullet_available
from swarm_envs.state import hover_state
from swarm_envs.vehicles import parse_team
from tests.benchmarks.peers import EFFECTS, peer_row
from tests.benchmarks.rows import Job, Row, cpu_seconds, run, spread

Array = npt.NDArray[np.float64]

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


def environment_row(
    engine: str, num_drones: int, start: str, force_rate: int, repetitions: int
) -> Row:
    """Agent-steps per second of a PettingZoo environment; every repetition has its own start."""
    env = swap_v0.parallel_env(
        num_drones=num_drones,
        physics=engine,
        interactions="learned",
        force_rate=force_rate,
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
    env.close()
    return {
        "what": f"{engine} environment, {start}",
        "drones": num_drones,
        "pairs": statistics.mean(pairs),
        "force_rate": force_rate,
        "unit": "agent-steps/s",
    } | spread(rates)


def reset_row(engine: str, num_drones: int, repetitions: int) -> Row:
    """Milliseconds of a reset."""
    env = swap_v0.parallel_env(num_drones=num_drones, physics=engine)
    env.reset(seed=0)
    times = [1e3 * cpu_seconds(env.reset, 20) for _ in range(repetitions)]
    env.close()
    return {
        "what": f"{engine} environment, reset",
        "drones": num_drones,
        "unit": "ms",
    } | spread(times)


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
        "unit": "drone-physics-steps/s",
    } | spread(rates)


def import_row(module: str, repetitions: int) -> Row:
    """Seconds of CPU that a fresh process takes to import a module."""
    script = (
        f"import time; t = time.process_time(); import {module}; print(time.process_time() - t)"
    )
    command = [sys.executable, "-c", script]
    times = [float(subprocess.check_output(command, text=True)) for _ in range(repetitions)]
    return {
        "what": f"import {module}",
        "unit": "s",
    } | spread(times)


def jobs(options: argparse.Namespace) -> Iterator[Job]:
    """Everything that is measured, in the order of the table."""
    repetitions = options.repetitions
    engines = [engine for engine in SIZES if engine != "bullet" or bullet_available()]
    for start in ("random", "packed"):
        for engine in engines:
            for n in SIZES[engine]:
                for force_rate in (240, 48) if start == "random" or n > 1 else ():
                    yield partial(environment_row, engine, n, start, force_rate, repetitions)
    for effects in EFFECTS:
        for n in SIZES["bullet"]:
            yield partial(peer_row, options.peers, effects, n, repetitions)
    for engine in engines:
        yield partial(reset_row, engine, 16, repetitions)
    yield partial(physics_row, 1024, 4, repetitions)
    for module in ("swarm_envs", "swarm_envs.swap_v0"):
        yield partial(import_row, module, repetitions)


def configure(parser: argparse.ArgumentParser) -> None:
    """Add what only this benchmark takes."""
    parser.add_argument("--peers", default=sys.executable, help="interpreter that has the peers")


def main(arguments: Sequence[str] | None = None) -> None:
    """Measure and print."""
    run(__doc__, jobs, arguments, configure=configure)


if __name__ == "__main__":
    main()
