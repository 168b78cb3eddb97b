"""Makespan, time and memory of RTH3D on the instances that its documentation speaks of.

    python -m benchmarks.rth3d [--only large mirror] [--seeds 1 2 3] [--json FILE]
    python -m benchmarks.rth3d --compile

Every row is planned in a process of its own, after a small plan that loads the kernels. Times are
CPU times, memory is the process's peak.
"""

from __future__ import annotations

import argparse
import os
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from itertools import pairwise
from multiprocessing import get_context
from pathlib import Path
from typing import NamedTuple

from tqdm import tqdm

from benchmarks.rows import Row, aligned
from swarm_envs.baselines.rth3d import METHODS, make_instance, plan
from swarm_envs.files import write_json

SINGLE = ("rings",)  # Families that draw nothing at random: one seed is enough


class Case(NamedTuple):
    """An instance and a method."""

    group: str
    family: str
    shape: tuple[int, int, int]
    method: str = "auto"
    robots: int | None = None  # None: as many as the family puts there


def _half(m: int) -> tuple[int, int, int]:
    return (2 * m, 2 * m, m)


def _small(m: int) -> tuple[int, int, int]:
    return (4 * m, 2 * m, m)


LARGE = (144, 72, 36)
CASES = (
    *(Case("large", "uniform", LARGE, method) for method in ("rth3d", "rth3d-lba", "auto")),
    Case("large", "quasi-random", LARGE, "rth3d-lba"),
    Case("medium", "uniform", (120, 60, 30)),
    Case("small", "uniform", (72, 36, 18)),
    *(Case("rings", "rings", _half(m), "rth3d-lba") for m in (6, 12, 18, 24, 36)),
    Case("rings", "rings", _half(24)),
    *(Case("blocks", "blocks", (m, m, m)) for m in (27, 36)),
    *(Case("blocks", "small-blocks", _half(m)) for m in (12, 24, 36)),
    *(Case("mirror", "mirror", _small(m)) for m in (12, 24, 36)),
    *(Case("buildings", "buildings", LARGE, method) for method in ("rth3d-lba", "auto")),
    *(Case("few", "uniform", (120, 60, 6), robots=n) for n in (144, 720, 4800)),
    *(
        Case(family, family, shape)
        for family in ("shift", "reflection", "layers", "ends")
        for m in (6, 12)
        for shape in (_small(m), (2 * m, m, 4 * m), (m, 4 * m, 2 * m))
    ),
    Case("larger", "uniform", (192, 96, 48)),
    *(Case("huge", "uniform", (300, 150, 75), method) for method in ("rth3d-lba", "auto")),
)


def measure(case: Case, seed: int) -> Row:
    """Plan, and say how good, how long and how large; in a fresh process, as memory is its peak."""
    small = make_instance(case.family, (9, 9, 9))
    plan(small.starts, small.goals, small.shape, small.obstacles, case.method)
    instance = make_instance(case.family, case.shape, case.robots, seed)
    marks: list[tuple[str, float]] = []
    begin = time.process_time()
    found = plan(
        instance.starts,
        instance.goals,
        instance.shape,
        instance.obstacles,
        case.method,
        seed,
        watch=lambda phase: marks.append((phase, time.process_time())),
    )
    marks.append(("", time.process_time()))
    spent = {"compaction": 0.0}
    for (phase, since), (_, until) in pairwise(marks):
        spent[phase] = spent.get(phase, 0.0) + until - since
    before = found.before_compaction
    return {
        "instance": f"{case.family} {'x'.join(map(str, case.shape))}",
        "robots": len(found.starts),
        "method": case.method,
        "seed": seed,
        "makespan": found.makespan,
        "before": before / found.lower_bound if before else None,
        "ratio": found.ratio,
        "seconds": marks[-1][1] - begin,
        "compaction": spent["compaction"],
        "memory": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3,
        "winner": found.winner,
        "phases": spent,
    }


def compile_row(method: str) -> Row:
    """The first plan of a method with an empty cache, in a fresh process."""
    code = (
        "import time, sys; from swarm_envs.baselines.rth3d import make_instance, plan\n"
        "i = make_instance('uniform', (12, 9, 6)); begin = time.process_time()\n"
        f"plan(i.starts, i.goals, i.shape, method={method!r}); print(time.process_time() - begin)"
    )
    with tempfile.TemporaryDirectory() as folder:
        env = {**os.environ, "NUMBA_CACHE_DIR": folder}
        times = []
        for _ in ("empty", "filled"):
            done = subprocess.run(
                [sys.executable, "-c", code], env=env, capture_output=True, text=True, check=True
            )
            times.append(float(done.stdout))
            if len(times) == 1 and "compiling" not in done.stderr:
                raise RuntimeError(f"{method!r} compiles without a word: {done.stderr!r}")
    return {"method": method, "first": times[0], "cached": times[1]}


HEADS = (
    *("instance", "robots", "method", "seed", "makespan", "before", "ratio"),
    *("s", "compaction, s", "MB", "by"),
)


def cells(row: Row) -> tuple[str, ...]:
    """A row of the table."""
    return (
        row["instance"],
        f"{row['robots']:,}",
        row["method"],
        str(row["seed"]),
        str(row["makespan"]),
        f"{row['before']:.3f}" if row["before"] else "",
        f"{row['ratio']:.3f}",
        f"{row['seconds']:.1f}",
        f"{row['compaction']:.2f}" if row["compaction"] else "",
        f"{row['memory']:.0f}",
        row["winner"],
    )


def main(arguments: Sequence[str] | None = None) -> None:
    """Measure, print, and write what was asked for."""
    groups = list(dict.fromkeys(case.group for case in CASES))
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--only", nargs="+", choices=groups, default=groups, help="which rows")
    parser.add_argument("--seeds", type=int, nargs="+", default=[1], help="of instance and plan")
    parser.add_argument("--compile", action="store_true", help="time the first call instead")
    parser.add_argument("--json", type=Path, help="also write the rows there")
    options = parser.parse_args(arguments)
    rows: list[Row] = []
    if options.compile:
        rows = [compile_row(method) for method in tqdm(METHODS, unit="method")]
        lines = [("method", "first call, s", "cached, s")]
        lines += [(r["method"], f"{r['first']:.1f}", f"{r['cached']:.2f}") for r in rows]
        print(aligned(lines))
    else:
        chosen = [case for case in CASES if case.group in options.only]
        rows = _measure_all(chosen, options.seeds)
    if options.json is not None:
        write_json(options.json, rows)


def _measure_all(cases: Sequence[Case], seeds: Sequence[int]) -> list[Row]:
    """Rows of each case and each seed that changes it, shown as they come."""
    jobs = [
        (case, seed) for case in cases for seed in (seeds[:1] if case.family in SINGLE else seeds)
    ]
    rows: list[Row] = []
    lines: list[tuple[str, ...]] = [HEADS]
    with ProcessPoolExecutor(1, get_context("spawn"), max_tasks_per_child=1) as pool:
        results = pool.map(measure, *zip(*jobs, strict=True))
        for _ in tqdm(jobs, unit="plan"):
            rows.append(next(results))
            lines.append(cells(rows[-1]))
            tqdm.write("  ".join(lines[-1]), file=sys.stderr)
    print(aligned(lines))
    return rows


if __name__ == "__main__":
    main()
