"""Tables of RTH3D's figures: `<!-- figure table: 5 -->` becomes the rows of that figure's CSV."""

from __future__ import annotations

import csv
from collections.abc import Mapping
from pathlib import Path

FOLDER = Path(__file__).parents[1] / "rth3d"
METHODS = ("rth3d", "rth3d-lba-paper", "rth3d-lba", "auto")
_HEAD = f"| instance | grid | robots | runs | {' | '.join(f'`{m}`' for m in METHODS)} | CPU, s |"
Runs = Mapping[str, str]


def figure_table(figure: str) -> str:
    """One row for each instance and grid: mean ratios and CPU times of the methods.

    Raises:
        FileNotFoundError: the figure has no CSV.
    """
    cells: dict[tuple[str, str, str], dict[str, Runs]] = {}
    with (FOLDER / f"figure_{figure}.csv").open(encoding="utf-8") as file:
        for row in csv.DictReader(file):
            key = (row["series"], row["grid"], row["robots"])
            cells.setdefault(key, {})[row["method"]] = row
    rows = [_row(*key, by) for key, by in cells.items()]
    return "\n".join([_HEAD, "|---" * 9 + "|", *rows])


def _row(series: str, grid: str, robots: str, by: Mapping[str, Runs]) -> str:
    runs = next(iter(by.values()))["runs"]
    ratios = [
        f"{float(by[m]['ratio_before_compaction']):.2f}, {float(by[m]['ratio']):.3f}"
        if m in by
        else "-"
        for m in METHODS[:-1]
    ]
    auto = f"{float(by['auto']['ratio']):.3f}" if "auto" in by else "-"
    spent = " / ".join(f"{float(by[m]['cpu_s']):.2g}" if m in by else "-" for m in METHODS)
    cells = [series, grid.replace("x", " x "), f"{int(robots):,}", runs, *ratios, auto, spent]
    return f"| {' | '.join(cells)} |"
