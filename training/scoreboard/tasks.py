"""The definition of the benchmark's tasks.

The families are: *classic*, swaps, rings and formations with time limits long enough for planners;
*air*, tasks in which downwash matters most; *crowd*, more drones, and goals that change or move;
*robust*, other worlds, vehicles and engines; *transfer*, force models with which no included agent
was trained. To add a task, add a row and its digest (`tests/training/scoreboard`).

An id permanently identifies a definition: the task's version, every option, the digest of the force
model's weights, the seeds and the score. If any of these changes, the row gets a new version
(`swap-circle-4-v3`). A test compares the digest of each definition.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from fnmatch import fnmatchcase
from functools import cache
from types import MappingProxyType
from typing import Any, Literal

from swarm_envs import make
from swarm_envs.envs.parallel import SwarmParallelEnv
from swarm_envs.envs.randomization import Randomization
from swarm_envs.errors import unknown_name
from swarm_envs.hall import Hall
from swarm_envs.vehicles import parse_team

__all__ = ["SEED", "TASKS", "choose_tasks", "digest", "make_scored"]

SEED = 2026
"""Seed from which those of the episodes are drawn, for every task and agent. No included agent was
trained, tuned or selected on it."""
COMMON: Mapping[str, Any] = MappingProxyType(
    {"physics": "batch", "interactions": "learned", "force_rate": 240}
)
"""Options of every task's environments."""

Score = Literal["time", "shapes", "tracking", "own"]
"""Kinds of scores; see `swarm_envs.training.scoreboard.metrics`."""


@dataclass(frozen=True, kw_only=True)
class ScoredTask:
    """A task of the benchmark; its options are those besides `COMMON`, ready for JSON."""

    id: str
    """The id, such as `swap-circle-4-v2`; another definition has another version."""
    family: str
    """The family, such as `classic` or `air`."""
    environment: str
    """The first argument of `swarm_envs.make`."""
    options: Mapping[str, Any]
    """The options of the environment besides those that an agent requires."""
    episodes: int
    """The number of episodes of each agent; slow agents are evaluated on fewer."""
    score: Score
    """The kind of score of an episode."""
    full_score: tuple[str, float] | None = None
    """For the score `own`: the metric, and its value that counts as 1."""
    certificate: str
    """An agent that succeeds in at least 95 % of the episodes, as a proof that the task can be
    solved; `NAME@SECONDS` with a time limit of so many seconds."""

    @property
    def drones(self) -> int:
        """The number of drones."""
        team = self.options.get("team")
        return int(self.options["num_drones"]) if team is None else len(parse_team(team))

    @property
    def setting(self) -> dict[str, Any]:
        """All options of its environments besides those that an agent requires."""
        return {**self.options, **{k: v for k, v in COMMON.items() if k not in self.options}}


def definition(task: ScoredTask) -> dict[str, Any]:
    """Return the definition of a task, ready for JSON.

    The number of episodes is not part of it, because fewer seeds are the first of more.
    """
    setting = task.setting
    world = Hall.of(setting.get("world", "ideal"))
    return {
        "environment": task.environment,
        "setting": setting,
        "force_model": _force_model(setting["interactions"]),
        "seed": SEED,
        "score": task.score,
        **({} if world is None else {"world": asdict(world)}),
        **({"full_score": task.full_score} if task.full_score else {}),
    }


def make_scored(environment: str, setting: Mapping[str, Any]) -> SwarmParallelEnv:
    """Return the environment of a setting that is ready for JSON, from `swarm_envs.make`."""
    options = dict(setting)
    if isinstance(options.get("randomization"), Mapping):
        options["randomization"] = Randomization(**options["randomization"])
    return make(environment, **options)


def digest(task: ScoredTask) -> str:
    """Return the first 16 digits of the SHA-256 of a task's definition."""
    content = json.dumps(definition(task), sort_keys=True)
    return hashlib.sha256(content.encode()).hexdigest()[:16]


@cache
def _force_model(name: str) -> str:
    from swarm_envs.baselines.neural_swarm.flights import describe_model
    from swarm_envs.interactions import load

    return describe_model(load(name))["sha256"]


_DETOUR, _ROUND, _TRACKING = "detour+compensated", "roundabout", "tracking+compensated"
_ADAPTIVE = "tracking+compensated+adaptive"
_AWARE, _TOP, _LINE = "downwash-aware", "heavy-on-top", "fast-line"

_KINDS: Mapping[str, tuple[Score, int]] = MappingProxyType(
    {
        "swap": ("time", 256),
        "ring": ("tracking", 128),
        "formation tour": ("shapes", 64),
        "formation shuffle": ("time", 128),
    }
)
"""Score and episodes."""
_LONG_S = 12.0  # Time limit of swaps of 16 drones and more, long enough for planners, s


