"""Shared parts of the papers' scripts: command line, JSON and CSV files, and tables."""

from __future__ import annotations

import csv
import json
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import tyro


def run_command(
    paper: str,
    commands: Mapping[str, Callable[..., None]],
    description: str | None,
    arguments: Sequence[str] | None,
) -> None:
    """Read a command line, `python -m examples.papers.PAPER COMMAND ...`, and run its command."""
    tyro.extras.subcommand_cli_from_dict(
        dict(commands),
        prog=f"python -m examples.papers.{paper}",
        description=description,
        args=arguments,
        config=(tyro.conf.OmitArgPrefixes,),
    )


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

    @property
    def difference(self) -> str:
        """The verdict: the result agrees with the paper, or differs; NaN never agrees."""
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


def comparison(rows: Iterable[Row]) -> str:
    """Return a Markdown table of numbers beside the paper's."""
    lines = ["| quantity | paper | result | difference |", "|---|---|---|---|"]
    for row in rows:
        result = format_number(row.result)
        if row.spread is not None:
            least, most = (format_number(end) for end in row.spread)
            result += f" ({least} to {most}, {row.spread_is})"
        lines.append(f"| {row.quantity} | {row.paper} | {result} | {row.difference} |")
    return "\n".join(lines)
