"""The benchmark's tasks: this table is their definition.

An id names what is flown for good: the task's version, every option, the force model by the digest
of its weights, the seeds and the score. To change any of it is to make another benchmark, so the
row gets a new version (`swap-circle-4-v2`), and the old id is never used again. A test holds the
digest of each definition.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from functools import cache
from types import MappingProxyType
from typing import Any, Literal

from swarm_envs.errors import unknown_name
from swarm_envs.vehicles import parse_team

SEED = 2026
"""What the frozen seeds are drawn from, for every task and agent: one on which nothing that ships
was trained, tuned or chosen."""
COMMON: Mapping[str, Any] = MappingProxyType(
    {"physics": "batch", "interactions": "learned", "force_rate": 240}
)
"""Options of every task's environments."""

Score = Literal["time", "shapes", "tracking"]


@dataclass(frozen=True)
class ScoredTask:
    """A row of the table."""

    id: str
    """Such as `swap-circle-4-v1`."""
    environment: str
    """First argument of `swarm_envs.make`."""
    options: Mapping[str, Any]
    """Its options beside `COMMON`, ready for JSON."""
    label: str
    """For people."""
    help: str
    """What it asks for, in a sentence."""
    score: Score
    """What an episode's score in [0, 1] says: see `swarm_envs.training.scoreboard.metrics`."""
    clock_s: float
    """How long an episode lasts at most, s."""
    episodes: int
    """Of an agent that costs next to nothing; slow ones fly the first so many of these."""

    @property
    def family(self) -> str:
        """The task without its setting: `swap`, `ring` or `formation`."""
        return self.environment.rpartition("_v")[0]

    @property
    def drones(self) -> int:
        """How many fly."""
        team = self.options.get("team")
        return int(self.options["num_drones"]) if team is None else len(parse_team(team))

    @property
    def setting(self) -> dict[str, Any]:
        """Every option of its environments beside those that an agent requires."""
        return {**self.options, **COMMON}


def definition(task: ScoredTask) -> dict[str, Any]:
    """Everything that an id stands for, ready for JSON.

    How many episodes are flown is no part of it: fewer seeds are the first of more.
    """
    return {
        "environment": task.environment,
        "setting": task.setting,
        "force_model": _force_model(str(COMMON["interactions"])),
        "seed": SEED,
        "score": task.score,
    }


def digest(task: ScoredTask) -> str:
    """SHA-256 of a task's definition: 16 of its digits."""
    content = json.dumps(definition(task), sort_keys=True)
    return hashlib.sha256(content.encode()).hexdigest()[:16]


@cache
def _force_model(name: str) -> str:
    from swarm_envs.baselines.neural_swarm.summary import describe_model
    from swarm_envs.interactions import load

    return describe_model(load(name))["sha256"]


def _swap(layout: str, size: int | str, help_: str, about: str | None = None) -> ScoredTask:
    """A swap of so many small drones, or of a team."""
    who = {"num_drones": size} if isinstance(size, int) else {"team": size}
    return ScoredTask(
        id=f"swap-{layout}-{size}-v1",
        environment="swap_v0",
        options={"layout": layout, **who},
        label=f"swap, {layout}, {about or f'{size} drones'}",
        help=help_,
        score="time",
        clock_s=8.0,
        episodes=256,
    )


def _ring(size: int, help_: str) -> ScoredTask:
    return ScoredTask(
        id=f"ring-{size}-v1",
        environment="ring_v0",
        options={"num_drones": size},
        label=f"ring, {size} drones",
        help=help_,
        score="tracking",
        clock_s=12.0,
        episodes=128,
    )


def _formation(layout: str, size: int, clock_s: float, episodes: int, help_: str) -> ScoredTask:
    return ScoredTask(
        id=f"formation-{layout}-{size}-v1",
        environment="formation_v0",
        options={"layout": layout, "num_drones": size},
        label=f"formation, {layout}, {size} drones",
        help=help_,
        score="shapes",
        clock_s=clock_s,
        episodes=episodes,
    )


_RANDOM = "Starts anywhere at least 0.5 m apart; each drone's goal is another's start."
_CIRCLE = "Antipodal goals on a level circle: every way crosses the centre."
_TOUR = "Plane, pyramid, cube, sphere and plane again, each drone to the place nearest to it."
_SHUFFLE = "From a plane into a cube, places drawn: ways cross, above and below others."

_TABLE = (
    _swap("random", 2, _RANDOM),
    _swap("random", 4, _RANDOM),
    _swap("random", "SSLL", f"{_RANDOM} Two small drones and two large ones.", "2 small + 2 large"),
    _swap("random", 8, _RANDOM),
    _swap("random", 16, _RANDOM),
    _swap("circle", 2, "Two drones change places head on."),
    _swap("circle", 4, _CIRCLE),
    _swap("circle", 8, _CIRCLE),
    _swap("circle", 16, _CIRCLE),
    _swap("stacked", "L2S", "A small drone passes right below a large one.", "large above small"),
    _swap("stacked", 4, "Four planes of one small drone each, aligned half way."),
    _ring(4, "Two small drones on an upright circle, two on a level one."),
    _ring(5, "The paper's: three strong small drones upright, two large ones level."),
    _ring(8, "Eight small drones: five upright, three level."),
    _ring(16, "The paper's sixteen: three rings, three vehicle types."),
    _formation("tour", 8, 24.0, 64, _TOUR),
    _formation("tour", 16, 24.0, 64, _TOUR),
    _formation("shuffle", 8, 8.0, 128, _SHUFFLE),
    _formation("shuffle", 16, 8.0, 128, _SHUFFLE),
)

TASKS: Mapping[str, ScoredTask] = MappingProxyType({task.id: task for task in _TABLE})
"""Every task by its id, in the order in which they are shown."""


def choose_tasks(patterns: Sequence[str]) -> list[ScoredTask]:
    """The tasks whose ids match any of the patterns, in the table's order.

    Args:
        patterns: ids, or such as `swap-*` (`*`, `?`, `[...]` as in file names).

    Raises:
        ValueError: a pattern matches none; the message names the nearest id.
    """
    for pattern in patterns:
        if not any(fnmatchcase(name, pattern) for name in TASKS):
            raise ValueError(unknown_name("task", pattern, TASKS, "of the benchmark"))
    matched = [t for t in _TABLE if any(fnmatchcase(t.id, pattern) for pattern in patterns)]
    if not matched:
        raise ValueError("no task is named; '*' names all")
    return matched
