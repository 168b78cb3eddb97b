"""Mutation testing of the code whose numbers everything else stands on, kernels interpreted.

python -m tests.mutation                           a sample of every group; minutes
python -m tests.mutation --group physics --sample 0     all mutants of one; hours
"""

from __future__ import annotations

import argparse
import json
import os
from collections.abc import Iterator, Mapping
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
Key = tuple[Any, ...]


def judged(group: Group, size: int, seed: int, killed: Mapping[Key, Row]) -> Iterator[Row]:
    """Run the group's tests on a sample of its mutants; what became of each."""
    limits: dict[tuple[str, ...], int] = {}
    chosen = sample(group.modules, size, seed)
    for mutant, source in tqdm(chosen, desc=group.name, unit="mutant", total=size or None):
        row: Row = {**asdict(mutant), "difference": mutant.difference(source)}
        if _key(row) in killed:
            yield killed[_key(row)]
            continue
        tests = group.modules[mutant.path]
        if tests not in limits:
            limits[tests] = 5 + int(4 * warm_up(tests))
        ended = run_tests(tests, limits[tests], (mutant.path, source))
        verdict = "survived" if ended.status == "passed" else ended.status
        yield row | {"group": group.name, "verdict": verdict, "cpu_s": round(ended.cpu_s, 2)}


def _key(row: Row) -> Key:
    return tuple(row[name] for name in ("path", "operator", "occurrence", "difference"))


def _killed_before(out: Path | None) -> dict[Key, Row]:
    """Rows of an interrupted or earlier run; what survived is tried again, on tests of today."""
    if out is None or not out.exists():
        return {}
    rows = json.loads(out.read_text(encoding="utf-8"))
    return {_key(row): row for row in rows if row["verdict"] != "survived"}


def table(rows: list[Row]) -> str:
    """Kills by group and file, as a table of Markdown."""
    lines = ["| group | file | mutants | drawn | killed | by time | % |"]
    lines += ["|---|---|--:|--:|--:|--:|--:|"]
    for name in dict.fromkeys(row["group"] for row in rows):
        of_group = [row for row in rows if row["group"] == name]
        for path in dict.fromkeys(row["path"] for row in of_group):
            drawn = [row for row in of_group if row["path"] == path]
            lines.append(_line(name, f"`{path}`", [path], drawn))
        paths = [path for group in GROUPS if group.name == name for path in group.modules]
        lines.append(_line(f"**{name}**", "", paths, of_group))
    return "\n".join(lines)


def _line(name: str, file: str, paths: list[str], drawn: list[Row]) -> str:
    verdicts = [row["verdict"] for row in drawn]
    killed, slow = len(drawn) - verdicts.count("survived"), verdicts.count("timeout")
    counts = [sum(len(mutants(path)) for path in paths), len(drawn), killed, slow]
    cells = [name, file, *map(str, counts), f"{100 * killed / len(drawn):.0f}"]
    return f"| {' | '.join(cells)} |"


def main(arguments: list[str] | None = None) -> int:
    """Judge a sample of every group, print the table and the survivors."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--group", choices=[g.name for g in GROUPS], action="append")
    parser.add_argument("--sample", type=int, default=100, help="mutants of each group; 0: all")
    parser.add_argument("--seed", type=int, default=0, help="of the sample")
    parser.add_argument("--json", type=Path, help="write what became of each; kills are kept")
    options = parser.parse_args(arguments)
    rows: list[Row] = []
    killed, few = _killed_before(options.json), False
    for group in GROUPS:
        if options.group and group.name not in options.group:
            continue
        begin = len(rows)
        for row in judged(group, options.sample, options.seed, dict(killed)):
            rows.append(row)
            killed.pop(_key(row), None)
            if options.json is not None:
                write_json(options.json, [*rows, *killed.values()])
        verdicts = [row["verdict"] for row in rows[begin:]]
        few |= verdicts.count("survived") > 0.2 * len(verdicts)
    print(table(rows))
    for row in rows:
        if row["verdict"] == "survived":
            print(f"\n{row['path']}:{row['line']} {row['operator']}\n{row['difference']}")
    return int(few)


if __name__ == "__main__":
    raise SystemExit(main())
