"""`swarm-envs grade`: grade the submissions of a course, each in its own sandbox."""

from __future__ import annotations

import glob
import secrets
import sys
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from swarm_envs.commands.checks import Misuse, as_misuse, check_file, check_folder
from swarm_envs.errors import check_integer, check_name, check_number

if TYPE_CHECKING:
    from swarm_envs.grading.sandbox import Sandbox

LEAST_SEED = 1 << 128
"""The least seed with 128 random bits, which no submission can guess."""


@dataclass(frozen=True, kw_only=True)
class GradeOptions:
    """Grade the submissions of students, and print a table with one line for each.

    A submission that cannot be imported, raises an error, returns invalid actions or takes too long
    gets no points, and the table names the error; the others are still graded. An interrupted
    command resumes when it is run again with the same --out.
    """

    assignment: str
    """Name of an assignment of `swarm-envs assignment list`, or path/to/file.py that defines a
    custom one."""
    agent: list[str] = field(default_factory=list)
    """Submissions: path/to/file.py:Class, patterns such as 'class/*/swap.py:Class' (in quotes), or
    folders of trained policies."""
    out: Path | None = None
    """Write the table to this file after each submission: .csv, or .json with the columns of
    nbgrader."""
    feedback: Path | None = None
    """Output folder, with each student's results.json (Gradescope's format) and failure.html, a
    replay page of the first episode that failed."""
    episodes: int = 256
    """Number of episodes per submission."""
    seed: int | None = None
    """Random seed of the episodes, the same for all submissions. If None, a secret seed is drawn;
    it is printed at the end."""
    limit_s: float = 600.0
    """Time limit of each submission, s."""
    allow_copies: bool = False
    """Give points to copies of included agents and of reference solutions."""
    sandbox: str | None = None
    """Command that runs a submission instead of bubblewrap; {work} is replaced by its folder:
    'docker run -i --rm --network none -v {work}:/work:ro -w /work IMAGE'."""
    unprotected: bool = False
    """Grade without a sandbox, in a container or virtual machine that serves nothing else."""

    def __post_init__(self) -> None:
        """Raise ValueError if an option is invalid."""
        check_integer("--episodes", self.episodes, at_least=1)
        if self.seed is not None:
            check_integer("--seed", self.seed, at_least=0)
        check_number("--limit-s", self.limit_s, above=0.0, unit="s")
        from swarm_envs.assignments import ASSIGNMENTS

        if not self.assignment.endswith(".py"):
            check_name("assignment", self.assignment, ASSIGNMENTS)
        if not self.agent:
            raise ValueError("--agent is empty; name one or more submissions, file.py:Class")


def run_grade(options: GradeOptions) -> int:
    """Grade, print and write; return the number of submissions that failed.

    Raises:
        Misuse: the assignment, a submission or a sandbox does not exist; nothing was graded.
        KeyboardInterrupt: the command was interrupted; the table has the grades until then.
    """
    from tqdm import tqdm

    from swarm_envs.grading.assignment import load_assignment
    from swarm_envs.grading.grade import Course, Grade, grade_table, seed_of
    from swarm_envs.grading.submission import WorkFailed

    if options.seed is not None and options.seed < LEAST_SEED:
        print(
            f"warning: submissions can guess the seed {options.seed} and prepare for its episodes; "
            "leave out --seed to grade other people's work, and a secret seed is drawn and printed",
            file=sys.stderr,
        )
    if options.out is not None:
        check_file("--out", options.out, (".csv", ".json"))
    if options.feedback is not None:
        check_folder("--feedback", options.feedback)
    with as_misuse(FileNotFoundError, ImportError):
        assignment = load_assignment(options.assignment)
    works = _expanded(options.agent)
    _check_works(works, Path(options.assignment))
    seed = seed_of(options.out) if options.seed is None else options.seed
    if seed is None:
        seed = LEAST_SEED + secrets.randbits(128)
    sandbox = _sandbox(options, works)
    course = Course(
        assignment,
        works,
        seed,
        options.episodes,
        sandbox,
        options.limit_s,
        options.allow_copies,
        options.out,
        options.feedback,
    )
    with as_misuse(TypeError, WorkFailed):
        course.check()
    grades: list[Grade] = []
    try:
        for grade in tqdm(course.grade(), desc="grading", unit="file", total=len(works)):
            grades.append(grade)
    except KeyboardInterrupt:
        print(grade_table(assignment, grades))
        raise KeyboardInterrupt(
            f"interrupted: {len(grades)} of {len(works)} submissions are graded"
        ) from None
    print(grade_table(assignment, grades))
    print(f"to reproduce the grades: --seed {seed}")
    for path in filter(None, (options.out, options.feedback)):
        print(f"wrote {path}")
    return sum(bool(grade.error) for grade in grades)


def _sandbox(options: GradeOptions, works: list[str]) -> Sandbox:
    """Return the sandbox of the submissions; a single submission may run without one.

    Raises:
        Misuse: there are several submissions, and no sandbox.
    """
    from swarm_envs.grading.sandbox import Sandbox, has_bubblewrap

    if options.sandbox is not None or options.unprotected or has_bubblewrap():
        return Sandbox(options.sandbox, options.unprotected, weights=options.allow_copies)
    if len(works) > 1:
        raise Misuse(
            f"{len(works)} submissions could read and change your files and each other's here; "
            "install bubblewrap, name a container with --sandbox 'docker run ...', or add "
            "--unprotected on a machine that serves nothing else"
        )
    print(f"{works[0]} runs without a sandbox, like any other program: grade only your own work")
    return Sandbox(unprotected=True)


def _expanded(works: list[str]) -> list[str]:
    """Return the submissions that match names and patterns (shells expand none before `:Class`)."""
    found = []
    for work in works:
        path, colon, name = work.rpartition(":") if ".py:" in work else (work, "", "")
        if Path(path).is_file() and path.endswith(".py") and not name:
            raise Misuse(
                f"--agent is {work!r}, but must name a class or function of the file, as "
                f"{path + ':MyAgent'!r}; nothing was graded"
            )
        files = sorted(glob.glob(path)) if glob.has_magic(path) else [path]  # noqa: PTH207
        if not files:
            raise Misuse(f"--agent is {work!r}, but no file matches that pattern")
        found += [f"{file}{colon}{name}" for file in files]
    return found


def _check_works(works: list[str], assignment: Path) -> None:
    """Raise Misuse if a submission does not exist, or could be imported by a custom assignment."""
    from swarm_envs.grading.submission import path_of

    paths = [path_of(work) for work in works]
    missing = [str(path) for path in paths if not path.exists()]
    if missing:
        raise Misuse(f"--agent names no existing file: {', '.join(missing)}; nothing was graded")
    folder = assignment.resolve().parent
    if assignment.suffix == ".py" and folder in [path.resolve().parent for path in paths]:
        raise Misuse(
            f"--assignment is {str(assignment)!r}, but submissions are in the same folder, and it "
            "could import them; move it to another folder"
        )
