"""An assignment: what is flown, the number that counts, and what it is worth."""

from __future__ import annotations

import ast
import inspect
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, ClassVar

from swarm_envs.errors import check_name, check_number, unknown_name
from swarm_envs.grading.copies import copied_acts, copied_files, harmless
from swarm_envs.grading.remote import remote_agent
from swarm_envs.grading.submission import Entry, RemoteWork, WorkFailed, path_of
from swarm_envs.user_files import import_file

if TYPE_CHECKING:
    from swarm_envs.agents.evaluation import Episode

__all__ = ["Assignment", "load_assignment"]

MOST_CODE, MOST_CONSTANTS, MOST_NAMES = 20_000, 2_000, 4_000
"""Characters of a learner's code without comments, of all constants, and of different names."""
_NEEDED = ("name", "work", "metric", "zero", "full")  # attributes without a default
_SETUP_S = 60.0  # CPU time for imports and compilation, before a work trains
_EPISODE_S = 0.25  # CPU time for the decisions of an episode


class Assignment:
    """A task for students and its marks: subclass it, and grade with `--assignment my.py`.

    The class attributes say everything about flights in an environment; override `grade` for what
    is no flight. The docstring is the one line that describes it.
    """

    name: ClassVar[str]
    """Its name."""
    work: ClassVar[str]
    """The submission that is asked for, as `file.py:Class`."""
    task: ClassVar[str] = "swap_v1"
    """Name of the environment."""
    options: ClassVar[Mapping[str, Any]] = MappingProxyType({})
    """Options of the environment."""
    metric: ClassVar[str]
    """The number that counts, as `swarm_envs.agents.evaluation.score_episodes` names it."""
    zero: ClassVar[float]
    """Its value that is worth nothing."""
    full: ClassVar[float]
    """Its value, or better, that is worth 100 points."""
    counted: ClassVar[str] = "without a crash"
    """Which episodes `counts` takes, in words."""
    rate: ClassVar[int] = 0
    """Decisions a second at which errors are taken at least; 0 for the work's own rate."""
    train_s: ClassVar[float] = 0.0
    """Time that the work's `train` is given before the flights, s; 0 if it has none."""

    def check(self) -> None:
        """Refuse what no work can mend.

        Raises:
            ValueError: an attribute is missing or impossible; or the environment's options.
            TypeError: there is no such option.
        """
        from swarm_envs import make

        missing = [name for name in _NEEDED if getattr(self, name, None) is None]
        if missing:
            raise ValueError(
                f"{type(self).__name__} lacks {', '.join(missing)}; add them to the class"
            )
        check_number("zero", self.zero)
        check_number("full", self.full)
        if self.zero == self.full:
            raise ValueError(f"zero and full are both {self.zero:g}; they must differ")
        make(self.task, **{**self.options, "physics": "batch"}).close()

    def counts(self, metrics: Mapping[str, Any]) -> bool:
        """Return whether an episode counts; points are multiplied by the share of these."""
        from swarm_envs.agents.evaluation import collided

        return not collided(metrics)

    def points(self, report: Mapping[str, Any]) -> float:
        """Return points from 0 to 100 for the metric, times the share of episodes that count.

        Raises:
            ValueError: the report has no such metric.
        """
        if self.metric not in report:
            numbers = [name for name, value in report.items() if isinstance(value, int | float)]
            raise ValueError(
                unknown_name(f"metric of assignment {self.name!r}", self.metric, numbers)
            )
        value = report[self.metric]
        if value is None:
            return 0.0
        share = (float(value) - self.zero) / (self.full - self.zero)
        return round(100.0 * min(max(share, 0.0), 1.0) * float(report.get("counted", 1.0)), 1)

    @property
    def rubric(self) -> str:
        """The rule of the points in one sentence."""
        said = f"{self.metric}: {self.zero:g} gives 0 points, {self.full:g} gives 100"
        return f"{said}, times the share of episodes {self.counted}" if self.counted else said

    @property
    def summary(self) -> str:
        """The first line of the docstring."""
        return (inspect.getdoc(type(self)) or "").partition("\n")[0].rstrip(".")

    def grade(self, entry: Entry) -> dict[str, Any]:
        """Return the scores of a work, the share of episodes `counted`, and whom it has `copied`.

        Raises:
            WorkFailed: it failed.
        """
        from swarm_envs import make
        from swarm_envs.agents import record_episode
        from swarm_envs.agents.evaluation import evaluate_agent, score_episodes

        copied = harmless(copied_files, entry.home, entry.work)
        if self.train_s:
            _keep_code(entry)
        with entry.opened(flies=True) as (work, made):
            if self.train_s:
                work.ask("train", {"seconds": self.train_s}, limit_s=1.5 * self.train_s + _SETUP_S)
            agent = remote_agent(
                work, made, {"task": self.task, "options": dict(self.options)}, self.rate
            )
            env = make(self.task, **{**self.options, "physics": "batch", **agent.requires})
            try:
                episodes = [*evaluate_agent(env, agent, entry.seeds, timed=1)]
                self._check_cpu(work, len(episodes))
                failed = [e["seed"] for e in episodes if not e["metrics"]["success"]]
                shown = entry.shown if failed else None
                failure = shown and record_episode(env, agent, failed[0], name=shown)
            finally:
                env.close()
        copied = copied or harmless(copied_acts, env, agent.kept)
        return {**self._scored(episodes, score_episodes), "copied": copied, "failure": failure}

    def _scored(self, episodes: list[Episode], score: Any) -> dict[str, Any]:
        counted = sum(self.counts(episode["metrics"]) for episode in episodes) / len(episodes)
        return {**score(episodes), "counted": counted}

    def _check_cpu(self, work: RemoteWork, episodes: int) -> None:
        """Refuse a learner that computes outside `train` what it should learn there."""
        most = 1.5 * self.train_s + _SETUP_S + _EPISODE_S * episodes
        if self.train_s and (spent := work.process.cpu_s()) > most:
            raise WorkFailed(f"used {spent:.0f} s of CPU time in all, but may use {most:.0f} s")


