"""Speed of one environment, and of gym-pybullet-drones beside it where it is installed.

    make bench
    python -m benchmarks.throughput --json speed.json --peers PYTHON

CPU time, median of repetitions; `make` sets one thread. An agent-step is one drone flying one
decision: 48 a second, on physics at 240 Hz, with `learned` forces as often as `force_rate` says.
`random` starts from the random layout, after 2 s of hovering; `packed` has every drone inside one
interaction volume, which is the worst case.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator
from functools import partial

import numpy as np
import numpy.typing as npt

from benchmarks.against_worker import HOVER_DECISIONS, cpu_seconds
from benchmarks.peers import EFFECTS, peer_row
from benchmarks.rows import Row, run, spread
from swarm_envs import swap_v1
from swarm_envs.physics import bullet_available

SIZES = {"bullet": (4, 16), "batch": (4, 16, 64)}
SPACING = 0.14  # between neighbours of a packed layer, m: 2 cm more than where small drones touch
LAYERS = {4: (1, 0.0), 16: (2, 0.3), 64: (8, 0.15)}
"""Layers of a packed swarm and the height between them, m, by number of drones."""


def packed(num_drones: int) -> npt.NDArray[np.float64]:
    """Positions (N, 3) inside one interaction volume (0.35, 0.35, 1.1 m), m, where none touch."""
    layers, gap = LAYERS[num_drones]
    in_layer = -(-num_drones // layers)
    side = int(np.ceil(np.sqrt(in_layer)))
    layer, place = np.divmod(np.arange(num_drones), in_layer)
    row, column = np.divmod(place, side)
    middle = (side - 1) / 2
    return np.stack([(row - middle) * SPACING, (column - middle) * SPACING, 0.8 + gap * layer], 1)


def environment_row(
    engine: str, num_drones: int, start: str, force_rate: int, repetitions: int
) -> Row:
    """Agent-steps per second of a PettingZoo environment; every repetition has its own start."""
    env = swap_v1.parallel_env(
        num_drones=num_drones,
        physics=engine,
        interactions="learned",
        force_rate=force_rate,
        horizon_s=1e6,
        end_on_success=False,
    )
    still = {agent: np.zeros(3, np.float32) for agent in env.possible_agents}
    options = {"start": packed(num_drones)} if start == "packed" else None
    rates = []
    for seed in range(repetitions):
        env.reset(seed=seed, options=options)
        for _ in range(HOVER_DECISIONS):
            env.step(still)
        rates.append(num_drones / cpu_seconds(partial(env.step, still), max(20, 800 // num_drones)))
    if not env.agents:
        raise RuntimeError(f"{num_drones} drones from {start!r} did not stay in the air")
    env.close()
    counts = {"drones": num_drones, "force_rate": force_rate, "unit": "agent-steps/s"}
    return {"what": f"{engine} environment, {start}", **counts, **spread(rates)}


def rows(options: argparse.Namespace) -> Iterator[Row]:
    """Everything that is measured, in the order of the table."""
    engines = [engine for engine in SIZES if engine != "bullet" or bullet_available()]
    for start in ("random", "packed"):
        for engine in engines:
            for n in SIZES[engine]:
                for force_rate in (240, 48):
                    yield environment_row(engine, n, start, force_rate, options.repetitions)
    for effects in EFFECTS:
        for n in SIZES["bullet"]:
            yield peer_row(options.peers, effects, n, options.repetitions)


def configure(parser: argparse.ArgumentParser) -> None:
    """Add what only this benchmark takes."""
    parser.add_argument("--peers", default=sys.executable, help="interpreter that has the peers")


if __name__ == "__main__":
    run(__doc__, rows, configure=configure)
