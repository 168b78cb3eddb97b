"""A table or figure of a paper as a study: a grid of cells, a report of them, and claims.

A study declares what is varied (`grid`), what is made of the measured cells (`report`) and which
numbers of the paper they are held against (`claims`). `run_study` runs any of them: it computes
the cells that are missing, writes the numbers, the table and the pictures, and resumes after an
interruption.
"""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar, NamedTuple

import numpy as np
from tqdm import tqdm

from swarm_envs.arguments import Seed
from swarm_envs.errors import check_name
from swarm_envs.files import write_json, write_table
from swarm_envs.state import BoolArray, FloatArray
from swarm_envs.training.provenance import check_same
from swarm_envs.training.reproduce.claims import Claim, Extent

Cell = dict[str, Any]  # The numbers of one cell, ready for JSON
Cells = Mapping[str, Callable[[], Any]]  # What computes each cell, by name


class Report(NamedTuple):
    """What a study found."""

    summary: dict[str, Any]  # The numbers, ready for JSON
    text: str  # What is printed
    table: Sequence[Mapping[str, Any]] = ()
    """Rows of the CSV file; no file is written if there are none."""
    files: Mapping[str, Callable[[Path], object]] = {}
    """What writes each picture or page, by the file's name."""


@dataclass(frozen=True, kw_only=True)
class Study:
    """A numbered table or figure of a paper, or another study."""

    paper: str  # As `swarm-envs reproduce` names it
    name: str  # Such as `figure-3b`, `table-1` or `study-lag`
    shows: str  # What it shows, in a line
    label: str = ""  # As the paper names it; `Fig. 3b` for `figure-3b` if not given.
    missing: str = ""  # Why it cannot be reproduced in simulation; empty if it can
    file: str = ""
    """Name of its files without suffix; `figure_3b` for `figure-3b`, `lag` for `study-lag` if not
    given."""
    takes: tuple[str, ...] | None = None
    """Options that have a meaning for it, besides those of `StudyOptions`; None for all."""
    check: Callable[[Any], object] = lambda options: None
    """Raises ValueError for options that contradict each other."""
    needs_torch: bool = False  # Whether it trains
    grid: Callable[[Any], Cells] | None = None
    """Gives what computes each cell from the options; None for a study of a single cell."""
    settings: Callable[[Any], Mapping[str, Any]] | None = None
    """What all cells share; they are kept with it in a JSON file. None where each keeps itself."""
    cells_file: str = ""
    """That file; `lag_cells.json` for a study with the files `lag` if not given."""
    report: Callable[[Any, Mapping[str, Any]], Report] | None = None
    """Takes the options and the cells; None for what other commands make."""
    claims: Callable[[Any, Extent], Sequence[Claim]] | None = None
    """Holds the numbers of the JSON file against the paper's."""
    numbers: str = ""
    """File with the numbers that claims are made of; the study's JSON file if not given."""
    pictures: tuple[str, ...] = ("*.png",)
    """Pictures that the page of `reproduce all` shows; `*` stands for `file`."""
    note: str = ""  # What a reader of that page must know besides the claims
    full: Mapping[str, Any] = field(default_factory=dict)
    """Options in `reproduce all` that are not the defaults."""
    quick: Mapping[str, Any] = field(default_factory=dict)  # Options in `reproduce all --quick`
    collects: tuple[int, int] | None = None
    """Flights of each team and motion that are collected first, in full and quick."""

    def __post_init__(self) -> None:
        """Refuse a study that is half declared."""
        remade = self.report is not None or self.collects is not None
        if remade == bool(self.missing):
            raise ValueError(f"{self.key}: say how it is reproduced, or why not; not both")
        if self.numbered and remade and self.claims is None:
            raise ValueError(f"{self.key}: say which claims of the paper it is held against")
        kind, _, number = self.name.partition("-")
        usual = {
            "label": f"Fig. {number}",
            "file": number if kind == "study" else f"{kind}_{number}",
        }
        for name, value in usual.items():
            object.__setattr__(self, name, getattr(self, name) or value)
        pictures = tuple(name.replace("*", self.file) for name in self.pictures)
        object.__setattr__(self, "pictures", pictures)

    @property
    def key(self) -> str:
        """Such as `neural-swarm2/table-3`: its folder in `reproduce all`, and how it is named."""
        return f"{self.paper}/{self.name}"

    @property
    def numbered(self) -> bool:
        """Whether the paper numbers it: `reproduce all` remakes those."""
        return not self.name.startswith("study-")


