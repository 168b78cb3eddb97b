"""Mutation testing of the code whose numbers everything else stands on, kernels interpreted.

python -m tests.mutation                           a sample of every group; minutes
python -m tests.mutation --group physics --sample 0     all mutants of one; hours
"""

from __future__ import annotations

import argparse
import os
from dataclasses import asdict
from pathlib import Path
from typing import Any

os.environ["NUMBA_DISABLE_JIT"] = "1"  # before numba is imported: no kernel sees a mutant compiled

from tqdm import tqdm

from swarm_envs.files import write_json
from tests.mutation.mutants import mutants, sample
from tests.mutation.runner import run_tests, warm_up
from tests.mutation.targets import GROUPS, Group

Row = dict[str, Any]


def judge(group: Group, size: int, seed: int, rows: list[Row], out: Path | None) -> None:
    """Run the group's tests on a sample of its mutants and add what became of each to the rows.

    Raises:
        RuntimeError: the tests fail on the files as they are.
    """
    limits: dict[tuple[str, ...], int] = {}
    chosen = sample(group.modules, size, seed)
    for mutant, source in tqdm(chosen, desc=group.name, unit="mutant", total=size or None):
        tests = group.modules[mutant.path]
        if tests not in limits:
            limits[tests] = 5 + int(4 * warm_up(tests))
        verdict = run_tests(tests, limits[tests], (mutant.path, source))
        found = {
            "group": group.name,
            "verdict": "survived" if verdict.status == "passed" else verdict.status,
            "difference": mutant.difference(source),
            "cpu_s": round(verdict.cpu_s, 2),
        }
        rows.append({**asdict(mutant), **found})
        if out is not None:
            write_json(out, rows)


def table(rows: list[Row]) -> str:
    """Kills by group and file, as a table of Markdown."""
    lines = [
        "| group | file | mutants | drawn | killed | by time | % |",
        "|---|---|--:|--:|--:|--:|--:|",
    ]
    for name in dict.fromkeys(row["group"] for row in rows):
        of_group = [row for row in rows if row["group"] == name]
        for path in dict.fromkeys(row["path"] for row in of_group):
            drawn = [row for row in of_group if row["path"] == path]
            lines.append(_line(name, f"`{path}`", len(mutants(path)), drawn))
        lines.append(_line(f"**{name}**", "", _count(name), of_group))
    return "\n".join(lines)


def _count(name: str) -> int:
    return sum(
        len(mutants(path)) for group in GROUPS if group.name == name for path in group.modules
    )


def _line(name: str, file: str, count: int, drawn: list[Row]) -> str:
    killed = sum(row["verdict"] != "survived" for row in drawn)
    slow = sum(row["verdict"] == "timeout" for row in drawn)
    share = f"{100 * killed / len(drawn):.0f}"
    return f"| {name} | {file} | {count} | {len(drawn)} | {killed} | {slow} | {share} |"


def main(arguments: list[str] | None = None) -> int:
    """Judge a sample of every group, print the table and the survivors.

    Returns:
        0 if every group has 80 % of its mutants killed, else 1.
    """
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--group", choices=[g.name for g in GROUPS], action="append")
    parser.add_argument("--sample", type=int, default=100, help="mutants of each group; 0: all")
    parser.add_argument("--seed", type=int, default=0, help="of the sample")
    parser.add_argument("--json", type=Path, help="write what became of each mutant")
    options = parser.parse_args(arguments)
    rows: list[Row] = []
    for group in GROUPS:
        if options.group and group.name not in options.group:
            continue
        judge(group, options.sample, options.seed, rows, options.json)
    print(table(rows))
    for row in rows:
        if row["verdict"] == "survived":
            print(f"\n{row['path']}:{row['line']} {row['operator']}\n{row['difference']}")
    return int(not all(_passes(rows, name) for name in {row["group"] for row in rows}))


def _passes(rows: list[Row], name: str) -> bool:
    verdicts = [row["verdict"] for row in rows if row["group"] == name]
    return sum(v != "survived" for v in verdicts) >= 0.8 * len(verdicts)


if __name__ == "__main__":
    raise SystemExit(main())
