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
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase
from functools import cache
from types import MappingProxyType
from typing import Any, Literal

from swarm_envs.errors import unknown_name
from swarm_envs.training.scoreboard.board import TaskInfo
from swarm_envs.vehicles import parse_team

__all__ = ["COMMON", "SEED", "TASKS", "choose_tasks", "digest"]

SEED = 2026
"""What the frozen seeds are drawn from, for every task and agent: one on which nothing that ships
was trained, tuned or chosen."""
COMMON: Mapping[str, Any] = MappingProxyType(
    {"physics": "batch", "interactions": "learned", "force_rate": 240}
)
"""Options of every task's environments."""

Score = Literal["time", "shapes", "tracking"]
"""What an episode's score says: see `swarm_envs.training.scoreboard.metrics`."""


@dataclass(frozen=True, kw_only=True)
class ScoredTask(TaskInfo):
    """A row of the table; its options are those beside `COMMON`, ready for JSON.

    Slow agents fly the first so many of its episodes.
    """

    environment: str
    """First argument of `swarm_envs.make`."""
    score: Score
    """What an episode is scored by."""
    clock_s: float
    """How long an episode lasts at most, s."""

    @property
    def drones(self) -> int:
        """How many fly."""
        team = self.options.get("team")
        return int(self.options["num_drones"]) if team is None else len(parse_team(team))

    def changed(self, options: Mapping[str, Any]) -> ScoredTask:
        """The task with other options, under an id of its own, since scores do not compare."""
        if not options:
            return self
        new = json.dumps(options, sort_keys=True)
        kept = {k: v for k, v in self.options.items() if "team" not in options or k != "num_drones"}
        return replace(
            self,
            id=f"{self.id}-{hashlib.sha256(new.encode()).hexdigest()[:8]}",
            label=", ".join([self.label, *(f"{name} {value}" for name, value in options.items())]),
            options={**kept, **options},
        )

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
        "force_model": _force_model("learned-v0"),  # what `_v0` calls learned
        "seed": SEED,
        "score": task.score,
    }


def digest(task: ScoredTask) -> str:
    """SHA-256 of a task's definition: 16 of its digits."""
    content = json.dumps(definition(task), sort_keys=True)
    return hashlib.sha256(content.encode()).hexdigest()[:16]


@cache
def _force_model(name: str) -> str:
    from swarm_envs.baselines.neural_swarm.flights import describe_model
    from swarm_envs.interactions import load

    return describe_model(load(name))["sha256"]


_KINDS: Mapping[str, tuple[Score, float, int]] = MappingProxyType(
    {
        "swap": ("time", 8.0, 256),
        "ring": ("tracking", 12.0, 128),
        "formation tour": ("shapes", 24.0, 64),
        "formation shuffle": ("shapes", 8.0, 128),
    }
)
"""Score, clock in seconds, and episodes."""


def _task(
    family: str, layout: str | None, size: int | str, help_: str, team: str | None = None
) -> ScoredTask:
    """A task of so many small drones, or of a team, which is said in words too."""
    score, clock_s, episodes = _KINDS.get(family) or _KINDS[f"{family} {layout}"]
    options = {"layout": layout} if layout else {}
    about = filter(None, (family, layout, team or f"{size} drones"))
    return ScoredTask(
        id="-".join(filter(None, (family, layout, f"{size}-v1"))),
        task=family,
        environment=f"{family}_v0",
        options={**options, "num_drones" if isinstance(size, int) else "team": size},
        label=", ".join(about),
        help=help_,
        score=score,
        clock_s=clock_s,
        episodes=episodes,
    )


_RANDOM = "Starts anywhere at least 0.5 m apart; each drone's goal is another's start."
_CIRCLE = "Antipodal goals on a level circle: every way crosses the centre."
_TOUR = "Plane, pyramid, cube, sphere and plane again, each drone to the place nearest to it."
_SHUFFLE = "From a plane into a cube, places drawn: ways cross, above and below others."

_TABLE = (
    _task("swap", "random", 2, _RANDOM),
    _task("swap", "random", 4, _RANDOM),
    _task(
        "swap",
        "random",
        "SSLL",
        f"{_RANDOM} Two small drones and two large ones.",
        "2 small + 2 large",
    ),
    _task("swap", "random", 8, _RANDOM),
    _task("swap", "random", 16, _RANDOM),
    _task("swap", "circle", 2, "Two drones change places head on."),
    _task("swap", "circle", 4, _CIRCLE),
    _task("swap", "circle", 8, _CIRCLE),
    _task("swap", "circle", 16, _CIRCLE),
    _task(
        "swap",
        "stacked",
        "L2S",
        "A small drone passes right below a large one.",
        "large above small",
    ),
    _task("swap", "stacked", 4, "Four planes of one small drone each, aligned half way."),
    _task("ring", None, 4, "Two small drones on an upright circle, two on a level one."),
    _task("ring", None, 5, "The paper's: three strong small drones upright, two large ones level."),
    _task("ring", None, 8, "Eight small drones: five upright, three level."),
    _task("ring", None, 16, "The paper's sixteen: three rings, three vehicle types."),
    _task("formation", "tour", 8, _TOUR),
    _task("formation", "tour", 16, _TOUR),
    _task("formation", "shuffle", 8, _SHUFFLE),
    _task("formation", "shuffle", 16, _SHUFFLE),
)

TASKS: Mapping[str, ScoredTask] = MappingProxyType({task.id: task for task in _TABLE})
"""Every task by its id, in the order in which they are shown."""


def choose_tasks(
    patterns: Sequence[str], options: Mapping[str, Any] = MappingProxyType({})
) -> list[ScoredTask]:
    """The tasks whose ids match any of the patterns, in the table's order.

    Args:
        patterns: ids, or such as `swap-*` (`*`, `?`, `[...]` as in file names).
        options: of the environment, to be changed in each.

    Raises:
        ValueError: a pattern matches none; the message names the nearest id.
    """
    if not patterns:
        raise ValueError("no task is named; '*' names all")
    for pattern in patterns:
        if not any(fnmatchcase(name, pattern) for name in TASKS):
            raise ValueError(unknown_name("task", pattern, TASKS, "of the benchmark"))
    chosen = [t for t in _TABLE if any(fnmatchcase(t.id, pattern) for pattern in patterns)]
    return [task.changed(options) for task in chosen]


choose = choose_tasks
"""Its name in 0.1.0."""
