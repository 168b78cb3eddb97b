"""Measure the time of MLR-DMPC for a trajectory and for a round, without message loss.

    python -m benchmarks.mlr_dmpc [--drones 4 8 16 32 64 128 256] [--plans 400]
        [--planes fixed] [--picture scale.png] [--json FILE]

A trajectory's time holds the building of its rows, the solver and the check. A round's planning is
that of all units together; what is left is the protocol. Boxes grow with the swarm: side
4 (N / 16)^(1/2) m. An eighth of the drones is planned in a round, at least 3 and at most 16. Times
are CPU times of one thread.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path
from typing import Literal

import numpy as np
from tqdm import tqdm

from benchmarks.rows import Row, sentence
from swarm_envs.baselines.mlr_dmpc.mlr_dmpc_config import MlrDmpcConfig
from swarm_envs.baselines.mlr_dmpc.swarm import MlrDmpcSwarm
from swarm_envs.baselines.mlr_dmpc.trajectory_qp import Planned
from swarm_envs.files import write_json
from tests.helpers.mlr_rounds import scattered

Planes = Literal["relinearised", "fixed"]
SIZES = (4, 8, 16, 32, 64, 128, 256)


def box_of(n: int, planes: Planes) -> MlrDmpcConfig:
    """The default parameters in a box for n drones."""
    half = 2.0 * np.sqrt(n / 16)
    return MlrDmpcConfig(box=((-half, -half, 0.3), (half, half, 3.0)), planes=planes)


def plan_row(n: int, plans: int, planes: Planes) -> Row:
    """Trajectories of n drones on their way between random places."""
    config, rng = box_of(n, planes), np.random.default_rng(n)
    starts, targets = scattered(n, config, rng), scattered(n, config, rng)
    units = min(max(3, n // 8), 16)
    swarm = MlrDmpcSwarm(starts, targets, config=config, compute_units=units)
    for _ in range(3):
        swarm.run_round()  # compiles
    planned: list[Planned] = []
    rounds, protocol = 0, -time.thread_time()
    while len(planned) < plans:
        planned += [unit.planned for unit in swarm.run_round().units if unit.planned]
        rounds += 1
        away = swarm.reference(np.zeros(1))[:, 0, 0] - swarm.targets
        if (np.linalg.norm(away, axis=1) <= config.arrival_m).all():
            swarm.targets = swarm.targets[rng.permutation(n)]
    protocol += time.thread_time()
    times = [plan.total_ms for plan in planned]
    return {
        "drones": n,
        "units": units,
        "protocol_ms": (1e3 * protocol - sum(times)) / rounds,
        "planning_ms": sum(times) / rounds,
        "plans": len(times),
        "median_ms": float(np.median(times)),
        "p99_ms": float(np.quantile(times, 0.99)),
        "solver_ms": float(np.median([plan.solve_ms for plan in planned])),
        "rows": float(np.mean([plan.num_rows for plan in planned])),
        "in_reach": float(np.mean([plan.in_reach for plan in planned])),
        "rejected": sum(not plan.accepted for plan in planned),
    }


def draw(path: Path, rows: list[Row]) -> None:
    """Draw times and neighbours in reach by the size of the swarm."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(6.0, 4.0), layout="constrained")
    axes = figure.subplots()
    sizes = [row["drones"] for row in rows]
    axes.loglog(sizes, [row["median_ms"] for row in rows], "o-", label="median, ms")
    axes.loglog(sizes, [row["p99_ms"] for row in rows], "o--", label="99 %, ms")
    axes.loglog(sizes, [row["in_reach"] for row in rows], "s:", label="trajectories in reach")
    axes.loglog(sizes, sizes, "k:", alpha=0.4, label="drones")
    axes.set(xlabel="drones", title="A trajectory of MLR-DMPC, one core")
    axes.legend()
    figure.savefig(path)


def main(arguments: list[str] | None = None) -> None:
    """Measure, print, and write what was asked for."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--drones", type=int, nargs="+", default=SIZES, help="sizes of swarms")
    parser.add_argument("--plans", type=int, default=400, help="trajectories of each size")
    parser.add_argument("--planes", default="relinearised", help="or fixed")
    parser.add_argument("--picture", type=Path, help="also draw the times there")
    parser.add_argument("--json", type=Path, help="also write the rows there")
    options = parser.parse_args(arguments)
    rows = []
    for n in tqdm(options.drones, unit="swarm"):
        rows.append(plan_row(n, options.plans, options.planes))
        tqdm.write(sentence(rows[-1]))
    if options.picture is not None:
        draw(options.picture, rows)
    if options.json is not None:
        write_json(options.json, rows)


if __name__ == "__main__":
    main()
