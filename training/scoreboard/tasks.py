"""The benchmark's tasks: these tables are their definition.

They come in families: *classic*, swaps, rings and formations, with clocks that are long enough for
planners; *air*, tasks in which downwash decides; *crowd*, more drones, goals that go on or move;
*robust*, other worlds, vehicles and engines; *transfer*, forces with which nothing that ships was
trained. To add a task, add a row and its digest (`tests/training/scoreboard`).

An id names what is flown for good: the task's version, every option, the force model by the digest
of its weights, the seeds and the score. A change of any of these makes another benchmark, so the
row gets a new version (`swap-circle-4-v3`). A test holds the digest of each definition.
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
"""What the frozen seeds are drawn from, for every task and agent: one on which nothing that ships
was trained, tuned or chosen."""
COMMON: Mapping[str, Any] = MappingProxyType(
    {"physics": "batch", "interactions": "learned", "force_rate": 240}
)
"""Options of every task's environments."""

Score = Literal["time", "shapes", "tracking", "own"]
"""What an episode's score says: see `swarm_envs.training.scoreboard.metrics`."""


@dataclass(frozen=True, kw_only=True)
class ScoredTask:
    """A row of the table; its options are those beside `COMMON`, ready for JSON."""

    id: str
    """Such as `swap-circle-4-v2`; another meaning has another version."""
    family: str
    """Such as `classic` or `air`."""
    environment: str
    """First argument of `swarm_envs.make`."""
    options: Mapping[str, Any]
    """Of the environment, beside what an agent requires."""
    episodes: int
    """Of each agent; slow agents fly the first of them."""
    score: Score
    """The measure that scores an episode."""
    clock_s: float
    """Longest duration of an episode, s."""
    full_score: tuple[str, float] | None = None
    """Where the score is `own`: the metric that is the task's own score, and what counts as 1."""
    certificate: str
    """Agent that succeeds in 95 % of the episodes or more: the task can be solved. With `@` and a
    number behind it, within a clock of so many seconds."""

    @property
    def drones(self) -> int:
        """How many fly."""
        team = self.options.get("team")
        return int(self.options["num_drones"]) if team is None else len(parse_team(team))

    @property
    def setting(self) -> dict[str, Any]:
        """Every option of its environments beside those that an agent requires."""
        return {**self.options, **{k: v for k, v in COMMON.items() if k not in self.options}}


def definition(task: ScoredTask) -> dict[str, Any]:
    """Everything that an id stands for, ready for JSON.

    How many episodes are flown is no part of it: fewer seeds are the first of more.
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
    """An environment of a setting that is ready for JSON, as `swarm_envs.make` makes it."""
    options = dict(setting)
    if isinstance(options.get("randomization"), Mapping):
        options["randomization"] = Randomization(**options["randomization"])
    return make(environment, **options)


def digest(task: ScoredTask) -> str:
    """SHA-256 of a task's definition: 16 of its digits."""
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

_KINDS: Mapping[str, tuple[Score, float, int]] = MappingProxyType(
    {
        "swap": ("time", 8.0, 256),
        "ring": ("tracking", 12.0, 128),
        "formation tour": ("shapes", 24.0, 64),
        "formation shuffle": ("time", 8.0, 128),
    }
)
"""Score, clock in seconds, and episodes."""
_LONG_S = 12.0  # The clock of swaps of 16 drones and more, in which planners arrive


def _classic(name: str, layout: str | None, size: int | str) -> ScoredTask:
    """Return a swap, ring or formation of `size` small drones, or of a team."""
    score, clock_s, episodes = _KINDS.get(name) or _KINDS[f"{name} {layout}"]
    options: dict[str, Any] = {"layout": layout} if layout else {}
    options["num_drones" if isinstance(size, int) else "team"] = size
    if name == "swap" and isinstance(size, int) and size >= 16:
        options["horizon_s"] = clock_s = _LONG_S
    return ScoredTask(
        id="-".join(filter(None, (name, layout, f"{size}-v2"))),
        family="classic",
        environment=f"{name}_v1",
        options=options,
        score=score,
        clock_s=clock_s,
        certificate=_DETOUR,
        episodes=episodes,
    )