def _classic(name: str, layout: str | None, size: int | str) -> ScoredTask:
    """Return a swap, ring or formation of `size` small drones, or of a team."""
    score, episodes = _KINDS.get(name) or _KINDS[f"{name} {layout}"]
    options: dict[str, Any] = {"layout": layout} if layout else {}
    options["num_drones" if isinstance(size, int) else "team"] = size
    if name == "swap" and isinstance(size, int) and size >= 16:
        options["horizon_s"] = _LONG_S
    return ScoredTask(
        id="-".join(filter(None, (name, layout, f"{size}-v2"))),
        family="classic",
        environment=f"{name}_v1",
        options=options,
        score=score,
        certificate=_DETOUR,
        episodes=episodes,
    )


_CLASSIC_ROWS = (
    # Random starts at least 0.5 m apart; each drone's goal is another's start.
    _classic("swap", "random", 2),
    _classic("swap", "random", 4),
    _classic("swap", "random", "SSLL"),
    _classic("swap", "random", 8),
    _classic("swap", "random", 16),
    # Antipodal goals on a horizontal circle: all paths cross the center.
    _classic("swap", "circle", 2),
    _classic("swap", "circle", 4),
    _classic("swap", "circle", 8),
    _classic("swap", "circle", 16),
    # A small drone passes directly below a large one; four drones in four planes, aligned half way.
    _classic("swap", "stacked", "L2S"),
    _classic("swap", "stacked", 4),
    # Vertical and horizontal circles; the paper's are those of 5 (two types) and 16 (three).
    _classic("ring", None, 4),
    _classic("ring", None, 5),
    _classic("ring", None, 8),
    _classic("ring", None, 16),
    # Plane, pyramid, cube, sphere and plane again; each drone flies to the nearest goal.
    _classic("formation", "tour", 8),
    _classic("formation", "tour", 16),
    # From a plane to a cube with random goals: paths cross above and below others.
    _classic("formation", "shuffle", 8),
    _classic("formation", "shuffle", 16),
)


def _new(name: str, base: str, certificate: str, episodes: int, **options: Any) -> ScoredTask:
    """Return a classic task with other options.

    Args:
        name: the id without its version; its first word is the family.
        base: the id of the classic task without its version.
        certificate: see `ScoredTask`.
        episodes: the number of episodes of each agent.
        **options: the options that differ.
    """
    other = _CLASSIC[f"{base}-v2"]
    team = {"num_drones", "team"} & set(options)
    kept = {k: v for k, v in other.options.items() if not team or k not in ("num_drones", "team")}
    return replace(
        other,
        id=f"{name}-v2",
        family=name.partition("-")[0],
        options={**kept, **options},
        certificate=certificate,
        episodes=episodes,
    )


def _of_own(
    name: str,
    environment: str,
    certificate: str,
    episodes: int,
    version: int = 2,
    **options: Any,
) -> ScoredTask:
    """Return a task of another environment than the classic ones; see `_new`."""
    score, full_score = _SCORES[environment]
    return ScoredTask(
        id=f"{name}-v{version}",
        family=name.partition("-")[0],
        environment=environment,
        options={**options, **({"world": "hall"} if name.startswith("air") else {})},
        score=score,
        full_score=full_score,
        certificate=certificate,
        episodes=episodes,
    )


_SCORES: Mapping[str, tuple[Score, tuple[str, float] | None]] = MappingProxyType(
    {
        "columns_v0": ("time", None),
        "delivery_v0": ("time", None),
        "gates_v0": ("own", ("gates_per_min", 80.0)),
        "crowd_v0": ("own", ("throughput_per_min", 40.0)),
        "pursuit_v0": ("own", ("share_on_goal", 1.0)),
    }
)
"""Score and full score."""

_CLASSIC = {task.id: task for task in _CLASSIC_ROWS}
_NOISE = {
    "mass": (0.95, 1.05),
    "thrust": (0.9, 1.1),
    "motor_rate": (0.8, 1.2),
    "position_noise_m": 0.08,
    "velocity_noise": 0.3,
}

