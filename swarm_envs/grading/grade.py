"""Grading of a class: the loop over submissions, the table, and its files."""

from __future__ import annotations

import hashlib
import inspect
import json
import math
import re
import tempfile
import traceback
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from swarm_envs.files import write_json, write_table
from swarm_envs.grading.assignment import Assignment
from swarm_envs.grading.sandbox import Sandbox
from swarm_envs.grading.submission import (
    MOST_FOLDER,
    WORK_S,
    Clock,
    Entry,
    WorkFailed,
    entered,
    path_of,
    printable,
)

if TYPE_CHECKING:
    from swarm_envs.viewing import Recording

_FORMULAS = ("=", "+", "-", "@", "\t", "\r")


class Grade(NamedTuple):
    """The grade of a submission."""

    work: str  # Its printable name
    points: float  # From 0 to 100
    value: float | None = None  # The assignment's metric; None if the submission failed
    crashes: float | None = None  # Share of episodes with a crash; None for no episodes
    error: str = ""  # The reason of a failure; empty for none
    copied: str = ""  # The name of the copied agent; empty for none

    @property
    def verdict(self) -> str:
        """The metric as text, with a star for a copy, or the reason of the failure."""
        number = "-" if self.value is None else f"{self.value:.4g}"
        star = f" * as {self.copied}" if self.copied else ""
        return f"FAILED: {self.error}" if self.error else number + star


class Course(NamedTuple):
    """The grading of a class: submissions and common settings."""

    assignment: Assignment
    works: list[str]  # The submissions' names for `swarm_envs.agents.load`
    seed: int  # Seed of the episodes; secret if it has 128 random bits
    episodes: int  # Number of episodes of each submission
    sandbox: Sandbox = Sandbox()
    limit_s: float = WORK_S  # Time limit of each submission; see `Clock`
    allow_copies: bool = False  # True to give points to copies
    out: Path | None = None  # Table to write after each submission, .csv or nbgrader's .json
    feedback: Path | None = None  # Folder for the feedback of each student

    def check(self) -> None:
        """Raise an exception if every submission would fail.

        Raises:
            ValueError: the assignment is invalid; see `Assignment.check`.
            TypeError: it has an option that does not exist.
            WorkFailed: an empty submission does not start in the sandbox.
        """
        self.assignment.check()
        with tempfile.TemporaryDirectory() as home:
            Path(home).chmod(0o755)
            Path(home, "work.py").write_text("class Work: pass\n", encoding="utf-8")
            entry = Entry("work.py:Work", Path(home), self.sandbox, Clock())
            try:
                with entry.opened():
                    pass
            except (WorkFailed, OSError) as error:
                raise WorkFailed(f"the sandbox starts no submission: {error}") from None

    def grade(self) -> Iterator[Grade]:
        """Grade the submissions one after another; reuse the grades of an interrupted run."""
        done, grades = self._resumed(), list[Grade]()
        for work in self.works:
            key = f"{printable(work)} {digest(work)}"
            kept = done.get(key)
            grade, failure = (Grade(**kept), None) if kept else self._grade_one(work)
            grades.append(grade)
            done[key] = grade._asdict()
            if self.out is not None:
                write_json(progress_file(self.out), {**self._setting(), "done": done})
                self._write(grades)
            if self.feedback is not None:
                folder = self.feedback / f"{len(grades) - 1:03d}-{_folder_name(grade.work)}"
                folder.mkdir(parents=True, exist_ok=True)
                if not kept:
                    write_failure(folder, failure)
                write_results(folder, self.assignment, grade)
            yield grade
        if self.out is not None:
            progress_file(self.out).unlink(missing_ok=True)

    def _grade_one(self, work: str) -> tuple[Grade, Recording | None]:
        """Grade a submission; any exception is a failure of this submission only."""
        shown = None if self.feedback is None else printable(Path(work).name)
        seeds = episode_seeds(self.seed, self.episodes)
        how: dict[str, Any] = {"seeds": seeds, "shown": shown}
        place = self.sandbox, Clock(self.limit_s)
        try:
            with entered(work, self.assignment.work, *place, **how) as entry:
                found = self.assignment.grade(entry)
            value, crashes = found.get(self.assignment.metric), found.get("collision_rate")
            if value is not None and not math.isfinite(value):
                raise WorkFailed(f"{self.assignment.metric} is {value}")
        except Exception as error:  # a submission may fail in any way; the next one is still graded
            kind = "" if isinstance(error, RuntimeError) else f"{type(error).__name__}: "
            text = printable(f"{self._blame(error)}{kind}{error}")
            return Grade(printable(work), 0.0, error=text), None
        copied = str(found.get("copied", ""))
        points = 0.0 if copied and not self.allow_copies else self.assignment.points(found)
        return Grade(printable(work), points, value, crashes, "", copied), found.get("failure")

    def _blame(self, error: Exception) -> str:
        """Return a prefix of the message of an error in the assignment's own file."""
        last = traceback.extract_tb(error.__traceback__)[-1]
        own = inspect.getfile(type(self.assignment))
        if last.filename != own or isinstance(error, WorkFailed):
            return ""
        return f"error of the assignment, not of the submission (line {last.lineno} of {own}): "

    def _setting(self) -> dict[str, Any]:
        """Return the settings on which grades depend besides the submission."""
        setting = {"assignment": self.assignment.name, "episodes": self.episodes}
        return {**setting, "seed": self.seed, "copies": self.allow_copies}

    def _resumed(self) -> dict[str, dict[str, Any]]:
        if self.out is None or not progress_file(self.out).is_file():
            return {}
        kept = json.loads(progress_file(self.out).read_text(encoding="utf-8"))
        done: dict[str, dict[str, Any]] = kept.pop("done")
        return done if kept == self._setting() else {}

    def _write(self, grades: Sequence[Grade]) -> None:
        assert self.out is not None
        if self.out.suffix == ".json":
            rows = zip(student_ids(self.works), grades, strict=False)
            write_json(self.out, [_nbgrader_row(self.assignment.name, *row) for row in rows])
        else:
            write_table(self.out, [_table_row(self.assignment, grade) for grade in grades])


