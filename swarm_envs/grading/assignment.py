"""Assignments: their environment, metric and points."""

from __future__ import annotations

import ast
import inspect
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any, ClassVar

from swarm_envs.errors import check_name, check_number, unknown_name
from swarm_envs.grading.copies import copied_acts, copied_files, harmless
from swarm_envs.grading.remote import remote_agent
from swarm_envs.grading.submission import Entry, RemoteWork, WorkFailed, path_of
from swarm_envs.user_files import import_file

__all__ = ["Assignment", "load_assignment"]

MOST_CODE, MOST_CONSTANTS, MOST_NAMES = 20_000, 2_000, 4_000
"""Most characters of a learner's code without comments, of all constants, and of distinct names."""
_NEEDED = ("name", "work", "metric", "zero", "full")  # Attributes without a default
_SETUP_S = 60.0  # CPU time for imports and compilation before training
_EPISODE_S = 0.25  # CPU time for the decisions of an episode


class Assignment:
    """Base class of assignments; grade a subclass with `--assignment my.py`.

    The class attributes define an assignment in an environment; override `grade` for others. The
    docstring is a description of one line.
    """

    name: ClassVar[str]
    """The name of the assignment."""
    work: ClassVar[str]
    """The name of submissions, as `file.py:Class`."""
    task: ClassVar[str] = "swap_v1"
    """The name of the environment."""
    options: ClassVar[Mapping[str, Any]] = MappingProxyType({})
    """The options of the environment."""
    metric: ClassVar[str]
    """The metric that is graded, a key of `swarm_envs.agents.evaluation.score_episodes`."""
    zero: ClassVar[float]
    """The value of the metric that is worth 0 points."""
    full: ClassVar[float]
    """The value of the metric that is worth 100 points."""
    counted: ClassVar[str] = "without a crash"
    """A description of the episodes for which `counts` returns True, as "share of episodes ..."."""
    rate: ClassVar[int] = 0
    """The lowest rate at which errors are evaluated, Hz; 0 for the submission's decision rate."""
    train_s: ClassVar[float] = 0.0
    """The duration of the submission's `train`, s; 0 for no training."""

    def check(self) -> None:
        """Check the assignment itself.

        Raises:
            ValueError: an attribute is missing or invalid, or an option of the environment.
            TypeError: an option of the environment does not exist.
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
            raise ValueError(f"zero and full are both {self.zero:g}, but must differ")
        make(self.task, **{**self.options, "physics": "batch"}).close()

    def counts(self, metrics: Mapping[str, Any]) -> bool:
        """Return True if an episode counts; points are multiplied by the share of these."""
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
        rule = f"{self.metric}: {self.zero:g} gives 0 points, {self.full:g} gives 100"
        return f"{rule}, times the share of episodes {self.counted}" if self.counted else rule

    @property
    def summary(self) -> str:
        """The first line of the docstring."""
        return (inspect.getdoc(type(self)) or "").partition("\n")[0].rstrip(".")

    def grade(self, entry: Entry) -> dict[str, Any]:
        """Return the scores of a submission, the share of episodes `counted`, and `copied`.

        `copied` is the name of the copied agent, or "".

        Raises:
            WorkFailed: the submission failed.
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
        copied = copied or harmless(copied_acts, env, agent.decisions)
        counted = sum(self.counts(episode["metrics"]) for episode in episodes) / len(episodes)
        found = {**score_episodes(episodes), "counted": counted}
        return {**found, "copied": copied, "failure": failure}

    def _check_cpu(self, work: RemoteWork, episodes: int) -> None:
        """Raise WorkFailed if a learner used too much CPU time, such as outside `train`."""
        most = 1.5 * self.train_s + _SETUP_S + _EPISODE_S * episodes
        if self.train_s and (spent := work.process.cpu_s()) > most:
            raise WorkFailed(f"used {spent:.0f} s of CPU time, but may use at most {most:.0f} s")


def _keep_code(entry: Entry) -> None:
    """Reduce a learner to its code without comments and docstrings, so that it brings no weights.

    Raises:
        WorkFailed: it is no Python file, or its code, constants or names are too long.
        SyntaxError: it is not valid Python.
    """
    path = path_of(entry.work)
    if path.suffix != ".py":
        raise WorkFailed("the submission must be a class in a Python file, so that it can learn")
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
                f"its {what} {size} characters, but may have at most {most}; learn parameters in "
                "train() instead"
            )
    (entry.home / path).write_text(source, encoding="utf-8")


def _is_text(line: ast.stmt) -> bool:
    """Return True if a statement is a docstring or another constant."""
    return isinstance(line, ast.Expr) and isinstance(line.value, ast.Constant)


def load_assignment(name: str) -> Assignment:
    """Return an included assignment, or the one that a file defines.

    Raises:
        ValueError: no assignment has this name, or the file does not define exactly one.
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
