"""`swarm-envs grade`: the files of a whole course, each in a process of its own, and its points.

What a file is worth is one number that `swarm-envs evaluate` reports, or the error of its force
model; points rise linearly from one value of it to another. Environment, judge and table are the
grader's: a work gives it actions, and nothing else. See `swarm_envs.assignments`.
"""

from __future__ import annotations

import glob
import select
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any

from swarm_envs.arguments import POSITIVE_S, Count, Seed
from swarm_envs.assignments import ASSIGNMENTS, Assignment, AssignmentName
from swarm_envs.commands.checks import Misuse, check_file, check_folder, command_options
from swarm_envs.commands.grading.grades import (
    Grade,
    grade_table,
    printable,
    write_feedback,
    write_grades,
)


@command_options
@dataclass(frozen=True, kw_only=True)
class GradeOptions:
    """Grade submissions of students and print a table with one line for each.

    A submission that cannot be imported, raises an error, returns invalid actions or takes too long
    gets no points, and the table names the error; the others are still graded.
    """

    assignment: AssignmentName
    """assignment; `swarm-envs assignment list` describes each"""
    agent: list[str] = field(default_factory=list)
    """submissions: path/to/file.py:Class each, or a pattern such as 'class/*/swap.py:Class';
    also folders of trained policies"""
    out: Path | None = None
    """write the table to this file after each submission: .csv, or .json with the columns of
    nbgrader"""
    feedback: Path | None = None
    """folder for each student's results.json (Gradescope's format), and failure.html, a page that
    plays the first episode that failed"""
    episodes: Count = 256
    """number of episodes of each submission"""
    seed: Seed = 0
    """random seed of the episodes, the same for all; use a secret one"""
    data: Path | None = None
    """for `force-model`: the rows.npz of a `swarm-envs collect`, whose validation rows grade"""
    limit_s: Annotated[float, POSITIVE_S] = 600.0
    """time limit of each submission, s"""
    unprotected: bool = False
    """grade even where nothing keeps submissions from renaming or removing your files: for a
    container or virtual machine that serves nothing else"""

    def __post_init__(self) -> None:
        """Refuse what cannot be graded."""
        if not self.agent:
            raise ValueError("--agent is empty; name one file.py:Class or more")
        if (self.assignment == "force-model") != (self.data is not None):
            raise ValueError("--data is for --assignment force-model, which needs it")


def run_grade(options: GradeOptions) -> int:
    """Grade, print and write; return how many failed.

    Raises:
        Misuse: there is no such work or data, or the table cannot be written; nothing was graded.
        KeyboardInterrupt: with what was graded until then; the table has it.
    """
    from tqdm import tqdm

    from swarm_envs.commands.grading.confinement import probe
    from swarm_envs.commands.grading.remote import package_state

    _check_system(options.unprotected)
    if options.out is not None:
        check_file("--out", options.out, (".csv", ".json"))
    if options.feedback is not None:
        check_folder("--feedback", options.feedback)
    if options.data is not None:
        _check_rows(options.data)
    assignment, works = ASSIGNMENTS[options.assignment], _expanded(options.agent)
    _check_works(works)
    if probe().can_rename:
        _rehearse(options, assignment)
    grades: list[Grade] = []
    before = package_state()
    try:
        for work in tqdm(works, desc="grading", unit="file"):
            grade = _grade(work, works, options, assignment)
            if package_state() != before:
                raise Misuse(f"{work!r} has changed the package; install it again, and grade again")
            grades.append(grade)
            _write(options, grades)
    except KeyboardInterrupt:
        print(grade_table(assignment, grades))
        raise KeyboardInterrupt(f"interrupted: {len(grades)} of {len(works)} are graded") from None
    print(grade_table(assignment, grades))
    for place in filter(None, (options.out, options.feedback)):
        print(f"wrote {place}")
    return sum(bool(grade.error) for grade in grades)


def _check_system(unprotected: bool) -> None:
    """Say once what this system does not keep a work from.

    Raises:
        Misuse: it has no pipes that can be polled, or protects no file and `unprotected` is False.
    """
    if not hasattr(select, "poll"):
        raise Misuse("works are graded on Linux or macOS; on Windows, in its Linux subsystem")
    from swarm_envs.commands.grading.confinement import probe

    for missing in probe().missing:
        print(f"a work is not confined as it should be here: {missing}")
    if probe().can_rename and not unprotected:
        raise Misuse(
            "nothing keeps a work from renaming and removing your files here; grade on Linux with "
            "user namespaces or Landlock, or add --unprotected in a container of its own"
        )


