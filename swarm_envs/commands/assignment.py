"""`swarm-envs assignment`: the assignments of a course, and a folder to begin one in."""

from __future__ import annotations

import json
import shutil
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import tyro

from swarm_envs import assignments
from swarm_envs.assignments import ASSIGNMENTS
from swarm_envs.commands.checks import Misuse
from swarm_envs.errors import unknown_name


@dataclass(frozen=True, kw_only=True)
class AssignmentOptions:
    """List the assignments of the course, or begin one in a new folder.

    The command `start` writes the instructions of the assignment, starter code that runs, its
    tests, and a notebook.
    """

    command: Annotated[Literal["list", "start"], tyro.conf.Positional]
    """`list` prints the assignments; `start` writes the files of one."""
    name: Annotated[str | None, tyro.conf.Positional] = None
    """The name of the assignment to start."""
    out: Annotated[Path | None, tyro.conf.Positional] = None
    """The new folder. If None, it has the assignment's name."""


def run_assignment(options: AssignmentOptions) -> None:
    """Print the assignments, or write the files of one."""
    if options.command == "list":
        if options.name is not None:
            raise Misuse(f"`list` takes no name, but got {options.name!r}; leave it out")
        width = max(map(len, ASSIGNMENTS))
        for name, assignment in ASSIGNMENTS.items():
            print(f"{name.ljust(width)}  {assignment.summary}\n{' ' * width}  {assignment.rubric}")
        return
    if options.name is None:
        raise Misuse(f"`start` needs the name of an assignment: {', '.join(ASSIGNMENTS)}")
    if (name := options.name) not in ASSIGNMENTS:
        raise Misuse(unknown_name("assignment", name, ASSIGNMENTS))
    folder = options.out or Path(name)
    if folder.exists():
        raise Misuse(f"{str(folder)!r} exists; name a new folder, so that nothing is overwritten")
    source, work = Path(assignments.__file__).parent / name, ASSIGNMENTS[name].work
    partial = folder.with_name(f".{folder.name}.partial")  # a killed command may have left one
    shutil.rmtree(partial, ignore_errors=True)
    try:
        shutil.copytree(source, partial, ignore=shutil.ignore_patterns("__pycache__"))
        _write_notebook(partial, name, work)
        partial.rename(folder)
    finally:
        shutil.rmtree(partial, ignore_errors=True)
    print(f"wrote {folder}; read {folder / 'README.md'} and edit {folder / work.split(':')[0]}")


def _write_notebook(folder: Path, name: str, work: str) -> None:
    """Write a notebook with the instructions and the starter code, which writes the submission."""
    file = work.split(":")[0]
    page = (folder / "README.md").read_text(encoding="utf-8")
    starter = (folder / file).read_text(encoding="utf-8")
    cells = [
        _cell("markdown", page),
        _cell("code", f"%%writefile {file}\n{starter}"),
        _cell("code", f"!python -m pytest -q test_{file}"),
        _cell("code", f"!swarm-envs grade --assignment {name} --agent {work} --episodes 32"),
    ]
    numbered = [{**cell, "id": f"cell-{number}"} for number, cell in enumerate(cells)]
    about = {"kernelspec": {"display_name": "Python 3", "language": "python", "name": "python3"}}
    content = {"cells": numbered, "metadata": about, "nbformat": 4, "nbformat_minor": 5}
    path = folder / Path(file).with_suffix(".ipynb")
    path.write_text(json.dumps(content, indent=1), encoding="utf-8")


def _cell(kind: str, text: str) -> dict[str, Any]:
    cell: dict[str, Any] = {"cell_type": kind, "metadata": {}}
    run: dict[str, Any] = {"execution_count": None, "outputs": []} if kind == "code" else {}
    return {**cell, "source": text, **run}
