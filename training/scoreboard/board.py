"""`scores.json` as the report reads it: agents on tasks, and what they add up to.

The classes are the file's parts, a field for each key. `read` checks a file against them: what is
missing or of a wrong kind is named by its place.
"""

from __future__ import annotations

import json
import math
import re
from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from dataclasses import MISSING, dataclass, fields, is_dataclass, replace
from functools import cached_property
from pathlib import Path
from types import UnionType
from typing import Any, Literal, NoReturn, get_args, get_origin, get_type_hints

__all__ = ["FILE", "read"]

FILE = "scores.json"
"""Its name in a scoreboard's folder."""
FORMAT, VERSION = "swarm-envs scoreboard", 1
"""What the file says that it is."""
Interval = tuple[float, float]
_REPLAY = re.compile(r"replays/[A-Za-z0-9][A-Za-z0-9._+-]*\.html")


@dataclass(frozen=True)
class Metric:
    """One thing that is measured, with a label for people, and what it means, in a sentence."""

    name: str
    """In the files, with its unit."""
    label: str
    unit: str
    """`%` for fractions in [0, 1]; empty for counts."""
    better: Literal["higher", "lower", "neither"]
    """Which values are."""
    help: str


@dataclass(frozen=True)
class TaskInfo:
    """One thing that is flown, a versioned setting of a task; label and help are for people."""

    id: str
    """Such as `swap-circle-4-v1`; another meaning has another version."""
    task: str
    """Its family: `swap`, `ring`, `formation`."""
    label: str
    options: Mapping[str, Any]
    """Of `swarm_envs.make`, beside what an agent requires."""
    episodes: int
    """Of each agent."""
    environment: str | None = None
    """First argument of `swarm_envs.make`; the first version of the task where there is none."""
    help: str = ""


@dataclass(frozen=True)
class AgentInfo:
    """An agent, and what it is, in a sentence."""

    name: str
    """As of `swarm_envs.agents.load`."""
    privileged: bool
    """Whether it sees the true state."""
    label: str = ""
    """For people; its name where there is none."""
    help: str = ""


@dataclass(frozen=True)
class Estimate:
    """A number with its 95 % interval."""

    value: float | None
    """None where no episode has one."""
    interval: Interval | None = None
    """Its ends."""


@dataclass(frozen=True)
class ReplayChoice:
    """The episode of a cell that can be looked at."""

    seed: int
    """Of the episode."""
    file: str
    """The page, from the scoreboard's folder."""
    episode: int = 0
    """Its index among the cell's."""
    why: str = ""
    """Why this one was chosen."""
    success: bool | None = None
    """How it ended when it was scored, if that is known."""


@dataclass(frozen=True)
class CellResult:
    """An agent on a task."""

    task: str
    """The id."""
    agent: str
    """The name."""
    status: Literal["flown", "failed", "unsupported"]
    """Only what was flown has values."""
    values: Mapping[str, Estimate]
    """By metric."""
    reason: str = ""
    """Why it has none, or not of all episodes; may be empty."""
    episodes: int = 0
    """That were flown."""
    replay: ReplayChoice | None = None
    """None unless one was chosen."""


@dataclass(frozen=True)
class Standing:
    """An agent's place in a family: the interquartile mean of a score in [0, 1]."""

    value: float
    """The score."""
    interval: Interval | None = None
    """Its 95 % interval."""
    metric: str = "score"
    """What the score is made of."""


@dataclass(frozen=True)
class Curve:
    """Of each threshold, the fraction of an agent's runs that reach it, and the interval's ends."""

    fraction: tuple[float, ...]
    """One a threshold."""
    low: tuple[float, ...]
    """One a threshold."""
    high: tuple[float, ...]
    """One a threshold."""


@dataclass(frozen=True)
class Profile:
    """Performance profiles of a family."""

    thresholds: tuple[float, ...]
    """Increasing."""
    agents: Mapping[str, Curve]
    """By name."""
    label: str = "score"
    """Of the score."""


