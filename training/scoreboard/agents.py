"""The agents of the benchmark: every included one, and some behind a safety filter.

How many of a task's episodes an agent flies follows from its cost, and is fixed here: all agents on
all tasks take less than an hour on two processors.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from fnmatch import fnmatchcase
from pathlib import Path
from types import MappingProxyType

from swarm_envs.agents.registry import FILTER, SHIPPED
from swarm_envs.errors import unknown_name
from swarm_envs.training.scoreboard.tasks import ScoredTask

__all__ = ["AGENTS", "choose_agents"]

LEAST = 8  # Episodes that every agent flies at least

AGENTS: Mapping[str, int] = MappingProxyType(
    {
        "hover": 2,
        "random": 2,
        "straight-line": 1,
        "straight-line+filter": 1,
        "fast-line": 1,
        "orca": 1,
        "roundabout": 1,
        "tracking": 2,
        "tracking+compensated": 2,
        "tracking+adaptive": 2,
        "tracking+compensated+adaptive": 2,
        "pid": 2,
        "pid+adaptive": 2,
        "downwash-aware": 2,
        "heavy-on-top": 2,
        "detour": 4,
        "detour+compensated": 4,
        "swap-dagger": 1,
        "gates-dagger": 1,
        "pursuit-dagger": 1,
        "pursuit-dagger+filter": 1,
        "crowd-dagger": 1,
        "crowd-dagger+filter": 1,
        "stack-dagger": 1,
        "mixed-dagger": 1,
        "sprint-dagger": 1,
        "delivery-dagger": 1,
        "ring-dagger": 1,
        "swap-ppo": 1,
        "neural-swarm-planner": 8,
        "mlr-dmpc": 4,
        "mlr-dmpc+compensated": 4,
        "rth3d": 4,
        "rth3d+compensated": 4,
    }
)
"""Agents by name, in the order in which they are shown. Of slow ones the number is greater: an
agent flies the first 1 / number of a task's episodes."""
_OTHERS = 4  # The number of agents that do not ship


def slowness_of(name: str) -> int:
    """Return an agent's number in the table; one that does not ship has that of slow agents."""
    return AGENTS.get(name) or AGENTS.get(name.removesuffix(FILTER)) or _OTHERS


def episodes_of(name: str, task: ScoredTask) -> int:
    """Return how many of a task's episodes an agent flies."""
    return min(task.episodes, max(LEAST, task.episodes // slowness_of(name)))


def cost_of(name: str, task: ScoredTask) -> float:
    """Return the cost of an episode, relative to others, roughly."""
    return slowness_of(name) * task.drones * task.clock_s


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
