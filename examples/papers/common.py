"""Shared parts of the scripts of all papers: command line, JSON and CSV files, and tables."""

from __future__ import annotations

import csv
import functools
import json
import math
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import is_dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
import tyro

from swarm_envs.errors import check_integer, check_name

Array = npt.NDArray[np.float64]

LEAST = dict.fromkeys(("seeds", "episodes", "flights", "trials", "runs", "steps", "budget"), 1)
LEAST |= {"seed": 0, "drones": 2}
"""Least values of numbers, by the option that every command calls them."""


def run_command(
    paper: str,
    commands: Mapping[str, Callable[..., None]],
    description: str | None,
    arguments: Sequence[str] | None,
) -> None:
    """Read a command line, `python -m examples.papers.PAPER COMMAND ...`, and run its command.

    Raises:
        SystemExit: with status 2, after one line that says what cannot be done.
    """
    program = f"python -m examples.papers.{paper}"
    try:
        tyro.extras.subcommand_cli_from_dict(
            {name: checked(command) for name, command in commands.items()},
            prog=program,
            description=description,
            args=arguments,
            config=(tyro.conf.OmitArgPrefixes,),
        )
    except (ImportError, OSError, ValueError) as error:
        print(f"{program}: error: {' '.join(str(error).splitlines())}", file=sys.stderr)
        sys.exit(2)


def checked(command: Callable[..., None]) -> Callable[..., None]:
    """Return a command that refuses what it cannot write or count before it begins its work."""

    @functools.wraps(command)
    def run(*options: Any, **given: Any) -> None:
        named = dict(given)
        for each in (*options, *given.values()):
            named |= vars(each) if is_dataclass(each) else {}
        check_options(named)
        command(*options, **given)

    return run


def check_options(given: Mapping[str, Any]) -> None:
    """Refuse counts, seeds, engines and folders that no command takes.

    Raises:
        ValueError: naming the option, its value and the rule.
    """
    for name, least in LEAST.items():
        if name in given:
            check_integer(f"--{name}", given[name], least)
    if "engine" in given:
        check_name("--engine", given["engine"], ("batch", "bullet"))
    out = given["out"]
    if any(path.exists() and not path.is_dir() for path in (out, *out.parents)):
        raise ValueError(f"--out is {str(out)!r}, but that is or lies in a file; name a folder")


def write_json(path: Path, content: object) -> None:
    """Write JSON; the folder is made if missing. Raises ValueError for NaN and infinity."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(content, indent=1, allow_nan=False) + "\n", encoding="utf-8")


def write_csv(path: Path, rows: Sequence[Mapping[str, Any]]) -> None:
    """Write rows as CSV; the keys of the first row are the columns."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)


class Row(NamedTuple):
    """A number beside the paper's."""

    quantity: str  # what is measured, with its unit
    paper: str  # the paper's value or statement, "-" if it has none
    result: float  # our value; NaN if there is none
    accepted: tuple[float, float] | None = None
    """Least and largest result that agrees with the paper; None if there is nothing to compare."""
    reason: str = ""  # why the result is outside, if that is known
    explains: tuple[float, float] = (-math.inf, math.inf)  # results that the reason explains
    spread: tuple[float, float] | None = None  # range over which the result scatters
    spread_is: str = ""  # such as "quartiles" or "least and largest"
    given: bool = False  # the result follows from what was put in: it could not differ

    @property
    def difference(self) -> str:
        """The verdict: the result agrees with the paper, or differs; NaN never agrees."""
        if self.given:
            return "put in"
        if self.accepted is None:
            return "nothing to compare"
        if self.accepted[0] <= self.result <= self.accepted[1]:
            return "agrees"
        known = self.reason and self.explains[0] <= self.result <= self.explains[1]
        return f"differs: {self.reason}" if known else "differs, unexplained"

    def as_json(self) -> dict[str, Any]:
        """Return what `comparison` prints, ready for JSON; NaN becomes None."""
        result = self.result if math.isfinite(self.result) else None
        kept = {key: getattr(self, key) for key in ("quantity", "paper", "spread", "difference")}
        return kept | {"result": result}


def within(value: float, share: float) -> tuple[float, float]:
    """Return the range of numbers within a share of a value: `within(10, 0.2)` is (8, 12)."""
    return value - share * abs(value), value + share * abs(value)


def format_number(value: float) -> str:
    """Format a number with three significant digits, integers exactly: `0.123`, `12.3`, `12416`."""
    if not math.isfinite(value):
        return "none"
    if value == int(value):
        return str(int(value))
    return f"{value:.0f}" if abs(value) >= 1000 else f"{value:.3g}"


def write_compared(path: Path, numbers: Mapping[str, Any], rows: Sequence[Row]) -> None:
    """Write numbers and their comparison with the paper's as JSON, and print the comparison."""
    write_json(path, {**numbers, "comparison": [row.as_json() for row in rows]})
    print(comparison(rows))


def comparison(rows: Iterable[Row]) -> str:
    """Return a Markdown table of numbers beside the paper's."""
    lines = []
    for row in rows:
        result = format_number(row.result)
        if row.spread is not None:
            least, most = (format_number(end) for end in row.spread)
            result += f" ({least} to {most}, {row.spread_is})"
        lines.append(row._asdict() | {"result": result, "difference": row.difference})
    return markdown(lines, ("quantity", "paper", "result", "difference"))


def markdown(rows: Iterable[Mapping[str, Any]], columns: Sequence[str]) -> str:
    """Return some columns of rows as a Markdown table; numbers have two decimals."""
    cells = [columns, *([_cell(row[name]) for name in columns] for row in rows)]
    head, *lines = [f"| {' | '.join(line)} |" for line in cells]
    return "\n".join([head, "|---" * len(columns) + "|", *lines])


def _cell(value: Any) -> str:
    if value is None:
        return "-"
    return f"{value:.2f}" if isinstance(value, float) else str(value)
