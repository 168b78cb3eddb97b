"""What every benchmark does: repeat, take the median, print a table, write JSON."""

from __future__ import annotations

import argparse
import platform
import statistics
import time
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

from tqdm import tqdm

from swarm_envs.files import write_json

Row = dict[str, Any]
Job = Callable[[], Row]


def cpu_seconds(call: Callable[[], object], times: int) -> float:
    """CPU time of one call in this thread, s: the mean over a run of them."""
    begin = time.thread_time()
    for _ in range(times):
        call()
    return (time.thread_time() - begin) / times


def wall_seconds(call: Callable[[], object], times: int) -> float:
    """Wall time of one call, s: the mean over a run of them."""
    begin = time.perf_counter()
    for _ in range(times):
        call()
    return (time.perf_counter() - begin) / times


def spread(values: Sequence[float]) -> Row:
    """Median and range of repetitions, as a part of a row."""
    return {"value": statistics.median(values), "low": min(values), "high": max(values)}


def number(value: float | None, digits: int = 1) -> str:
    """A cell of the table."""
    if value is None:
        return ""
    return f"{value:,.0f}" if abs(value) >= 100 else f"{value:.{digits}f}"


def table(rows: Sequence[Row]) -> str:
    """The rows as aligned text; columns that no row fills are left out."""
    heads = {"environments": "envs", "drones": "drones", "pairs": "pairs a drone"}
    heads |= {"force_rate": "force rate"}
    used = {key: head for key, head in heads.items() if any(row.get(key) for row in rows)}
    cells = [("", *used.values(), "median", "min - max", "unit")]
    for row in rows:
        counts = [number(row.get(key), 2 if key == "pairs" else 0) for key in used]
        median = row.get("note") or number(row["value"], 2)
        low_high = f"{number(row['low'], 2)} - {number(row['high'], 2)}" if "low" in row else ""
        cells.append((row["what"], *counts, median, low_high, row["unit"]))
    widths = [max(len(line[k]) for line in cells) for k in range(len(cells[0]))]
    ends = (0, len(widths) - 1)
    return "\n".join(
        "  ".join(
            cell.ljust(width) if k in ends else cell.rjust(width)
            for k, (cell, width) in enumerate(zip(line, widths, strict=True))
        ).rstrip()
        for line in cells
    )


def run(
    description: str | None,
    jobs: Callable[[argparse.Namespace], Iterable[Job]],
    arguments: Sequence[str] | None = None,
    repetitions: int = 7,
    configure: Callable[[argparse.ArgumentParser], None] = lambda parser: None,
) -> tuple[argparse.Namespace, list[Row]]:
    """Measure, print the table, and write it as JSON if asked to.

    Args:
        description: the script's docstring.
        jobs: everything that is measured, in the order of the table, given the options.
        arguments: of the command line.
        repetitions: of each measurement, by default.
        configure: adds options of the script's own.

    Returns:
        The options and the rows.
    """
    parser = argparse.ArgumentParser(description=(description or "").splitlines()[0])
    parser.add_argument("--json", type=Path, help="also write the rows there")
    parser.add_argument("--repetitions", type=int, default=repetitions, help="runs of each")
    configure(parser)
    options = parser.parse_args(arguments)
    if options.repetitions < 1:
        parser.error(f"--repetitions is {options.repetitions}, but must be at least 1")
    rows = [job() for job in tqdm(list(jobs(options)), unit="row")]
    print(table(rows))
    if options.json is not None:
        machine = {"python": platform.python_version(), "processor": platform.machine()}
        write_json(options.json, {"machine": machine, "rows": rows})
    return options, rows
