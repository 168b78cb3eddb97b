"""What the scoreboard's page is made of: agents on tasks, and what they add up to."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

Interval = tuple[float, float]


@dataclass(frozen=True)
class Metric:
    """One thing that is measured."""

    name: str
    """In the files, with its unit."""
    label: str
    """For people."""
    unit: str
    """`%` for fractions in [0, 1]; empty for counts."""
    better: Literal["higher", "lower", "neither"]
    """Which values are."""
    help: str
    """What it means, in a sentence."""


@dataclass(frozen=True)
class Task:
    """One thing that is flown: a versioned setting of a task."""

    id: str
    """Such as `swap-circle-4-v1`; another meaning has another version."""
    family: str
    """The task: `swap`, `ring`, `formation`."""
    label: str
    """For people."""
    environment: str
    """First argument of `swarm_envs.make`."""
    options: Mapping[str, Any]
    """The others, beside what an agent requires."""
    episodes: int
    """Of each agent."""
    help: str
    """What it is, in a sentence."""


@dataclass(frozen=True)
class Entry:
    """An agent."""

    name: str
    """As of `swarm_envs.agents.load`."""
    label: str
    """For people."""
    privileged: bool
    """Whether it sees the true state."""
    help: str
    """What it is, in a sentence."""


@dataclass(frozen=True)
class Value:
    """A number with its 95 % interval."""

    value: float | None
    """None where no episode has one."""
    interval: Interval | None
    """Its ends."""


@dataclass(frozen=True)
class Replay:
    """The episode of a cell that can be looked at."""

    seed: int
    """Of the episode."""
    episode: int
    """Its index among the cell's."""
    file: str
    """The page, from the scoreboard's folder."""
    why: str
    """Why this one was chosen."""
    success: bool | None
    """How it ended when it was scored, if that is known."""


@dataclass(frozen=True)
class Cell:
    """An agent on a task."""

    task: str
    """The id."""
    agent: str
    """The name."""
    status: Literal["flown", "failed", "unsupported"]
    """Only what was flown has values."""
    reason: str
    """Why it has none, or not of all episodes; may be empty."""
    episodes: int
    """That were flown."""
    values: Mapping[str, Value]
    """By metric."""
    replay: Replay | None
    """None unless one was chosen."""


@dataclass(frozen=True)
class Standing:
    """An agent's place in a family: the interquartile mean of a score in [0, 1]."""

    value: float
    """The score."""
    interval: Interval | None
    """Its 95 % interval."""
    metric: str
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

    label: str
    """Of the score."""
    thresholds: tuple[float, ...]
    """Increasing."""
    curves: Mapping[str, Curve]
    """By agent."""


@dataclass(frozen=True)
class Board:
    """Everything."""

    manifest: Mapping[str, Any]
    """What was run where."""
    metrics: tuple[Metric, ...]
    """In the order of the page."""
    tasks: tuple[Task, ...]
    """In the order of the page."""
    agents: tuple[Entry, ...]
    """In the order of the page."""
    cells: Mapping[tuple[str, str], Cell]
    """By task and agent."""
    standings: Mapping[str, Mapping[str, Standing]]
    """By family and agent."""
    profiles: Mapping[str, Profile]
    """By family."""

    @property
    def families(self) -> list[str]:
        """The tasks without their settings, in the order of the page."""
        return list(dict.fromkeys(task.family for task in self.tasks))
