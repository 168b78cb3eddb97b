"""The agents of the benchmark: every included one, and some behind a safety filter.

How many of a task's episodes an agent flies follows from its cost, and is fixed here: all agents on
all tasks take less than an hour on two processors.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from pathlib import Path
from types import MappingProxyType

from swarm_envs.agents.registry import FILTER, SHIPPED
from swarm_envs.errors import unknown_name
from swarm_envs.training.scoreboard.tasks import ScoredTask

__all__ = ["AGENTS", "choose_agents"]

LEAST = 8  # Episodes that every agent flies at least


@dataclass(frozen=True)
class Entry:
    """The cost of an agent in the benchmark."""

    share: int = 1
    """It flies the first 1 / share of a task's episodes."""
    cost: float = 0.001
    """CPU seconds per drone and second of the clock, roughly: the progress bar counts these."""


AGENTS: Mapping[str, Entry] = MappingProxyType(
    {
        "hover": Entry(2),
        "random": Entry(2, 0.0005),
        "straight-line": Entry(),
        "straight-line+filter": Entry(),
        "fast-line": Entry(1, 0.0015),
        "orca": Entry(1, 0.0015),
        "roundabout": Entry(1, 0.0015),
        "tracking": Entry(2),
        "tracking+compensated": Entry(2),
        "tracking+adaptive": Entry(2),
        "tracking+compensated+adaptive": Entry(2),
        "air-blind": Entry(2),
        "air-blind+adaptive": Entry(2),
        "air-aware": Entry(2),
        "air-on-top": Entry(2),
        "detour": Entry(4),
        "detour+compensated": Entry(4, 0.004),
        "swap-dagger": Entry(),
        "gates-dagger": Entry(),
        "pursuit-dagger": Entry(),
        "pursuit-dagger+filter": Entry(),
        "crowd-dagger": Entry(),
        "crowd-dagger+filter": Entry(),
        "stack-dagger": Entry(),
        "mixed-dagger": Entry(),
        "sprint-dagger": Entry(),
        "delivery-dagger": Entry(),
        "ring-dagger": Entry(),
        "swap-ppo": Entry(),
        "neural-swarm-planner": Entry(8, 0.1),
        "mlr-dmpc": Entry(4, 0.009),
        "mlr-dmpc+compensated": Entry(4, 0.009),
        "rth3d": Entry(4, 0.007),
        "rth3d+compensated": Entry(4, 0.007),
    }
)
"""Agents by name, in the order in which they are shown."""
_OTHER = Entry(4, 0.003)


def entry_of(name: str) -> Entry:
    """Return an agent's entry; one that does not ship has the share of slow agents."""
    return AGENTS.get(name) or AGENTS.get(name.removesuffix(FILTER)) or _OTHER


def episodes_of(name: str, task: ScoredTask) -> int:
    """Return how many of a task's episodes an agent flies."""
    return min(task.episodes, max(LEAST, task.episodes // entry_of(name).share))


def seconds_of(name: str, task: ScoredTask) -> float:
    """Return the approximate cost of an episode at most, CPU seconds."""
    return entry_of(name).cost * task.drones * task.clock_s


def choose_agents(patterns: Sequence[str]) -> list[str]:
    """Return names of agents: those of the table first, in its order.

    Args:
        patterns: names of the table, or such as `swap-*`; and agents as `swarm_envs.agents.load`
            takes them: path/to/file.py:Class, folders of trained policies.

    Raises:
        ValueError: nothing has this name; the message names the nearest.
    """
    found: dict[str, None] = {}
    others: dict[str, None] = {}
    for pattern in patterns:
        matched = [name for name in AGENTS if fnmatchcase(name, pattern)]
        if matched:
            found |= dict.fromkeys(matched)
        elif _may_be_loaded(pattern):
            others[pattern] = None
        else:
            raise ValueError(
                unknown_name("agent", pattern, AGENTS)
                + "; one of your own is path/to/file.py:Class, or a folder of a trained policy"
            )
    if not found and not others:
        raise ValueError("no agent is named; '*' names all that ship")
    return [*(name for name in AGENTS if name in found), *others]


def _may_be_loaded(name: str) -> bool:
    inner = name.removesuffix(FILTER)
    return inner in SHIPPED or ":" in inner or Path(inner).exists()
