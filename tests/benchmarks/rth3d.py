"""Makespan, time and memory of RTH3D on the instances that its documentation speaks of.

    python -m tests.benchmarks.rth3d [--only large mirror] [--seeds 1 2 3] [--json FILE]
    python -m tests.benchmarks.rth3d --compile

Every row is planned in a process of its own, after a small plan that loads the kernels. Times are
CPU times, memory is the process's peak. A number that misses its aim is marked with "!".
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
from dataclasses import dataclass
from itertools import pairwise
from multiprocessing import get_context
from pathlib import Path
from typing import Any, NamedTuple

from tqdm import tqdm

from swarm_envs.baselines.rth3d import METHODS, make_instance, plan
from swarm_envs.files import write_json

Row = dict[str, Any]
MOST_MEMORY_MB = 1000.0
COMPACTION_S = 3.0
COMPILATION_S = 20.0


@dataclass(frozen=True)
class Case:
    """An instance, a method, and what is expected: ratios and CPU time are at most so much."""

    group: str
    family: str
    shape: tuple[int, int, int]
    method: str
    ratio: float | None = None
    seconds: float | None = None
    before: float | None = None
    """Of the ratio before compaction."""
    robots: int | None = None
    only_seed: bool = False
    """The family draws nothing at random."""

    @property
    def name(self) -> str:
        """What the table calls it."""
        return f"{self.family} {'x'.join(map(str, self.shape))}"


LARGE = (144, 72, 36)
CASES = (
    Case("large", "uniform", LARGE, "rth3d", before=1.70),
    Case("large", "uniform", LARGE, "rth3d-lba", 1.30, 20.0, before=1.50),
    Case("large", "uniform", LARGE, "auto", 1.05, 60.0),
    Case("large", "quasi-random", LARGE, "rth3d-lba", 1.30, 20.0, before=1.50),
    Case("medium", "uniform", (120, 60, 30), "auto", 1.03, 25.0),
    Case("small", "uniform", (72, 36, 18), "auto", 1.03, 3.0),
    *(
        Case("rings", "rings", (2 * m, 2 * m, m), "rth3d-lba", most, only_seed=True)
        for m, most in ((6, None), (12, None), (18, None), (24, 1.15), (36, 1.15))
    ),
    Case("rings", "rings", (48, 48, 24), "auto", 1.15, only_seed=True),
    Case("blocks", "blocks", (27, 27, 27), "auto", 1.10),
    Case("blocks", "blocks", (36, 36, 36), "auto", 1.10),
    *(
        Case("blocks", "small-blocks", (2 * m, 2 * m, m), "auto", most)
        for m, most in ((12, None), (24, 1.10), (36, 1.10))
    ),
    Case("mirror", "mirror", (48, 24, 12), "auto"),
    Case("mirror", "mirror", (96, 48, 24), "auto", 1.25),
    Case("mirror", "mirror", LARGE, "auto", 1.25, 60.0),
    Case("buildings", "buildings", LARGE, "rth3d-lba", 1.30),
    Case("buildings", "buildings", LARGE, "auto", 1.10),
    *(Case("few", "uniform", (120, 60, 6), "auto", 1.02, robots=n) for n in (144, 720, 4800)),
)


class Job(NamedTuple):
    """A case and a seed."""

    case: Case
    seed: int


def measure(job: Job) -> Row:
    """Plan, and say how good, how long and how large; in a fresh process, as memory is its peak."""
    case, seed = job
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
        "instance": case.name,
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


def _cell(value: float | None, form: str, most: float | None = None) -> str:
    if value is None:
        return ""
    return f"{value:{form}}" + ("!" if most is not None and value > most else "")


HEADS = (
    *("instance", "robots", "method", "seed", "makespan", "before", "ratio"),
    *("s", "compaction, s", "MB", "by"),
)


def cells(case: Case, row: Row) -> tuple[str, ...]:
    """A row of the table."""
    return (
        row["instance"],
        f"{row['robots']:,}",
        row["method"],
        str(row["seed"]),
        str(row["makespan"]),
        _cell(row["before"], ".3f", case.before),
        _cell(row["ratio"], ".3f", case.ratio),
        _cell(row["seconds"], ".1f", case.seconds),
        _cell(row["compaction"] or None, ".2f", COMPACTION_S),
        _cell(row["memory"], ".0f", MOST_MEMORY_MB),
        row["winner"],
    )


def text(lines: Sequence[tuple[str, ...]]) -> str:
    """Aligned columns."""
    widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
    return "\n".join("  ".join(map(str.ljust, line, widths)).rstrip() for line in lines)


def jobs_of(groups: Sequence[str], seeds: Sequence[int]) -> list[Job]:
    """The cases of some groups, for each seed that changes them."""
    chosen = [case for case in CASES if case.group in groups]
    return [Job(c, s) for c in chosen for s in (seeds[:1] if c.only_seed else seeds)]


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
        lines: list[tuple[str, ...]] = [("method", "first call, s", "cached, s")]
        for row in rows:
            first = _cell(row["first"], ".1f", COMPILATION_S)
            lines.append((row["method"], first, f"{row['cached']:.2f}"))
        print(text(lines))
    else:
        rows = _measure_all(jobs_of(options.only, options.seeds))
    if options.json is not None:
        write_json(options.json, rows)


def _measure_all(jobs: Sequence[Job]) -> list[Row]:
    rows: list[Row] = []
    lines: list[tuple[str, ...]] = [HEADS]
    with ProcessPoolExecutor(1, get_context("spawn"), max_tasks_per_child=1) as pool:
        results = pool.map(measure, jobs)
        for job in tqdm(jobs, unit="plan"):
            rows.append(next(results))
            lines.append(cells(job.case, rows[-1]))
            tqdm.write("  ".join(lines[-1]), file=sys.stderr)
    print(text(lines))
    return rows


if __name__ == "__main__":
    main()