@dataclass(frozen=True)
class Board:
    """The whole file; metrics, tasks and agents in the order of the page."""

    manifest: Mapping[str, Any]
    """What was run where."""
    metrics: tuple[Metric, ...]
    """What is measured."""
    tasks: tuple[TaskInfo, ...]
    """What is flown."""
    agents: tuple[AgentInfo, ...]
    """Who flies."""
    cells: tuple[CellResult, ...]
    """Each agent on each task."""
    aggregates: Mapping[str, Mapping[str, Standing]]
    """By family and agent."""
    profiles: Mapping[str, Profile]
    """By family."""

    @property
    def families(self) -> list[str]:
        """The tasks without their settings."""
        return list(dict.fromkeys(task.task for task in self.tasks))

    @cached_property
    def pairs(self) -> Mapping[tuple[str, str], CellResult]:
        """The cells by task and agent."""
        return {(cell.task, cell.agent): cell for cell in self.cells}

    def ranked(self, family: str) -> list[str]:
        """A family's agents, the best first."""
        standings = self.aggregates.get(family, {})
        return sorted(standings, key=lambda name: -standings[name].value)


def read(folder: Path) -> Board:
    """Read a scoreboard's folder.

    Raises:
        FileNotFoundError: it holds no `scores.json`.
        ValueError: the file is of another format or version, or a part of it is not what it must
            be; the message names the part.
    """
    file = folder / FILE
    if not file.is_file():
        raise FileNotFoundError(
            f"there is no {FILE} in {str(folder)!r}; `swarm-envs benchmark --out {folder}` makes it"
        )
    try:
        content = json.loads(file.read_text(encoding="utf-8"), parse_constant=_refuse_constant)
        return _board(content)
    except ValueError as error:
        raise ValueError(
            f"{str(file)!r} cannot be shown: {error}; write it anew with `swarm-envs benchmark`"
        ) from error


def _refuse_constant(constant: str) -> NoReturn:
    raise ValueError(f"it holds {constant}, which is no number; null says that there is none")


def _board(content: object) -> Board:
    if not isinstance(content, dict):
        raise ValueError(f"it holds {content!r:.80}, but must hold an object")
    for key, wanted in (("format", FORMAT), ("version", VERSION)):
        if key not in content:
            raise ValueError(f"{key} is missing")
        if content[key] != wanted:
            raise ValueError(f"its {key} is {content[key]!r}, but this package reads {wanted!r}")
    board: Board = _read(Board, content, "")
    _check_names(board)
    _check_values(board)
    return replace(
        board,
        metrics=tuple(replace(m, label=m.label[:1].upper() + m.label[1:]) for m in board.metrics),
        tasks=tuple(replace(t, environment=t.environment or f"{t.task}_v0") for t in board.tasks),
        agents=tuple(replace(agent, label=agent.label or agent.name) for agent in board.agents),
        cells=tuple(c if c.status == "flown" else replace(c, replay=None) for c in board.cells),
    )


def _read(kind: Any, value: Any, where: str) -> Any:
    origin, inner = get_origin(kind), get_args(kind)
    if kind is Any:
        return value
    if origin is UnionType:  # with None, which the file calls null
        return None if value is None else _read(inner[0], value, where)
    if is_dataclass(kind) or origin is Mapping:
        if not isinstance(value, dict):
            _refuse(where, value, "an object")
        if origin is Mapping:
            return {key: _read(inner[1], each, f"{where}.{key}") for key, each in value.items()}
        return _read_fields(kind, value, where)
    if origin is tuple:
        return _read_list(inner, value, where)
    if origin is Literal:
        _check_one_of(inner, _read(str, value, where), where)
        return value
    fits, rule = _PLAIN[kind]
    if not fits(value):
        _refuse(where, value, rule)
    if kind is float and not math.isfinite(value):
        _refuse(where, value, "finite")
    return kind(value)


_PLAIN: Mapping[Any, Any] = {
    str: (lambda value: isinstance(value, str), "a string"),
    bool: (lambda value: isinstance(value, bool), "true or false"),
    int: (lambda v: type(v) is int and v >= 0, "a whole number, 0 or more"),
    float: (lambda value: type(value) in (int, float), "a number"),
}
"""What a value of a plain kind must be, as a test and in words."""


