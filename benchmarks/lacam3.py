"""LaCAM* next to LaCAM3 in C++, on the obstacle families of the tests with other seeds.

    python -m benchmarks.lacam3 lacam3/build/main [--seeds 20]

LaCAM3 (Kei18/lacam3) plans flat grids alone; on the others only ours is counted. It runs on one
thread, until its first plan or for 10 s. The checker of ../shared/tools checks every plan of ours,
too. A plan is slow if it takes more than ten times LaCAM3's CPU time and 50 ms.
"""

from __future__ import annotations

import argparse
import re
import subprocess
import tempfile
import time
from pathlib import Path
from typing import NamedTuple

import numpy as np
from tqdm import tqdm

from benchmarks.rows import aligned
from swarm_envs.baselines.rth3d import GridInstance, PlanNotFound, plan
from tests.baselines.rth3d.cases import load_checker
from tests.baselines.rth3d.test_lacam import clutter, crowds, holes, mazes

SHARED = Path(__file__).parents[2] / "shared"
FIRST_SEED = 1000
METHODS = ("lacam", "auto")


class Found(NamedTuple):
    """The plan of a planner."""

    solved: bool
    cpu_s: float
    makespan: float  # nan without a plan


def write_scenario(map_file: Path, scen_file: Path, instance: GridInstance) -> None:
    """Write a flat instance in the format of movingai.com: vertex (x, y, 0) is column x, row y."""
    width, height, _ = instance.shape
    rows = ["".join(row) for row in np.where(instance.obstacles[:, :, 0].T, "@", ".")]
    head = ["type octile", f"height {height}", f"width {width}", "map"]
    map_file.write_text("\n".join([*head, *rows]) + "\n", encoding="utf-8")
    ways = zip(instance.starts, instance.goals, instance.lengths.tolist(), strict=True)
    robots = [
        "\t".join(map(str, (n // 4, map_file.name, width, height, *a[:2], *b[:2], f"{n}.0")))
        for a, b, n in ways
    ]
    scen_file.write_text("\n".join(["version 1", *robots]) + "\n", encoding="utf-8")


def theirs(program: Path, instance: GridInstance) -> Found:
    """LaCAM3's first plan."""
    options = ["-t", "10", "--log_short", "--no-star", "--no-multi-thread"]
    with tempfile.TemporaryDirectory() as folder:
        files = [Path(folder) / name for name in ("a.map", "a.scen", "found.txt")]
        write_scenario(files[0], files[1], instance)
        words = ["-m", str(files[0]), "-i", str(files[1]), "-o", str(files[2])]
        options += ["-N", str(len(instance.starts))]
        subprocess.run([program.resolve(), *words, *options], check=True, capture_output=True)
        said = dict(re.findall(r"^(\w+)=(.*)$", files[2].read_text(), re.MULTILINE))
    solved = said["solved"] == "1"
    makespan = float(said["makespan"]) if solved else np.nan
    return Found(solved, float(said["comp_time"]) / 1e3, makespan)


def ours(instance: GridInstance, method: str) -> Found:
    """Our plan."""
    begin = time.process_time()
    try:
        found = plan(**instance.fields(), method=method)
    except PlanNotFound:
        return Found(False, time.process_time() - begin, np.nan)
    cpu_s = time.process_time() - begin
    assert load_checker(SHARED)(found, found.paths)["ok"]
    return Found(True, cpu_s, found.makespan)


def line(name: str, rows: list[tuple[Found | None, ...]], method: int) -> tuple[str, ...]:
    """A line of the table: a family by a method."""
    pairs = [(row[0], row[1 + method]) for row in rows]
    both = [(other, own) for other, own in pairs if other is not None and own is not None]
    slow = sum(o.solved and m.cpu_s > 10 * o.cpu_s + 0.05 for o, m in both)
    shorter = np.nanmean([m.makespan / (o.makespan or np.nan) for o, m in both] or [np.nan])
    return (
        *(name, METHODS[method], str(len(rows))),
        str(sum(own.solved for _, own in pairs if own is not None)),
        f"{sum(o.solved for o, _ in both)} of {len(both)}",
        *(str(sum(o.solved and not m.solved for o, m in both)), str(slow)),
        *(f"{sum(m.cpu_s for _, m in both):.1f}", f"{sum(o.cpu_s for o, _ in both):.1f}"),
        f"{shorter:.2f}",
    )


def main() -> None:
    """Plan all, and print a line for each family and method."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("program", type=Path)
    parser.add_argument("--seeds", type=int, default=20)
    options = parser.parse_args()
    lines: list[tuple[str, ...]] = [
        (
            *("family", "method", "instances", "solved", "by LaCAM3", "missed", "slow", "CPU s"),
            *("LaCAM3's", "makespan over LaCAM3's"),
        )
    ]
    for family in (mazes, holes, clutter, crowds):
        seeds = range(FIRST_SEED, FIRST_SEED + options.seeds)
        cases = [instance for seed in seeds for instance in family(seed)]
        for method in METHODS:  # compiles, or loads
            ours(cases[0], method)
        rows: list[tuple[Found | None, ...]] = [
            (
                theirs(options.program, case) if case.shape[2] == 1 else None,
                *(ours(case, method) for method in METHODS),
            )
            for case in tqdm(cases, desc=family.__name__)
        ]
        lines += [line(family.__name__, rows, method) for method in range(len(METHODS))]
    print(aligned(lines))


if __name__ == "__main__":
    main()
