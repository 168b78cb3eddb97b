"""Shared by all benchmarks: repetitions, medians, tables and JSON."""

from __future__ import annotations

import argparse
import platform
import statistics
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

from tqdm import tqdm

from swarm_envs.files import write_json

Row = dict[str, Any]
HEADS = {"environments": "envs", "drones": "drones", "force_rate": "force rate"}
"""Columns of counts, by the name of a row's entry; those that no row fills are left out."""


def spread(values: Sequence[float]) -> Row:
    """Median and range of repetitions, as a part of a row."""
    return {"value": statistics.median(values), "low": min(values), "high": max(values)}


def number(value: float | None, digits: int = 2) -> str:
    """A cell of the table."""
    if value is None:
        return ""
    return f"{value:,.0f}" if abs(value) >= 100 else f"{value:.{digits}f}"


def aligned(lines: Sequence[Sequence[str]]) -> str:
    """Cells as text in columns."""
    widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
    return "\n".join("  ".join(map(str.ljust, line, widths)).rstrip() for line in lines)


def table(rows: Sequence[Row]) -> str:
    """The rows as text: what was measured, counts, median, range and unit."""
    used = [key for key in HEADS if any(row.get(key) for row in rows)]
    lines = [["", *(HEADS[key] for key in used), "median", "min - max", "unit"]]
    for row in rows:
        counts = [number(row.get(key), 0) for key in used]
        ends = f"{number(row['low'])} - {number(row['high'])}" if "low" in row else ""
        median = row.get("note") or number(row["value"])
        lines.append([row["what"], *counts, median, ends, row["unit"]])
    return aligned(lines)


def sentence(row: Row) -> str:
    """A row of another kind as one line: every entry with its name."""
    return ", ".join(f"{k} {v:.3g}" if isinstance(v, float) else f"{k} {v}" for k, v in row.items())


def run(
    description: str | None,
    measure: Callable[[argparse.Namespace], Iterable[Row]],
    arguments: Sequence[str] | None = None,
    repetitions: int = 7,
    configure: Callable[[argparse.ArgumentParser], None] = lambda parser: None,
) -> tuple[argparse.Namespace, list[Row]]:
    """Measure, print the table, and write it as JSON if asked to."""
    parser = argparse.ArgumentParser(description=(description or "").splitlines()[0])
    parser.add_argument("--json", type=Path, help="also write the rows there")
    parser.add_argument("--repetitions", type=int, default=repetitions, help="runs of each")
    configure(parser)
    options = parser.parse_args(arguments)
    if options.repetitions < 1:
        parser.error(f"--repetitions is {options.repetitions}, but must be at least 1")
    rows = list(tqdm(measure(options), unit="row"))
    print(table(rows))
    if options.json is not None:
        machine = {"python": platform.python_version(), "processor": platform.machine()}
        write_json(options.json, {"machine": machine, "rows": rows})
    return options, rows