def _keep_code(entry: Entry) -> None:
    """Leave of a learner its code alone, which has no room for weights.

    Raises:
        WorkFailed: it is no Python file, or has more code or constants than it may.
        SyntaxError: it is no Python.
    """
    path = path_of(entry.work)
    if path.suffix != ".py":
        raise WorkFailed("it is no class in a Python file, so that it cannot learn")
    tree = ast.parse((entry.home / path).read_bytes())
    for node in ast.walk(tree):
        body = getattr(node, "body", None)
        if isinstance(body, list):
            body[:] = [line for line in body if not _is_text(line)] or [ast.Pass()]
    for file in sorted(entry.home.rglob("*"), reverse=True):
        file.rmdir() if file.is_dir() else file.unlink()
    source = ast.unparse(tree)
    nodes = [*ast.walk(tree)]
    constants = [repr(node.value) for node in nodes if isinstance(node, ast.Constant)]
    rest = (vars(node).values() for node in nodes if not isinstance(node, ast.Constant))
    names = {text for values in rest for text in values if isinstance(text, str)}
    for what, size, most in (
        ("code has", len(source), MOST_CODE),
        ("constants have", sum(map(len, constants)), MOST_CONSTANTS),
        ("different names have", sum(map(len, names)), MOST_NAMES),
    ):
        if size > most:
            raise WorkFailed(
                f"its {what} {size} characters, but may have {most}: what counts is learned in "
                "train()"
            )
    (entry.home / path).write_text(source, encoding="utf-8")


def _is_text(line: ast.stmt) -> bool:
    """Return whether a statement is a docstring, or another constant that does nothing."""
    return isinstance(line, ast.Expr) and isinstance(line.value, ast.Constant)


def load_assignment(name: str) -> Assignment:
    """Return an assignment that ships, or the one of a file.

    Raises:
        ValueError: there is none of this name, or the file does not define one.
        FileNotFoundError: there is no such file.
        ImportError: it cannot be imported.
    """
    from swarm_envs.assignments import ASSIGNMENTS

    if not name.endswith(".py"):
        return ASSIGNMENTS[check_name("assignment", name, ASSIGNMENTS)]
    module = import_file(Path(name))
    own = [
        kind
        for kind in vars(module).values()
        if inspect.isclass(kind) and issubclass(kind, Assignment)
        if kind.__module__ == module.__name__
    ]
    if len(own) != 1:
        raise ValueError(f"{name!r} defines {len(own)} subclasses of Assignment, but must define 1")
    return own[0]()
