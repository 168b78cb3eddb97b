"""`swarm-envs grade`: the files of a whole course, each in a process of its own, and its points.

What a file is worth is one number that `swarm-envs evaluate` reports, or the error of its force
model; points rise linearly from one value of it to another. Environment, judge and table are the
grader's: a work gives it actions, and nothing else. See `docs/assignments/`.
"""

from __future__ import annotations

import csv
import glob
import select
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Annotated, Any, Literal, NamedTuple, get_args

from swarm_envs.arguments import POSITIVE_S, Count, Seed
from swarm_envs.commands.checks import Misuse, check_file, command_options

if TYPE_CHECKING:
    from swarm_envs.commands.grading.remote import RemoteWork

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
    flown: Mapping[str, Any] = field(default_factory=dict)
    """Options of `swarm-envs evaluate`; empty where nothing is flown."""

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
            flown={"task": "swap", "layout": "stacked", "drones": 3},
        ),
        "force-model": Assignment(metric="explained", zero=0.3, full=0.9),
        "swap": Assignment(
            metric="success_rate",
            zero=0.50,
            full=0.95,
            flown={"task": "swap", "layout": "random", "drones": 4},
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

    _check_system()
    from swarm_envs.commands.grading.remote import package_state

    if options.out is not None:
        check_file("--out", options.out, (".csv",))
    if options.data is not None:
        _check_rows(options.data)
    assignment, works = ASSIGNMENTS[options.assignment], _expanded(options.work)
    grades: list[_Grade] = []
    try:
        for work in tqdm(works, desc="grading", unit="file"):
            before = package_state()
            grades.append(_grade(work, works, options, assignment))
            if options.out is not None:
                _write(options.out, assignment, grades)
            if package_state() != before:
                raise Misuse(f"{work!r} has changed the package; install it again, and grade again")
    except KeyboardInterrupt:
        print(_table(assignment, grades))
        raise KeyboardInterrupt(f"interrupted: {len(grades)} of {len(works)} are graded") from None
    print(_table(assignment, grades))
    if options.out is not None:
        print(f"wrote {options.out}")
    return sum(bool(grade.error) for grade in grades)


def _check_system() -> None:
    """Say once what this system does not keep a work from.

    Raises:
        Misuse: it has no pipes that can be polled.
    """
    if not hasattr(select, "poll"):
        raise Misuse("works are graded on Linux or macOS; on Windows, in its Linux subsystem")
    from swarm_envs.commands.grading.confinement import probe

    for missing in probe().missing:
        print(f"a work is not confined as it should be here: {missing}")


class _Grade(NamedTuple):
    work: str
    points: float
    value: float | None
    error: str
    privileged: bool
    copied: str

    @property
    def notes(self) -> str:
        """What the table says beside the number."""
        stars = " *" if self.privileged else ""
        return stars + (f" * flies as {self.copied}" if self.copied else "")


def _grade(work: str, works: list[str], options: GradeOptions, assignment: Assignment) -> _Grade:
    """Grade one work; whatever goes wrong with it is its own."""
    from swarm_envs.commands.grading.text import printable

    name, report = printable(work), _report(work, works, options, assignment)
    error, value = printable(report.get("error", "")), report.get(assignment.metric)
    points = 0.0 if error else assignment.points(report)
    stars = bool(report.get("privileged", False)), str(report.get("copied", ""))
    return _Grade(name, points, value, error, *stars)


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


def _report(
    work: str, works: list[str], options: GradeOptions, assignment: Assignment
) -> dict[str, Any]:
    """What the grader finds of a work; or, under `error`, why it has no points."""
    from swarm_envs.commands.grading.confinement import Limits
    from swarm_envs.commands.grading.remote import opened

    limits = Limits(work_s=options.limit_s)
    what = "fly" if assignment.flown else "fit"
    try:
        with opened(work, what, works, limits) as (process, made):
            if options.data is not None:
                from swarm_envs.commands.grade_force import grade_model

                return grade_model(process, options.data)
            return _flown(work, process, made, options, assignment)
    except Exception as error:  # a stranger's work may fail in any way, and the next is graded
        known = isinstance(error, RuntimeError)
        return {"error": str(error) if known else f"{type(error).__name__}: {error}"}


def _flown(
    work: str,
    process: RemoteWork,
    made: Mapping[str, Any],
    options: GradeOptions,
    assignment: Assignment,
) -> dict[str, Any]:
    """The scores of `swarm-envs evaluate`, and who has helped the work."""
    from swarm_envs import make
    from swarm_envs.agents.evaluation import evaluate_agent, frozen_seeds, score_episodes
    from swarm_envs.agents.protocol import check_options_agree
    from swarm_envs.commands.evaluate import EvaluateOptions
    from swarm_envs.commands.fly import find_task
    from swarm_envs.commands.grading.copies import copied_acts, copied_files
    from swarm_envs.commands.grading.remote import remote_agent

    setting = EvaluateOptions(**assignment.flown)
    agent, given = remote_agent(process, made), setting.setting()
    check_options_agree(agent, given)
    env = make(find_task(setting.task), **{**given, **agent.requires})
    try:
        seeds = frozen_seeds(options.seed, options.episodes)
        scores = score_episodes([*evaluate_agent(env, agent, seeds)])
        copied = copied_files(work) or copied_acts(env, agent.kept)
    finally:
        env.close()
    return {**scores, "privileged": agent.asked, "copied": copied}


def _table(assignment: Assignment, grades: list[_Grade]) -> str:
    width = max(map(len, ["work", *(grade.work for grade in grades)]))
    lines = [f"{'work'.ljust(width)}  points  {assignment.metric}"]
    for grade in grades:
        value = "-" if grade.value is None else f"{grade.value:.4g}"
        said = f"FAILED: {grade.error}" if grade.error else value
        lines.append(f"{grade.work.ljust(width)}  {grade.points:6.1f}  {said}{grade.notes}")
    if any(grade.privileged for grade in grades):
        lines.append("* sees the true state")
    return "\n" + "\n".join(lines)


def _write(path: Path, assignment: Assignment, grades: list[_Grade]) -> None:
    from swarm_envs.commands.grading.text import cell
    from swarm_envs.files import written_whole

    with written_whole(path) as whole, whole.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(["work", "points", assignment.metric, "error", "privileged", "copied"])
        for work, points, value, error, *stars in grades:
            writer.writerow([cell(work), points, value, cell(error), *stars])
