"""`swarm-envs grade`: the files of a whole course, each in a sandbox of its own, and its points."""

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
"""Seeds from here on have 128 bits below their first: no submission can guess them."""


@dataclass(frozen=True, kw_only=True)
class GradeOptions:
    """Grade submissions of students and print a table with one line for each.

    A submission that cannot be imported, raises an error, returns invalid actions or takes too long
    gets no points, and the table names the error; the others are still graded. Interrupted and run
    again with the same --out, the command resumes.
    """

    assignment: str
    """assignment; `swarm-envs assignment list` describes each; or path/to/my.py with one's own"""
    agent: list[str] = field(default_factory=list)
    """submissions: path/to/file.py:Class each, or a pattern such as 'class/*/swap.py:Class';
    also folders of trained policies"""
    out: Path | None = None
    """write the table to this file after each submission: .csv, or .json with the columns of
    nbgrader"""
    feedback: Path | None = None
    """folder for each student's results.json (Gradescope's format), and failure.html, a page that
    plays the first episode that failed"""
    episodes: int = 256
    """number of episodes of each submission"""
    seed: int | None = None
    """seed of the episodes, the same for all, as an earlier run printed it; by default a secret one
    is drawn"""
    limit_s: float = 600.0
    """time limit of each submission, s"""
    allow_copies: bool = False
    """give copies of included agents and reference solutions their points"""
    sandbox: str | None = None
    """command that runs a submission in place of bubblewrap, where {work} is its folder, such as
    'docker run -i --rm --network none -v {work}:/work:ro -w /work IMAGE'"""
    unprotected: bool = False
    """grade without a sandbox: for a container or virtual machine that serves nothing else"""

    def __post_init__(self) -> None:
        """Refuse what cannot be graded."""
        check_integer("--episodes", self.episodes, at_least=1)
        if self.seed is not None:
            check_integer("--seed", self.seed, at_least=0)
        check_number("--limit-s", self.limit_s, above=0.0, unit="s")
        from swarm_envs.assignments import ASSIGNMENTS

        if not self.assignment.endswith(".py"):
            check_name("assignment", self.assignment, ASSIGNMENTS)
        if not self.agent:
            raise ValueError("--agent is empty; name one file.py:Class or more")


def run_grade(options: GradeOptions) -> int:
    """Grade, print and write; return how many failed.

    Raises:
        Misuse: there is no such assignment or work, or no sandbox; nothing was graded.
        KeyboardInterrupt: with what was graded until then; the table has it.
    """
    from tqdm import tqdm

    from swarm_envs.grading.assignment import load_assignment
    from swarm_envs.grading.grade import Course, Grade, grade_table, seed_of
    from swarm_envs.grading.submission import Limits, WorkFailed

    if options.seed is not None and options.seed < LEAST_SEED:
        print(
            f"warning: submissions can guess the seed {options.seed} and fly the episodes before; "
            "to grade those of others leave it out, and one of 128 bits is drawn and printed",
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
    seed = options.seed or seed_of(options.out) or LEAST_SEED + secrets.randbits(128)
    sandbox = _sandbox(options, works)
    course = Course(
        assignment,
        works,
        seed,
        options.episodes,
        sandbox,
        Limits(work_s=options.limit_s),
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
        raise KeyboardInterrupt(f"interrupted: {len(grades)} of {len(works)} are graded") from None
    print(grade_table(assignment, grades))
    print(f"the same marks again: --seed {seed}")
    for place in filter(None, (options.out, options.feedback)):
        print(f"wrote {place}")
    return sum(bool(grade.error) for grade in grades)


def _sandbox(options: GradeOptions, works: list[str]) -> Sandbox:
    """Return what keeps works apart; one's own single file needs nothing.

    Raises:
        Misuse: there are several works, and there is no sandbox.
    """
    from swarm_envs.grading.sandbox import Sandbox, has_bubblewrap

    if options.sandbox is not None or options.unprotected or has_bubblewrap():
        return Sandbox(options.sandbox, options.unprotected, weights=options.allow_copies)
    if len(works) > 1:
        raise Misuse(
            f"{len(works)} submissions could read and change your files and each other's here; "
            "install bubblewrap, name a container with --sandbox 'docker run ...', or add "
            "--unprotected in a machine that serves nothing else"
        )
    print(f"{works[0]} runs as any other program here, without a sandbox: grade only your own")
    return Sandbox(unprotected=True)


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


def _check_works(works: list[str], assignment: Path) -> None:
    """Refuse works that are not there, or that one's own assignment would import.

    Raises:
        Misuse: naming the files.
    """
    from swarm_envs.grading.submission import path_of

    paths = [path_of(work) for work in works]
    missing = [str(path) for path in paths if not path.exists()]
    if missing:
        raise Misuse(f"--agent names what is not there: {', '.join(missing)}; nothing was graded")
    folder = assignment.resolve().parent
    if assignment.suffix == ".py" and folder in [path.resolve().parent for path in paths]:
        raise Misuse(
            f"--assignment is {str(assignment)!r}, but submissions lie beside it, and it could "
            "import them; move it into a folder of its own"
        )
