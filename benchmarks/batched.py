"""Speed of many environments at once, how cost and memory grow, and crazyflow beside.

    make bench
    python -m benchmarks.batched --json batched.json --plot speed.png --peers PYTHON

An agent-step is one drone flying one decision: 48 a second, on physics at 240 Hz, with `learned`
forces as often as `force_rate` says; its time is the CPU's, one thread, but for the rows of
threads, which are wall time. `random` starts from the random layout, after 2 s of hovering;
`packed` has every drone inside one interaction volume.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.against_worker import cpu_seconds, hovering
from benchmarks.peers import RATES, batch_peer_row
from benchmarks.rows import Row, number, run, spread
from benchmarks.throughput import packed
from swarm_envs.envs.core import SwarmCore
from swarm_envs.interactions import load

BATCH = (1024, 4)  # environments and drones of the headline
ENVIRONMENTS = (1, 4, 16, 64, 256, 1024)  # with 4 drones each: how cost grows with E
DRONES = (16, 32, 64, 128, 256)
"""In one environment, whose arena grows with them: how cost grows with N."""
MEMORY = (1024, 16)  # environments and drones whose memory is measured


def make_core(envs: int, drones: int, start: str = "random", **options: Any) -> SwarmCore:
    """A batch of swap environments that hover, 2 s into their episodes."""
    placed = {"start": packed(drones)} if start == "packed" else None
    core: SwarmCore = hovering(envs, drones, placed, **options)[0]
    return core


def rates_of(cores: Sequence[SwarmCore], repetitions: int, wall: bool = False) -> list[list[float]]:
    """Agent-steps per second of each batch, taken in turn so that noise meets all of them."""
    clock = time.perf_counter if wall else time.thread_time
    found: list[list[float]] = [[] for _ in cores]
    for _ in range(repetitions):
        for core, rates in zip(cores, found, strict=True):
            agents = core.num_envs * core.num_drones
            still = np.zeros((core.num_envs, core.num_drones, 3), dtype=np.float32)
            steps = max(4, 40_000 // agents)
            rates.append(agents / cpu_seconds(partial(core.step, still), steps, clock))
    if not all(core.running.all() for core in cores):
        raise RuntimeError("a benchmark's drones did not stay in the air")
    return found


def batch_row(start: str, force_rate: int, precision: str, repetitions: int) -> Row:
    """Agent-steps per second of the batch on one thread."""
    envs, drones = BATCH
    model = load("learned").with_precision(precision)
    core = make_core(envs, drones, start, force_rate=force_rate, interactions=model, threads=1)
    row = _row(f"batch, {start}, {precision}", core)
    return row | spread(rates_of([core], repetitions)[0])


def thread_row(force_rate: int, repetitions: int) -> Row:
    """Return the wall time of one thread over that of two, measured in turn."""
    envs, drones = BATCH
    cores = [make_core(envs, drones, force_rate=force_rate, threads=k) for k in (1, 2)]
    one, two = rates_of(cores, repetitions, wall=True)
    row = _row("two threads over one, wall time", cores[0])
    return row | spread([b / a for a, b in zip(one, two, strict=True)]) | {"unit": "times"}


def hall_row(force_rate: int, forces: str, repetitions: int) -> Row:
    """Return the time of a decision in the hall over that in the ideal world, measured in turn."""
    options: dict[str, Any] = {"force_rate": force_rate, "interactions": forces, "threads": 1}
    cores = [make_core(*BATCH, world=world, **options) for world in ("ideal", "hall")]
    ideal, hall = rates_of(cores, 10 * repetitions)
    row = _row(f"hall over ideal world, random, {forces}", cores[0])
    return row | spread([a / b for a, b in zip(ideal, hall, strict=True)]) | {"unit": "times"}


def scale_rows(sizes: Sequence[tuple[int, int]], repetitions: int) -> Iterator[Row]:
    """CPU time of one decision of batches of (environments, drones), ms, measured in turn."""
    cores = [make_core(envs, drones, threads=1) for envs, drones in sizes]
    for (envs, drones), core, rates in zip(sizes, cores, rates_of(cores, repetitions), strict=True):
        times = [1e3 * envs * drones / rate for rate in rates]
        yield _row("one decision", core) | spread(times) | {"unit": "ms"}


def _row(what: str, core: SwarmCore) -> Row:
    return {
        "what": what,
        "environments": core.num_envs,
        "drones": core.num_drones,
        "force_rate": core.config.force_rate,
        "unit": "agent-steps/s",
    }


MEMORY_SCRIPT = """
from pathlib import Path
from typing import Any
from benchmarks.batched import make_core
make_core({envs}, {drones}, force_rate=48)
print(Path("/proc/self/status").read_text().split("VmHWM:")[1].split()[0])
"""


def memory_row() -> Row:
    """Largest resident memory of a fresh process that flies the batch, everything included."""
    envs, drones = MEMORY
    row = {"what": "memory of the process", "environments": envs, "drones": drones, "unit": "MiB"}
    if not Path("/proc/self/status").exists():  # elsewhere a process inherits its parent's peak
        return row | {"value": None, "note": "needs Linux"}
    script = MEMORY_SCRIPT.format(envs=envs, drones=drones)
    kilobytes = float(subprocess.check_output([sys.executable, "-c", script], text=True))
    return row | {"value": kilobytes / 1024}


def measure(options: argparse.Namespace) -> Iterator[Row]:
    """Everything that is measured, in the order of the table."""
    repetitions = options.repetitions
    for start in ("random", "packed"):
        for force_rate in (240, 48):
            for precision in ("float64", "float32"):
                yield batch_row(start, force_rate, precision, repetitions)
    for force_rate in (240, 48):
        yield thread_row(force_rate, repetitions)
        for forces in ("learned", "wake", "none"):
            yield hall_row(force_rate, forces, repetitions)
    for rates in RATES:
        yield batch_peer_row(options.peers, rates, *BATCH, repetitions)
    yield from scale_rows([(envs, BATCH[1]) for envs in ENVIRONMENTS], repetitions)
    yield from scale_rows([(1, drones) for drones in DRONES], repetitions)
    yield memory_row()


def draw(rows: Sequence[Row], path: Path) -> None:
    """Draw how the cost of a decision grows with environments and with drones."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(8.0, 3.4), layout="constrained")
    scale = [row for row in rows if row["what"] == "one decision"]
    groups = [
        ("environments of 4 drones", "environments", [r for r in scale if r["drones"] == 4]),
        ("drones in one environment", "drones", [r for r in scale if r["environments"] == 1]),
    ]
    for axes, (label, key, found) in zip(figure.subplots(1, 2), groups, strict=True):
        found = [row for row in found if key == "environments" or row["drones"] > 4]
        sizes = np.array([row[key] for row in found])
        times = np.array([row["value"] for row in found])
        middle = times[-1] / sizes[-1]
        axes.loglog(sizes, middle * sizes, color="0.7", linestyle="--", label="linear")
        axes.loglog(sizes, times, marker="o", color="tab:blue", label="measured")
        axes.set(xlabel=label, ylabel="CPU time of a decision, ms")
        axes.set_xticks(sizes, [number(size) if size >= 100 else str(size) for size in sizes])
        axes.minorticks_off()
        axes.legend(frameon=False)
    figure.savefig(path, dpi=110)


def configure(parser: argparse.ArgumentParser) -> None:
    """Add what only this benchmark takes."""
    parser.add_argument("--peers", default=sys.executable, help="interpreter that has the peers")
    parser.add_argument("--plot", type=Path, help="draw how cost grows, as PNG")


if __name__ == "__main__":
    OPTIONS, ROWS = run(__doc__, measure, repetitions=5, configure=configure)
    if OPTIONS.plot is not None:
        draw(ROWS, OPTIONS.plot)