def _rehearse(options: GradeOptions, assignment: Assignment) -> None:
    """Grade the starter first: what is imported, compiled and read by then, no work can replace."""
    from swarm_envs import assignments
    from swarm_envs.commands.grade_flights import rehearse

    if assignment.flown:
        rehearse(assignment)
    starter = str(Path(assignments.__file__).parent / options.assignment / assignment.work)
    with tempfile.TemporaryDirectory() as folder:
        out = options.out and Path(folder) / options.out.name
        trial = replace(options, out=out, feedback=Path(folder), episodes=32)
        short = replace(assignment, train_s=min(assignment.train_s, 1.0))
        _write(trial, [_grade(starter, [starter], trial, short)])


def _write(options: GradeOptions, grades: list[Grade]) -> None:
    assignment = ASSIGNMENTS[options.assignment]
    if options.out is not None:
        write_grades(options.out, options.assignment, assignment, grades)
    if options.feedback is not None:
        write_feedback(options.feedback, assignment, grades)


def _grade(work: str, works: list[str], options: GradeOptions, assignment: Assignment) -> Grade:
    """Grade one work; whatever goes wrong with it is its own."""
    name, report = printable(work), _report(work, works, options, assignment)
    error, value = printable(report.get("error", "")), report.get(assignment.metric)
    points = 0.0 if error else assignment.points(report)
    stars = bool(report.get("privileged", False)), str(report.get("copied", ""))
    return Grade(name, points, value, error, *stars, report.get("failure"))


def _expanded(works: list[str]) -> list[str]:
    """Works by name; shells leave a pattern alone that a class follows."""
    found = []
    for work in works:
        path, colon, name = work.rpartition(":") if ".py:" in work else (work, "", "")
        files = sorted(glob.glob(path)) if glob.has_magic(path) else [path]  # noqa: PTH207
        if not files:
            raise Misuse(f"--agent is {work!r}, but no file's name matches that pattern")
        found += [f"{file}{colon}{name}" for file in files]
    return found


def _check_works(works: list[str]) -> None:
    """A file that is not there is the mistake of who typed its name.

    Raises:
        Misuse: naming the files.
    """
    from swarm_envs.agents.registry import FILTER, SHIPPED
    from swarm_envs.commands.grading.remote import path_of

    named = [work for work in works if work.removesuffix(FILTER) not in SHIPPED]
    missing = [str(path_of(work)) for work in named if not path_of(work).exists()]
    if missing:
        raise Misuse(f"--agent names what is not there: {', '.join(missing)}; nothing was graded")


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
            "some must be, and others not: collect more flights"
        )


def _report(
    work: str, works: list[str], options: GradeOptions, assignment: Assignment
) -> dict[str, Any]:
    """What the grader finds of a work; or, under `error`, why it has no points."""
    # Before the first work begins: what is imported later, it might have replaced.
    from swarm_envs.agents.evaluation import frozen_seeds
    from swarm_envs.commands.grade_flights import grade_agent
    from swarm_envs.commands.grade_force import grade_model
    from swarm_envs.commands.grade_planner import grade_planner
    from swarm_envs.commands.grading.confinement import Limits
    from swarm_envs.commands.grading.copies import check_files, copied_files
    from swarm_envs.commands.grading.remote import opened

    limits = Limits(work_s=options.limit_s)
    seeds = frozen_seeds(options.seed, options.episodes)
    shown = None if options.feedback is None else Path(work).name
    try:
        check_files(work)
        copied = copied_files(work)
        if options.assignment == "distributed-mpc":
            found = grade_planner(work, works, limits, seeds, shown)
        elif options.data is not None:
            with opened(work, "fit", works, limits) as (process, _):
                found = grade_model(process, options.data)
        elif assignment.train_s:
            with _bare(work) as bare, opened(bare, "fly", works, limits, False) as (process, made):
                found = grade_agent(process, made, assignment, seeds, shown)
        else:
            with opened(work, "fly", works, limits) as (process, made):
                found = grade_agent(process, made, assignment, seeds, shown)
    except Exception as error:  # a stranger's work may fail in any way, and the next is graded
        known = isinstance(error, RuntimeError)
        return {"error": str(error) if known else f"{type(error).__name__}: {error}"}
    return {**found, "copied": copied or found.get("copied", "")}


@contextmanager
def _bare(work: str) -> Iterator[str]:
    """A learner by the name of a copy that has no room for weights.

    Raises:
        WorkFailed: its code alone has room for them.
        SyntaxError: it is no Python.
    """
    from swarm_envs.commands.grading.copies import bare_source, check_room
    from swarm_envs.commands.grading.remote import path_of

    path = path_of(work)
    if path.suffix != ".py":  # nothing that learns: it fails
        yield work
        return
    with tempfile.TemporaryDirectory(prefix="swarm-envs-grade-") as folder:
        source, copy = bare_source(path), Path(folder, path.name)
        check_room(source)
        copy.write_text(source, encoding="utf-8")
        Path(folder).chmod(0o755)  # the work may be another user's process
        yield f"{copy}:{work.rpartition(':')[2]}"