def progress_file(out: Path) -> Path:
    """Return the file that stores grades and their secret seed until grading is complete."""
    return out.with_name(f".{out.name}.progress.json")


def seed_of(out: Path | None) -> int | None:
    """Return the seed of an interrupted grading; None if there is none."""
    if out is None or not progress_file(out).is_file():
        return None
    return int(json.loads(progress_file(out).read_text(encoding="utf-8"))["seed"])


def episode_seeds(seed: int, count: int) -> list[int]:
    """Return the seeds of episodes, 128 bits each; a smaller count gives the first of these."""
    words = np.random.SeedSequence(seed).generate_state(4 * count, np.uint32)
    return [int.from_bytes(four.tobytes(), "little") for four in words.reshape(count, 4)]


def digest(work: str) -> str:
    """Return a digest of the files of a submission."""
    path, found = path_of(work), hashlib.sha256()
    files = [path] if path.is_file() else sorted(path.rglob("*"))
    for file in filter(Path.is_file, files):
        state = file.stat()
        if state.st_size <= MOST_FOLDER:  # larger files are refused later
            found.update(file.read_bytes())
        found.update(f"{file.name} {state.st_size} {state.st_mtime_ns}".encode())
    return found.hexdigest()


def student_ids(works: Sequence[str]) -> list[str]:
    """Return the student of each submission: the first part of its path that differs.

    With one file per student this is its name, with one folder per student the folder's.
    """
    paths = [path_of(work).absolute() for work in works]
    if len(set(paths)) < 2:
        return [path.parent.name if path.suffix == ".py" else path.name for path in paths]
    parts = zip(*(path.parts for path in paths), strict=False)
    depth = next((k for k, names in enumerate(parts) if len(set(names)) > 1), 0)
    return [path.parts[depth].removesuffix(".py") for path in paths]


def cell(words: str) -> str:
    """Return a text escaped against CSV injection (OWASP): spreadsheets run formulas."""
    return f"'{words}" if words.startswith(_FORMULAS) else words


def grade_table(assignment: Assignment, grades: Sequence[Grade]) -> str:
    """Return the grades as lines of text."""
    width = max(map(len, ["work", *(grade.work for grade in grades)]))
    lines = [f"{'work'.ljust(width)}  points  crashes  {assignment.metric}"]
    for grade in grades:
        crashes = "-" if grade.crashes is None else f"{grade.crashes:.0%}"
        name = grade.work.ljust(width)
        lines.append(f"{name}  {grade.points:6.1f}  {crashes:>7}  {grade.verdict}")
    if any(grade.copied for grade in grades):
        lines.append("* similar to the named agent or file in actions, weights or source code")
    return "\n" + "\n".join(lines)


def _table_row(assignment: Assignment, grade: Grade) -> dict[str, Any]:
    return {
        "work": cell(grade.work),
        "points": grade.points,
        assignment.metric: grade.value,
        "crashes": grade.crashes,
        "error": cell(grade.error),
        "copied": cell(grade.copied),
    }


def _nbgrader_row(name: str, student: str, grade: Grade) -> dict[str, Any]:
    """Return a row in the format of `nbgrader export`."""
    points = {"raw_score": grade.points, "score": grade.points, "max_score": 100.0}
    return {"assignment": name, "student_id": student, "late_submission_penalty": 0.0, **points}


def _folder_name(work: str) -> str:
    return re.sub(r"[^A-Za-z0-9]+", "-", work)[-60:]


def write_results(folder: Path, assignment: Assignment, grade: Grade) -> None:
    """Write a student's `results.json` for Gradescope.

    Its format: gradescope-autograders.readthedocs.io/en/latest/specs.
    """
    lines = [assignment.rubric, f"yours: {grade.verdict}"]
    if grade.crashes is not None:
        lines.append(f"share of episodes with a crash: {grade.crashes:.0%}")
    if (folder / "failure.html").exists():
        lines.append("failure.html, beside this file, replays the first failed episode")
    shown = {"output": "\n".join(lines), "visibility": "visible"}
    write_json(folder / "results.json", {"score": grade.points, "max_score": 100.0, **shown})


def write_failure(folder: Path, failure: Recording | None) -> None:
    """Write `failure.html` with the first failed episode of a submission; remove it if None."""
    from swarm_envs.viewing import write_replay

    if failure is None:
        (folder / "failure.html").unlink(missing_ok=True)
    else:
        write_replay(folder / "failure.html", failure)
