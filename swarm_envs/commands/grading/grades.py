"""The results of a class: the table, its files, and the feedback for each student."""

from __future__ import annotations

import re
import statistics
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from swarm_envs.assignments import Assignment
from swarm_envs.files import write_json, write_table

if TYPE_CHECKING:
    from swarm_envs.viewing import Recording

LONGEST = 500  # Characters that are kept of a submission's message
_FORMULAS = ("=", "+", "-", "@", "\t", "\r")


def printable(words: str) -> str:
    """Words on one line: control characters as escapes, and no more of them than `LONGEST`."""
    letters = [c if c.isprintable() else ascii(c)[1:-1] for c in words[: LONGEST + 1]]
    shown = "".join(letters)
    return shown if len(shown) <= LONGEST else shown[: LONGEST - 1] + "…"


def cell(words: str) -> str:
    """Words that no spreadsheet takes for a formula, as OWASP says of CSV injection."""
    return f"'{words}" if words.startswith(_FORMULAS) else words


class Grade(NamedTuple):
    """What one work is worth."""

    work: str  # Its name, as it can be printed
    points: float  # From 0 to 100
    value: float | None  # The assignment's number; None if the work failed
    error: str  # Why it has no points; empty if it has
    privileged: bool  # Whether it has asked for the true state
    copied: str  # The shipped agent that it is a copy of, if any
    failure: Recording | None = None  # The first episode that was no success

    @property
    def notes(self) -> str:
        """What the table says beside the number."""
        stars = " *" if self.privileged else ""
        return stars + (f" * flies as {self.copied}" if self.copied else "")


def grade_table(assignment: Assignment, grades: Sequence[Grade]) -> str:
    """The grades as lines of text."""
    width = max(map(len, ["work", *(grade.work for grade in grades)]))
    lines = [f"{'work'.ljust(width)}  points  {assignment.metric}"]
    for grade in grades:
        value = "-" if grade.value is None else f"{grade.value:.4g}"
        said = f"FAILED: {grade.error}" if grade.error else value
        lines.append(f"{grade.work.ljust(width)}  {grade.points:6.1f}  {said}{grade.notes}")
    if any(grade.privileged for grade in grades):
        lines.append("* sees the true state")
    return "\n" + "\n".join(lines)


def write_grades(path: Path, name: str, assignment: Assignment, grades: Sequence[Grade]) -> None:
    """Write the table, whole: .csv, or .json with the columns of nbgrader's exporter.

    Raises:
        OSError: the file cannot be written.
    """
    if path.suffix == ".json":
        write_json(path, [_nbgrader_row(name, grade) for grade in grades])
        return
    write_table(path, [_table_row(assignment, grade) for grade in grades])


def _table_row(assignment: Assignment, grade: Grade) -> dict[str, Any]:
    return {
        "work": cell(grade.work),
        "points": grade.points,
        assignment.metric: grade.value,
        "error": cell(grade.error),
        "privileged": grade.privileged,
        "copied": grade.copied,
    }


def _nbgrader_row(name: str, grade: Grade) -> dict[str, Any]:
    """A row as `nbgrader export` has it; the student is the folder that the work lies in."""
    student = Path(grade.work.partition(".py:")[0]).parent.name
    return {
        "assignment": name,
        "student_id": student or grade.work,
        "raw_score": grade.points,
        "late_submission_penalty": 0.0,
        "score": grade.points,
        "max_score": 100.0,
    }


def write_feedback(folder: Path, assignment: Assignment, grades: Sequence[Grade]) -> None:
    """Write the feedback for each student: `results.json` in Gradescope's format, `failure.html`.

    Raises:
        OSError: a file cannot be written.
    """
    for number, grade in enumerate(grades):
        place = folder / f"{number:03d}-{re.sub(r'[^A-Za-z0-9]+', '-', grade.work)[-60:]}"
        place.mkdir(parents=True, exist_ok=True)
        write_json(place / "results.json", _gradescope(assignment, grade, grades))
        if grade.failure is not None and not (place / "failure.html").is_file():
            from swarm_envs.viewing import write_replay

            write_replay(place / "failure.html", grade.failure)


def _gradescope(assignment: Assignment, grade: Grade, grades: Sequence[Grade]) -> dict[str, Any]:
    """Gradescope's `results.json`: gradescope-autograders.readthedocs.io/en/latest/specs."""
    reached = [other.value for other in grades if other.value is not None]
    said = [assignment.rubric, grade.error or f"yours: {grade.value:.4g}{grade.notes}"]
    if grade.failure is not None:
        said.append(f"the first episode that failed has seed {grade.failure.about.seed}")
    if len(reached) > 1:
        quarters = ", ".join(f"{q:.4g}" for q in statistics.quantiles(reached, method="inclusive"))
        said.append(f"quartiles of the {len(reached)} works so far: {quarters}")
    shown = {"output": "\n".join(said), "visibility": "visible"}
    return {"score": grade.points, "max_score": 100.0, **shown}
