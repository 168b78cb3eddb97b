"""`swarm-envs grade`: the files of a whole course, each in a process of its own, and its points.

What a file is worth is one number that `swarm-envs evaluate` reports, or the error of its force
model; points rise linearly from one value of it to another. See `docs/assignments/`.
"""

from __future__ import annotations

import csv
import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import Any, Literal, get_args

from swarm_envs.commands.checks import Misuse, check_file

Name = Literal["controller", "force-model", "swap"]
"""Assignments by name."""


@dataclass(frozen=True)
class Assignment:
    """What is asked for, and what it is worth."""

    metric: str
    """The number that counts, as reports name it."""
    zero: float
    """Its value that is worth nothing."""
    full: float
    """Its value, or better, that is worth 100 points."""
    flown: tuple[str, ...] = ()
    """What `swarm-envs evaluate` is told; empty where nothing is flown."""

    def points(self, report: Mapping[str, Any]) -> float:
        """Points from 0 to 100; in flights, times the share of episodes without a crash."""
        value = report.get(self.metric)
        if value is None:
            return 0.0
        share = (float(value) - self.zero) / (self.full - self.zero)
        safe = 1.0 - float(report.get("collision_rate", 0.0))
        return round(100.0 * min(max(share, 0.0), 1.0) * safe, 1)


ASSIGNMENTS: Mapping[str, Assignment] = MappingProxyType(
    {
        "controller": Assignment(
            metric="worst_height_error_m",
            zero=0.08,
            full=0.01,
            flown=("--task", "swap", "--layout", "stacked", "--drones", "3"),
        ),
        "force-model": Assignment(metric="explained", zero=0.3, full=0.9),
        "swap": Assignment(
            metric="success_rate",
            zero=0.50,
            full=0.95,
            flown=("--task", "swap", "--layout", "random", "--drones", "4"),
        ),
    }
)
"""The assignments of `docs/assignments/` by their names."""


@dataclass(frozen=True, kw_only=True)
class GradeOptions:
    """Grade what students handed in: one line of a table for each, whatever happens to it.

    A file that cannot be imported, raises, returns what is no action or takes too long is named
    with its error and gets no points; the others go on.
    """

    assignment: Name
    """which one: `controller`, `force-model` or `swap`"""
    work: list[str] = field(default_factory=list)
    """what was handed in: path/to/file.py:Class each; also folders of trained policies"""
    out: Path | None = None
    """write the table to this file, .csv"""
    episodes: int = 64
    """episodes that each flies"""
    seed: int = 0
    """the episodes are drawn from it: the same for all; grade on one that nobody has seen"""
    data: Path | None = None
    """for `force-model`: the rows.npz of a `swarm-envs collect`, whose validation rows grade"""
    limit_s: float = 600.0
    """time that each may take, s"""

    def __post_init__(self) -> None:
        """Refuse what cannot be graded."""
        if not self.work:
            raise ValueError("--work is empty; name one file.py:Class or more")
        if self.episodes < 1 or self.seed < 0:
            raise ValueError(
                f"--episodes is {self.episodes} and --seed {self.seed}, but must be 1 and 0 or more"
            )
        if not self.limit_s > 0.0:
            raise ValueError(f"--limit-s is {self.limit_s}, but must be positive")
        if (self.assignment == "force-model") != (self.data is not None):
            raise ValueError("--data is for --assignment force-model, which needs it")


assert set(get_args(Name)) == set(ASSIGNMENTS)


def run(options: GradeOptions) -> int:
    """Grade, print and write; return how many failed.

    Raises:
        Misuse: there is no data, or the table cannot be written; nothing was graded.
    """
    from tqdm import tqdm

    if options.out is not None:
        check_file("--out", options.out, (".csv",))
    if options.data is not None and not options.data.is_file():
        raise Misuse(f"--data is {str(options.data)!r}, but there is no such file")
    assignment = ASSIGNMENTS[options.assignment]
    grades = []
    for work in tqdm(options.work, desc="grading", unit="file"):
        report = _report(work, options, assignment)
        points = 0.0 if "error" in report else assignment.points(report)
        grades.append((work, points, report.get(assignment.metric), report.get("error", "")))
    print(_table(assignment, grades))
    if options.out is not None:
        _write(options.out, assignment, grades)
        print(f"wrote {options.out}")
    return sum(bool(error) for *_, error in grades)


_Grade = tuple[str, float, float | None, str]


def _report(work: str, options: GradeOptions, assignment: Assignment) -> dict[str, Any]:
    """What a process of its own says of a student's work; or, under `error`, why it has not."""
    with tempfile.TemporaryDirectory(prefix="swarm-envs-grade-") as folder:
        out = Path(folder) / "report.json"
        command = [sys.executable, "-m", *_arguments(work, options, assignment, out)]
        try:
            done = subprocess.run(
                command,
                env={**os.environ, "TQDM_DISABLE": "1"},  # its last line shall say what went wrong
                capture_output=True,
                text=True,
                errors="replace",
                timeout=options.limit_s,
                stdin=subprocess.DEVNULL,
            )
        except subprocess.TimeoutExpired:
            return {"error": f"took longer than {options.limit_s:g} s"}
        if not out.is_file():
            last = (done.stderr.strip() or "no message").splitlines()[-1]
            return {"error": f"ended with exit code {done.returncode}: {last}"}
        report: dict[str, Any] = json.loads(out.read_text(encoding="utf-8"))
    agent = report.get("agents", [{}])[0]
    return {**report, **agent}


def _arguments(
    work: str, options: GradeOptions, assignment: Assignment, out: Path
) -> tuple[str, ...]:
    """What Python runs as a module, and its arguments."""
    if not assignment.flown:
        module = "swarm_envs.commands.grade_force"
        return (module, work, str(options.data), str(out))
    count = ("--episodes", str(options.episodes), "--seed", str(options.seed))
    flown = (*assignment.flown, *count, "--agent", work, "--json", str(out))
    return ("swarm_envs", "evaluate", *flown)


def _table(assignment: Assignment, grades: list[_Grade]) -> str:
    width = max(len("work"), *(len(work) for work, *_ in grades))
    lines = [f"{'work'.ljust(width)}  points  {assignment.metric}"]
    for work, points, value, error in grades:
        said = f"FAILED: {error}" if error else ("-" if value is None else f"{value:.4g}")
        lines.append(f"{work.ljust(width)}  {points:6.1f}  {said}")
    return "\n" + "\n".join(lines)


def _write(path: Path, assignment: Assignment, grades: list[_Grade]) -> None:
    from swarm_envs.files import written_whole

    with written_whole(path) as whole, whole.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(["work", "points", assignment.metric, "error"])
        writer.writerows(grades)