_CLASSIC_ROWS = (
    # Starts anywhere at least 0.5 m apart; each drone's goal is another's start.
    _classic("swap", "random", 2),
    _classic("swap", "random", 4),
    _classic("swap", "random", "SSLL"),
    _classic("swap", "random", 8),
    _classic("swap", "random", 16),
    # Antipodal goals on a level circle: every way crosses the center.
    _classic("swap", "circle", 2),
    _classic("swap", "circle", 4),
    _classic("swap", "circle", 8),
    _classic("swap", "circle", 16),
    # A small drone passes right below a large one; four planes of one drone, aligned half way.
    _classic("swap", "stacked", "L2S"),
    _classic("swap", "stacked", 4),
    # Upright and level circles; the paper's are those of 5 (two types) and 16 (three).
    _classic("ring", None, 4),
    _classic("ring", None, 5),
    _classic("ring", None, 8),
    _classic("ring", None, 16),
    # Plane, pyramid, cube, sphere and plane again, each drone to the place nearest to it.
    _classic("formation", "tour", 8),
    _classic("formation", "tour", 16),
    # From a plane into a cube, places drawn: ways cross, above and below others.
    _classic("formation", "shuffle", 8),
    _classic("formation", "shuffle", 16),
)


def _new(name: str, base: str, certificate: str, episodes: int, **options: Any) -> ScoredTask:
    """A row that is a classic one with other options.

    Args:
        name: the id without its version; its first word is the family.
        base: id of the other, without its version.
        certificate: as of `ScoredTask`.
        episodes: of each agent.
        **options: what differs.
    """
    other = _CLASSIC[f"{base}-v2"]
    team = {"num_drones", "team"} & set(options)
    kept = {k: v for k, v in other.options.items() if not team or k not in ("num_drones", "team")}
    return replace(
        other,
        id=f"{name}-v2",
        family=name.partition("-")[0],
        options={**kept, **options},
        clock_s=options.get("horizon_s", other.clock_s),
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
    """A row of another environment than the classic ones; arguments as of `_new`."""
    score, clock_s, full_score = _SCORES[environment]
    return ScoredTask(
        id=f"{name}-v{version}",
        family=name.partition("-")[0],
        environment=environment,
        options={**options, **({"world": "hall"} if name.startswith("air") else {})},
        score=score,
        clock_s=options.get("horizon_s", clock_s),
        full_score=full_score,
        certificate=certificate,
        episodes=episodes,
    )


_SCORES: Mapping[str, tuple[Score, float, tuple[str, float] | None]] = MappingProxyType(
    {
        "columns_v0": ("time", 6.0, None),
        "delivery_v0": ("time", 3 * 2.2, None),
        "gates_v0": ("own", 30.0, ("gates_per_min", 80.0)),
        "crowd_v0": ("own", 30.0, ("throughput_per_min", 40.0)),
        "pursuit_v0": ("own", 20.0, ("share_on_goal", 1.0)),
    }
)
"""Score, clock in seconds, and full score."""

_CLASSIC = {task.id: task for task in _CLASSIC_ROWS}
_NOISE = {
    "mass": (0.95, 1.05),
    "thrust": (0.9, 1.1),
    "motor_rate": (0.8, 1.2),
    "position_noise_m": 0.08,
    "velocity_noise": 0.3,
}

_NEW = (
    # Two columns of small drones, half with a payload, or of a large one and two small ones.
    _of_own("air-stack-8", "columns_v0", _TOP, 128, 3, layout="stack", num_drones=8,
            gap_m=[0.28, 0.33], payload_kg=[0.013, 0.016]),
    _of_own("air-mixed-6", "columns_v0", _TOP, 128, 3, layout="stack", team="LSSLSS",
            gap_m=[0.30, 0.36], payload_kg=[0.013, 0.016]),
    # Two columns of large drones and a small one, in at most 2 s, within 3 cm.
    _of_own("air-sprint-8", "columns_v0", f"{_AWARE}@2", 128, 3, layout="sprint",
            num_drones=8, horizon_s=1.8),
    # Couriers dock above the floor, at two of three docks below others.
    _of_own("air-delivery-7", "delivery_v0", "pid+adaptive", 128, num_drones=7),
    # A slalom in vertical formation, in 12 s.
    _of_own("air-gates-4", "gates_v0", _AWARE, 64, num_drones=4, horizon_s=12.0),
    # A reached goal gives another, 1 to 3 m away; in the forest between trees.
    _of_own("crowd-open-64", "crowd_v0", _ROUND, 16, layout="open", num_drones=64),
    _of_own("crowd-forest-16", "crowd_v0", _LINE, 64, layout="forest", num_drones=16),
    _of_own("crowd-forest-64", "crowd_v0", _LINE, 16, layout="forest", num_drones=64),
    # A reached goal gives another, 0.8 to 1.6 m away, between towers.
    _of_own("crowd-buildings-32", "crowd_v0", _LINE, 32, layout="buildings", num_drones=32,
            reach_m=[0.8, 1.6]),
    # Goals are a formation that flies an ellipse; another's every 5 s; beside other drones.
    _of_own("crowd-moving-8", "pursuit_v0", _TRACKING, 64, layout="moving", num_drones=8),
    _of_own("crowd-swaps-8", "pursuit_v0", _ROUND, 64, layout="swap-goals", num_drones=8),
    _of_own("crowd-chase-8", "pursuit_v0", "pid", 64, layout="chase", num_drones=8),
    _new("crowd-random-32", "swap-random-16", _ROUND, 64, num_drones=32),
    _new("crowd-random-64", "swap-random-16", _DETOUR, 32, num_drones=64),
    _new("crowd-circle-32", "swap-circle-16", _DETOUR, 32, num_drones=32, horizon_s=16.0),
    # Force that no model knows, and a state that is estimated.
    _new("robust-random-8-hall", "swap-random-8", _ROUND, 128, world="hall"),
    _new("robust-ring-5-hall", "ring-5", _ADAPTIVE, 64, world="hall"),
    _new("robust-ring-16-hall", "ring-16", _ADAPTIVE, 64, world="hall"),
    _new("robust-shuffle-8-hall", "formation-shuffle-8", _ROUND, 64, world="hall"),
    # Mass, thrust and motors differ; observed as by radio ranging.
    _new("robust-random-8-noise", "swap-random-8", _DETOUR, 128, randomization=_NOISE),
    _new("robust-circle-8-noise", "swap-circle-8", _DETOUR, 128, randomization=_NOISE),
    _new("robust-random-LLLLSSSS", "swap-random-8", _ROUND, 128, team="LLLLSSSS"),
    # On Bullet, where drones push each other.
    _new("robust-random-4-bullet", "swap-random-4", _ROUND, 32, physics="bullet"),
    # Air in which nothing that ships was trained.
    _new("transfer-random-8-none", "swap-random-8", _ROUND, 128, interactions="none"),
    _new("transfer-random-8-wake", "swap-random-8", _ROUND, 128, interactions="wake"),
    _new("transfer-stacked-L2S-wake", "swap-stacked-L2S", _TRACKING, 128, interactions="wake"),
    _new("transfer-ring-5-wake", "ring-5", _TRACKING, 64, interactions="wake"),
)  # fmt: skip

TASKS: Mapping[str, ScoredTask] = MappingProxyType(
    {task.id: task for task in (*_CLASSIC_ROWS, *_NEW)}
)
"""Every task by its id, in the order in which they are shown."""


def choose_tasks(patterns: Sequence[str]) -> list[ScoredTask]:
    """Return the tasks whose ids match any of the patterns, in the table's order.

    Args:
        patterns: ids, or such as `swap-*` (`*`, `?`, `[...]` as in file names).

    Raises:
        ValueError: a pattern matches none; the message names the nearest id.
    """
    if not patterns:
        raise ValueError("no task is named; '*' names all")
    for pattern in patterns:
        if not any(fnmatchcase(name, pattern) for name in TASKS):
            raise ValueError(unknown_name("task", pattern, TASKS, "of the benchmark"))
    return [
        task
        for task in TASKS.values()
        if any(fnmatchcase(task.id, pattern) for pattern in patterns)
    ]