def _read_fields(kind: Any, content: Mapping[str, Any], where: str) -> Any:
    """An object of a class: null counts as missing where the class has a default."""
    hints, found = get_type_hints(kind), {}
    for field in fields(kind):
        place = f"{where}.{field.name}".lstrip(".")
        must = field.default is MISSING
        if field.name in content and (must or content[field.name] is not None):
            found[field.name] = _read(hints[field.name], content[field.name], place)
        elif must:
            raise ValueError(f"{place} is missing")
    return kind(**found)


def _read_list(inner: Sequence[Any], value: Any, where: str) -> tuple[Any, ...]:
    """A list: of any length of one kind, or the two ends of an interval."""
    of = "" if inner[-1] is Ellipsis else f" of {len(inner)}"
    of_objects = is_dataclass(inner[0])
    whole = isinstance(value, list) and (not of or len(value) == len(inner))
    if not whole or (of_objects and not all(isinstance(each, dict) for each in value)):
        _refuse(where, value, f"a list{of} of {'objects' if of_objects else 'numbers'}")
    places = [f"{where}[{k}]" if of_objects else where for k in range(len(value))]
    found = tuple(_read(inner[0], each, place) for each, place in zip(value, places, strict=True))
    if of and found[0] > found[1]:
        _refuse(where, value, "two numbers in order")
    return found


def _check_names(board: Board) -> None:
    tasks = [task.id for task in board.tasks]
    agents = [agent.name for agent in board.agents]
    metrics = [metric.name for metric in board.metrics]
    pairs = [(cell.task, cell.agent) for cell in board.cells]
    listed: dict[str, list[Any]] = {"metrics": metrics, "tasks": tasks, "agents": agents}
    for what, names in {**listed, "cells": pairs}.items():
        twice = [name for name, count in Counter(names).items() if count > 1]
        if twice:
            raise ValueError(f"{what} has {twice[0]!r} twice")
    for k, cell in enumerate(board.cells):
        _check_one_of(tasks, cell.task, f"cells[{k}].task")
        _check_one_of(agents, cell.agent, f"cells[{k}].agent")
        _check_listed(cell.values, metrics, f"cells[{k}].values")
    _check_listed(board.aggregates, board.families, "aggregates")
    _check_listed(board.profiles, board.families, "profiles")
    for family, standings in board.aggregates.items():
        _check_listed(standings, agents, f"aggregates.{family}")
    for family, profile in board.profiles.items():
        _check_listed(profile.agents, agents, f"profiles.{family}.agents")


def _check_values(board: Board) -> None:
    for k, cell in enumerate(board.cells):
        if cell.replay is not None and not _REPLAY.fullmatch(cell.replay.file):
            rule = "replays/NAME.html, of letters, digits, '.', '_', '+' and '-'"
            _refuse(f"cells[{k}].replay.file", cell.replay.file, rule)
    for family, standings in board.aggregates.items():
        for name, standing in standings.items():
            if not 0.0 <= standing.value <= 1.0:
                _refuse(f"aggregates.{family}.{name}.value", standing.value, "a score in [0, 1]")
    for family, profile in board.profiles.items():
        place, count = f"profiles.{family}", len(profile.thresholds)
        if count < 2 or list(profile.thresholds) != sorted(set(profile.thresholds)):
            raise ValueError(f"{place}.thresholds must be two or more, and increase")
        for name, curve in profile.agents.items():
            for key, values in vars(curve).items():
                if len(values) != count:
                    _refuse(f"{place}.agents.{name}.{key}", values, f"a list of {count} of numbers")


def _check_one_of(allowed: Collection[str], value: str, where: str) -> None:
    if value not in allowed:
        _refuse(where, value, f"one of {', '.join(sorted(allowed)):.200}")


def _check_listed(names: Collection[str], allowed: Collection[str], where: str) -> None:
    for name in names:
        if name not in allowed:
            raise ValueError(f"{where} names {name!r}, which the file does not list")


def _refuse(where: str, value: object, rule: str) -> NoReturn:
    raise ValueError(f"{where} is {value!r:.80}, but must be {rule}")