@dataclass(frozen=True, kw_only=True)
class StudyOptions:
    """Options of `swarm-envs reproduce PAPER`; a paper adds its figures and what they take."""

    paper: ClassVar[str]
    """As the command names it."""

    out: Path = Path("reproduce")
    """folder for pictures, numbers, runs and pages; made if missing"""
    json: Path | None = None
    """write the numbers to this file too"""
    seed: Seed = 0
    """the first of the seeds"""

    def __post_init__(self) -> None:
        """Refuse what cannot be done."""
        study = self.chosen
        known = {"figure", "table", "study", "out", "json", "seed", *(study.takes or ())}
        for entry in dataclasses.fields(self) if study.takes is not None else ():
            name = entry.name
            if name in known or getattr(self, name) == entry.default:
                continue
            homes = [s for s in _studies_of(self.paper).values() if name in (s.takes or ())]
            raise ValueError(
                f"--{name.replace('_', '-')} has no meaning for {_flag_of(study)}, but for "
                f"{' or '.join(map(_flag_of, homes))}; leave it out"
            )
        study.check(self)

    @property
    def chosen(self) -> Study:
        """The study that is asked for."""
        studies = _studies_of(self.paper)
        kinds = ("figure", "table", "study")
        asked = [f"{k}-{getattr(self, k)}" for k in kinds if getattr(self, k, None) is not None]
        if len(asked) != 1:
            raise ValueError(f"give one of {', '.join(map(_flag_of, studies.values()))}")
        return studies[check_name("study", asked[0], studies)]


def drawing(paper: str, number: int, shows: str, missing: str) -> Study:
    """A figure of a paper that nothing remakes, and why."""
    return Study(paper=paper, name=f"figure-{number}", shows=shows, missing=missing)


def _studies_of(paper: str) -> dict[str, Study]:
    """What `swarm-envs reproduce PAPER` remakes, by name."""
    from swarm_envs.training.reproduce.papers import load_paper

    return {s.name: s for s in load_paper(paper).STUDIES if s.report is not None}


def _flag_of(study: Study) -> str:
    """How a study is asked for, such as `--figure 5`."""
    return "--" + study.name.replace("-", " ", 1)


def run_study(study: Study, options: Any, progress: bool = True) -> tuple[dict[str, Any], str]:
    """Compute the cells of a study that are not there yet, and write what it found.

    Returns the numbers, ready for JSON, and what to print.

    Raises:
        ValueError: an earlier run in the folder was of other settings, or is damaged.
    """
    assert study.report is not None
    path, settings = options.out / (study.cells_file or f"{study.file}_cells.json"), None
    cells: dict[str, Any] = {}
    if study.grid is not None:
        jobs = study.grid(options)
        settings = None if study.settings is None else study.settings(options)
        cells = run_cells(jobs, path, settings, study.label, progress)
    report = study.report(options, cells)
    written = [options.out / f"{study.file}.json"]
    if report.table:
        written.append(options.out / f"{study.file}.csv")
        write_table(written[-1], report.table)
    for file, write in report.files.items():
        written.append(options.out / file)
        write(written[-1])
    if settings is None or path != written[0]:  # else it holds the cells
        write_json(written[0], report.summary)
    if options.json is not None:
        write_json(options.json, report.summary)
    return report.summary, f"{report.text}\nwrote {', '.join(map(str, written))}"


def run_cells(
    cells: Cells,
    path: Path,
    settings: Mapping[str, Any] | None,
    label: str = "",
    progress: bool = True,
) -> dict[str, Any]:
    """Compute every cell that the file does not hold yet, and write the file after each.

    Returns them in the order asked for. `settings` are what all cells share, ready for JSON; None
    for cells that keep themselves.

    Raises:
        ValueError: the file is damaged, or was made with other settings.
    """
    wanted = json.loads(json.dumps(None if settings is None else dict(settings)))
    found = {} if settings is None else _read_cells(path, wanted)
    done = {name: found[name] for name in cells if name in found}
    with tqdm(total=len(cells), initial=len(done), desc=label, disable=not progress) as bar:
        for name, compute in cells.items():
            if name in done:
                continue
            bar.set_postfix_str(name)
            done[name] = compute()
            if settings is not None:
                # As the file gives it back, so that a resumed study says the same to the letter.
                found[name] = done[name] = json.loads(json.dumps(done[name], allow_nan=False))
                write_json(path, {"settings": wanted, "cells": found})
            bar.update()
    return {name: done[name] for name in cells}


def _read_cells(path: Path, wanted: Mapping[str, Any]) -> dict[str, Cell]:
    if not path.is_file():
        return {}
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        made, cells = dict(content["settings"]), dict(content["cells"])
    except (ValueError, KeyError, TypeError) as error:
        raise ValueError(f"{str(path)!r} is damaged ({error}); delete it") from error
    check_same(path, made, wanted)
    return cells


def error_cell(worst_m: FloatArray, crashed: BoolArray) -> Cell:
    """The cell of flights by their worst height errors (E,), m, and which of them crashed (E,)."""
    return {"worst_cm": np.round(100.0 * worst_m, 4).tolist(), "crashed": int(crashed.sum())}
