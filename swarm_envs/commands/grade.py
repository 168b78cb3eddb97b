"""`swarm-envs grade`: the files of a whole course, each in a process of its own, and its points.

What a file is worth is one number that `swarm-envs evaluate` reports, or the error of its force
model; points rise linearly from one value of it to another. See `docs/assignments/`.
"""

from __future__ import annotations

import csv
import glob
import json
import os
import signal
import subprocess
import sys
import tempfile
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import Annotated, Any, Literal, NamedTuple, get_args

from swarm_envs.arguments import POSITIVE_S, Count, Seed
from swarm_envs.commands.checks import Misuse, check_file, command_options

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
    """Arguments of `swarm-envs evaluate`; empty where nothing is flown."""

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


@command_options
@dataclass(frozen=True, kw_only=True)
class GradeOptions:
    """Grade what students handed in: one line of a table for each, whatever happens to it.

    A file that cannot be imported, raises, returns what is no action or takes too long is named
    with its error and gets no points; the others go on.
    """

    assignment: Name
    """which one: `controller`, `force-model` or `swap`"""
    work: list[str] = field(default_factory=list)
    """what was handed in: path/to/file.py:Class each, or a pattern such as 'class/*/swap.py:Class';
    also folders of trained policies"""
    out: Path | None = None
    """write the table to this file, .csv, after each work"""
    episodes: Count = 64
    """episodes that each flies"""
    seed: Seed = 0
    """the episodes are drawn from it: the same for all; grade on one that nobody has seen"""
    data: Path | None = None
    """for `force-model`: the rows.npz of a `swarm-envs collect`, whose validation rows grade"""
    limit_s: Annotated[float, POSITIVE_S] = 600.0
    """time that each may take, s"""

    def __post_init__(self) -> None:
        """Refuse what cannot be graded."""
        if not self.work:
            raise ValueError("--work is empty; name one file.py:Class or more")
        if (self.assignment == "force-model") != (self.data is not None):
            raise ValueError("--data is for --assignment force-model, which needs it")


assert set(get_args(Name)) == set(ASSIGNMENTS)


def run_grade(options: GradeOptions) -> int:
    """Grade, print and write; return how many failed.

    Raises:
        Misuse: there is no such work or data, or the table cannot be written; nothing was graded.
        KeyboardInterrupt: with what was graded until then; the table has it.
    """
    from tqdm import tqdm

    if options.out is not None:
        check_file("--out", options.out, (".csv",))
    if options.data is not None:
        _check_rows(options.data)
    assignment, works = ASSIGNMENTS[options.assignment], _expanded(options.work)
    grades: list[_Grade] = []
    try:
        for work in tqdm(works, desc="grading", unit="file"):
            grades.append(_grade(work, options, assignment))
            if options.out is not None:
                _write(options.out, assignment, grades)
    except KeyboardInterrupt:
        print(_table(assignment, grades))
        raise KeyboardInterrupt(f"interrupted: {len(grades)} of {len(works)} are graded") from None
    print(_table(assignment, grades))
    if options.out is not None:
        print(f"wrote {options.out}")
    return sum(bool(grade.error) for grade in grades)


class _Grade(NamedTuple):
    work: str
    points: float
    value: float | None
    error: str
    privileged: bool


def _grade(work: str, options: GradeOptions, assignment: Assignment) -> _Grade:
    report = _report(work, options, assignment)
    error, value = report.get("error", ""), report.get(assignment.metric)
    points = 0.0 if error else assignment.points(report)
    return _Grade(work, points, value, error, bool(report.get("privileged", False)))


def _expanded(works: list[str]) -> list[str]:
    """Works by name; shells leave a pattern alone that a class follows."""
    found = []
    for work in works:
        path, colon, name = work.rpartition(":") if ".py:" in work else (work, "", "")
        files = sorted(glob.glob(path)) if glob.has_magic(path) else [path]  # noqa: PTH207
        if not files:
            raise Misuse(f"--work is {work!r}, but no file's name matches that pattern")
        found += [f"{file}{colon}{name}" for file in files]
    return found


def _check_rows(path: Path) -> None:
    """A teacher's mistake is nobody's failure."""
    from swarm_envs.training.interaction_rows import read_rows

    if path.is_dir():
        raise Misuse(f"--data is the folder {str(path)!r}; name its table, {path / 'rows.npz'}")
    if not path.is_file():
        raise Misuse(f"--data is {str(path)!r}, but there is no such file")
    try:
        rows = read_rows(path)
    except (ValueError, OSError) as error:
        raise Misuse(f"--data is {str(path)!r}: {error}") from error
    held = int(rows.validation.sum())
    if not 0 < held < len(rows):
        raise Misuse(
            f"--data is {str(path)!r}, where {held} of {len(rows)} rows are for validation; "
            "some must be, and others not"
        )


def _report(work: str, options: GradeOptions, assignment: Assignment) -> dict[str, Any]:
    """What a process of its own says of a student's work; or, under `error`, why it has not."""
    with tempfile.TemporaryDirectory(prefix="swarm-envs-grade-") as folder:
        out = Path(folder) / "report.json"
        command = [sys.executable, "-m", *_arguments(work, options, assignment, out)]
        try:
            code, said = _ended(command, options.limit_s)
        except subprocess.TimeoutExpired:
            return {"error": f"took longer than {options.limit_s:g} s"}
        if not out.is_file():
            last = (said.strip() or "no message").splitlines()[-1]
            return {"error": f"ended with exit code {code}: {last}"}
        report: dict[str, Any] = json.loads(out.read_text(encoding="utf-8"))
    agent = report.get("agents", [{}])[0]
    return {**report, **agent}


def _ended(command: list[str], limit_s: float) -> tuple[int, str]:
    """Run a command; its exit code and what it said. What it has begun ends with it."""
    with subprocess.Popen(
        command,
        env={**os.environ, "TQDM_DISABLE": "1"},  # its last line shall say what went wrong
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        errors="replace",
        start_new_session=True,
    ) as process:
        try:
            said = process.communicate(timeout=limit_s)[1]
        finally:
            _kill_group(process)
            process.wait()
    return process.returncode, said


def _kill_group(process: subprocess.Popen[str]) -> None:
    if not hasattr(os, "killpg"):  # Windows: the process alone
        process.kill()
        return
    with suppress(ProcessLookupError):
        os.killpg(process.pid, signal.SIGKILL)


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
    width = max(map(len, ["work", *(grade.work for grade in grades)]))
    lines = [f"{'work'.ljust(width)}  points  {assignment.metric}"]
    for work, points, value, error, privileged in grades:
        said = f"FAILED: {error}" if error else ("-" if value is None else f"{value:.4g}")
        lines.append(f"{work.ljust(width)}  {points:6.1f}  {said}{' *' if privileged else ''}")
    if any(grade.privileged for grade in grades):
        lines.append("* sees the true state")
    return "\n" + "\n".join(lines)


def _write(path: Path, assignment: Assignment, grades: list[_Grade]) -> None:
    from swarm_envs.files import written_whole

    with written_whole(path) as whole, whole.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(["work", "points", assignment.metric, "error", "privileged"])
        writer.writerows(grades)
