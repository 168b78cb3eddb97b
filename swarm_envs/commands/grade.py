"""`swarm-envs grade`: the files of a whole course, each in a process of its own, and its points.

What a file is worth is one number that `swarm-envs evaluate` reports, or the error of its force
model; points rise linearly from one value of it to another. Environment, judge and table are the
grader's: a work gives it actions, and nothing else. See `swarm_envs.assignments`.
"""

from __future__ import annotations

import glob
import select
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from swarm_envs.arguments import POSITIVE_S, Count, Seed
from swarm_envs.assignments import ASSIGNMENTS, Assignment, AssignmentName
from swarm_envs.commands.checks import Misuse, check_file, check_folder, command_options
from swarm_envs.commands.grading.grades import Grade, grade_table, write_feedback, write_grades

if TYPE_CHECKING:
    from swarm_envs.commands.grading.remote import RemoteWork


@command_options
@dataclass(frozen=True, kw_only=True)
class GradeOptions:
    """Grade what students handed in: one line of a table for each, whatever happens to it.

    A file that cannot be imported, raises, returns what is no action or takes too long is named
    with its error and gets no points; the others go on.
    """

    assignment: AssignmentName
    """which one; `swarm-envs assignment list` says what they are"""
    agent: list[str] = field(default_factory=list)
    """what was handed in: path/to/file.py:Class each, or a pattern such as 'class/*/swap.py:Class';
    also folders of trained policies"""
    out: Path | None = None
    """write the table to this file after each work: .csv, or .json with the columns of nbgrader"""
    feedback: Path | None = None
    """folder for each student's results.json (Gradescope's format), and failure.html, a page that
    plays the first episode that failed"""
    episodes: Count = 256
    """episodes that each flies"""
    seed: Seed = 0
    """random seed of the episodes, the same for all; use a secret one"""
    data: Path | None = None
    """for `force-model`: the rows.npz of a `swarm-envs collect`, whose validation rows grade"""
    limit_s: Annotated[float, POSITIVE_S] = 600.0
    """time that each may take, s"""

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

    _check_system()
    from swarm_envs.commands.grading.remote import package_state

    if options.out is not None:
        check_file("--out", options.out, (".csv", ".json"))
    if options.feedback is not None:
        check_folder("--feedback", options.feedback)
    if options.data is not None:
        _check_rows(options.data)
    assignment, works = ASSIGNMENTS[options.assignment], _expanded(options.agent)
    _check_works(works)
    grades: list[Grade] = []
    try:
        for work in tqdm(works, desc="grading", unit="file"):
            before = package_state()
            grades.append(_grade(work, works, options, assignment))
            _write(options, grades)
            if package_state() != before:
                raise Misuse(f"{work!r} has changed the package; install it again, and grade again")
    except KeyboardInterrupt:
        print(grade_table(assignment, grades))
        raise KeyboardInterrupt(f"interrupted: {len(grades)} of {len(works)} are graded") from None
    print(grade_table(assignment, grades))
    for place in filter(None, (options.out, options.feedback)):
        print(f"wrote {place}")
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


def _write(options: GradeOptions, grades: list[Grade]) -> None:
    assignment = ASSIGNMENTS[options.assignment]
    if options.out is not None:
        write_grades(options.out, options.assignment, assignment, grades)
    if options.feedback is not None:
        write_feedback(options.feedback, assignment, grades)


def _grade(work: str, works: list[str], options: GradeOptions, assignment: Assignment) -> Grade:
    """Grade one work; whatever goes wrong with it is its own."""
    from swarm_envs.commands.grading.text import printable

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
        if options.assignment == "distributed-mpc":
            from swarm_envs.commands.grade_planner import grade_planner

            return grade_planner(work, works, limits, options.seed, options.episodes)
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
    from swarm_envs.agents import record_episode
    from swarm_envs.agents.evaluation import evaluate_agent, frozen_seeds, score_episodes
    from swarm_envs.agents.protocol import check_options_agree
    from swarm_envs.commands.evaluate import EvaluateOptions
    from swarm_envs.commands.fly import find_task
    from swarm_envs.commands.grading.copies import copied_acts, copied_files
    from swarm_envs.commands.grading.remote import WorkFailed, remote_agent, train_work

    if assignment.train_s:
        train_work(process, assignment.train_s)
    setting = EvaluateOptions(**assignment.flown)
    agent, given = remote_agent(process, made), setting.setting()
    for name in set(assignment.own) & set(agent.requires):
        raise WorkFailed(f"it requires {name!r}, which is what this assignment asks you to write")
    check_options_agree(agent, given)
    env = make(find_task(setting.task), **{**given, **agent.requires})
    try:
        seeds = frozen_seeds(options.seed, options.episodes)
        episodes = [*evaluate_agent(env, agent, seeds)]
        scores = score_episodes(episodes)
        failed = [e["seed"] for e in episodes if not e["metrics"]["success"]]
        if options.feedback is not None and failed:
            scores["failure"] = record_episode(env, agent, failed[0], name=Path(work).name)
        copied = copied_files(work) or copied_acts(env, agent.kept)
    finally:
        env.close()
    return {**scores, "privileged": agent.asked, "copied": copied}
