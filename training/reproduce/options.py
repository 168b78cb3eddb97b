"""Options of `swarm-envs reproduce`, and what it does with them."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import tyro

from swarm_envs.errors import check_name
from swarm_envs.files import write_json
from swarm_envs.training.reproduce.cells import CELLS
from swarm_envs.training.reproduce.figure import format_summary, reproduce_figure

CELL_NAMES = tuple(cell.name for cell in CELLS)


@dataclass(frozen=True, kw_only=True)
class ReproduceOptions:
    """Remake a figure or a table of a paper, with the paper's values beside ours.

    `--figure 5` draws the heat maps, the superposition gaps and larger swarms of any force model,
    with `--bins` its calibration too. `--table 3` fits the ablations, which takes a while; killed
    and called again, it goes on where it was.
    """

    paper: Annotated[Literal["neural-swarm2"], tyro.conf.Positional]
    """whose figure or table"""
    figure: Literal[5] | None = None
    """number of the figure"""
    table: Literal[3] | None = None
    """number of the table"""
    out: Path = Path("reproduce")
    """folder for pictures, numbers and runs; made if missing"""
    model: str = "learned"
    """figure: `learned`, `wake`, or the path of a weights file"""
    bins: Path | None = None
    """figure: CSV of measured force bins to hold the model against"""
    truth: str | None = None
    """figure: the force that blew where the model was learned, such as `learned` for one of
    `swarm-envs curriculum`: how much of it is explained for 2 to 16 drones"""
    data: Path | None = None
    """table: rows of measured force, a file or a folder, as `swarm-envs fit` reads them"""
    seed: int = 0
    """table: seed of the first run of each cell; figure: of the swarms that `--truth` asks about"""
    seeds: int = 3
    """table: runs of each cell"""
    cells: tuple[str, ...] = CELL_NAMES
    """table: which cells to fit"""
    steps: int | None = None
    """table: optimiser steps of each fit; the trainer's default if not given"""
    json: Path | None = None
    """write the numbers to this file too"""

    def __post_init__(self) -> None:
        """Refuse what cannot be done.

        Raises:
            ValueError: neither or both of figure and table, a table without data, or a number out
                of range.
        """
        if (self.figure is None) == (self.table is None):
            raise ValueError("give either --figure 5 or --table 3")
        if self.table is not None and self.data is None:
            raise ValueError("--table 3 fits models: give the rows to fit by --data PATH")
        if self.seed < 0:
            raise ValueError(f"--seed is {self.seed}, but must be 0 or more")
        for name in ("seeds", "steps"):
            if getattr(self, name) is not None and getattr(self, name) < 1:
                raise ValueError(f"--{name} is {getattr(self, name)}, but must be 1 or more")
        for cell in self.cells:
            check_name("cell", cell, CELL_NAMES)


def run(options: ReproduceOptions) -> str:
    """Do what the options say, and return what to print."""
    content, text = _figure(options) if options.table is None else _table(options)
    if options.json is not None:
        write_json(options.json, content)
    return text


def _figure(options: ReproduceOptions) -> tuple[dict[str, Any], str]:
    summary = reproduce_figure(
        options.out, options.model, options.bins, options.truth, options.seed
    )
    files = [options.out / name for name in ("figure_5.json", *summary["files"].values())]
    return summary, f"{format_summary(summary)}\nwrote {', '.join(map(str, files))}"


def _table(options: ReproduceOptions) -> tuple[dict[str, Any], str]:
    from swarm_envs.training.reproduce.ablation import Budget, format_table, run_ablation

    assert options.data is not None
    seeds = range(options.seed, options.seed + options.seeds)
    cells = [cell for cell in CELLS if cell.name in options.cells]
    table = run_ablation(options.out, Budget(options.data, options.steps), seeds, cells)
    files = ", ".join(str(options.out / f"table_3.{kind}") for kind in ("json", "csv", "png"))
    return table, f"{format_table(table)}\nwrote {files}"