_NEW = (
    # Two columns of small drones, half with a payload, or of a large drone and two small ones.
    _of_own("air-stack-8", "columns_v0", _TOP, 128, 3, layout="stack", num_drones=8,
            gap_m=[0.28, 0.33], payload_kg=[0.013, 0.016]),
    _of_own("air-mixed-6", "columns_v0", _TOP, 128, 3, layout="stack", team="LSSLSS",
            gap_m=[0.30, 0.36], payload_kg=[0.013, 0.016]),
    # Two columns of large drones and a small one, in at most 2 s, with errors below 3 cm.
    _of_own("air-sprint-8", "columns_v0", f"{_AWARE}@2", 128, 3, layout="sprint",
            num_drones=8, horizon_s=1.8),
    # Drones deliver to docks above the floor, two of three below other drones.
    _of_own("air-delivery-7", "delivery_v0", "pid+adaptive", 128, num_drones=7),
    # A slalom in a vertical formation, in 12 s.
    _of_own("air-gates-4", "gates_v0", _AWARE, 64, num_drones=4, horizon_s=12.0),
    # A drone that reaches its goal gets another, 1 to 3 m away; in the forest between trees.
    _of_own("crowd-open-64", "crowd_v0", _ROUND, 16, layout="open", num_drones=64),
    _of_own("crowd-forest-16", "crowd_v0", _LINE, 64, layout="forest", num_drones=16),
    _of_own("crowd-forest-64", "crowd_v0", _LINE, 16, layout="forest", num_drones=64),
    # A drone that reaches its goal gets another, 0.8 to 1.6 m away, between towers.
    _of_own("crowd-buildings-32", "crowd_v0", _LINE, 32, layout="buildings", num_drones=32,
            reach_m=[0.8, 1.6]),
    # Goals in a moving formation; goals exchanged every 5 s; goals beside other drones.
    _of_own("crowd-moving-8", "pursuit_v0", _TRACKING, 64, layout="moving", num_drones=8),
    _of_own("crowd-swaps-8", "pursuit_v0", _ROUND, 64, layout="swap-goals", num_drones=8),
    _of_own("crowd-chase-8", "pursuit_v0", "pid", 64, layout="chase", num_drones=8),
    _new("crowd-random-32", "swap-random-16", _ROUND, 64, num_drones=32),
    _new("crowd-random-64", "swap-random-16", _DETOUR, 32, num_drones=64),
    _new("crowd-circle-32", "swap-circle-16", _DETOUR, 32, num_drones=32, horizon_s=16.0),
    # Random forces, and an estimate of the state.
    _new("robust-random-8-hall", "swap-random-8", _ROUND, 128, world="hall"),
    _new("robust-ring-5-hall", "ring-5", _ADAPTIVE, 64, world="hall"),
    _new("robust-ring-16-hall", "ring-16", _ADAPTIVE, 64, world="hall"),
    _new("robust-shuffle-8-hall", "formation-shuffle-8", _ROUND, 64, world="hall"),
    # Random mass, thrust and motor rate; observation noise as of radio ranging.
    _new("robust-random-8-noise", "swap-random-8", _DETOUR, 128, randomization=_NOISE),
    _new("robust-circle-8-noise", "swap-circle-8", _DETOUR, 128, randomization=_NOISE),
    _new("robust-random-LLLLSSSS", "swap-random-8", _ROUND, 128, team="LLLLSSSS"),
    # On Bullet, with contact forces between drones.
    _new("robust-random-4-bullet", "swap-random-4", _ROUND, 32, physics="bullet"),
    # Force models with which no included agent was trained.
    _new("transfer-random-8-none", "swap-random-8", _ROUND, 128, interactions="none"),
    _new("transfer-random-8-wake", "swap-random-8", _ROUND, 128, interactions="wake"),
    _new("transfer-stacked-L2S-wake", "swap-stacked-L2S", _TRACKING, 128, interactions="wake"),
    _new("transfer-ring-5-wake", "ring-5", _TRACKING, 64, interactions="wake"),
)  # fmt: skip

TASKS: Mapping[str, ScoredTask] = MappingProxyType(
    {task.id: task for task in (*_CLASSIC_ROWS, *_NEW)}
)
"""All tasks by id, in the order of tables."""


def choose_tasks(patterns: Sequence[str]) -> list[ScoredTask]:
    """Return the tasks whose ids match any of the patterns, in the table's order.

    Args:
        patterns: ids, or patterns such as `swap-*` (`*`, `?`, `[...]` as in file names).

    Raises:
        ValueError: a pattern matches none; the message names the most similar id.
    """
    if not patterns:
        raise ValueError("--task is empty; '*' stands for all tasks")
    for pattern in patterns:
        if not any(fnmatchcase(name, pattern) for name in TASKS):
            raise ValueError(unknown_name("task", pattern, TASKS, "of the benchmark"))
    return [
        task
        for task in TASKS.values()
        if any(fnmatchcase(task.id, pattern) for pattern in patterns)
    ]
