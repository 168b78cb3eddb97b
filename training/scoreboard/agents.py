"""The agents of the benchmark: every included agent, and some with a safety filter.

Slow agents are evaluated on fewer episodes, so that all agents on all tasks take less than an hour
on two processors.
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

LEAST = 8  # Least number of episodes of every agent

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
"""Agents and their slowness, in the order of tables: an agent is evaluated on the first
1 / slowness of a task's episodes."""
_OTHERS = 4  # Slowness of custom agents


def episodes_of(name: str, task: ScoredTask) -> int:
    """Return the number of a task's episodes on which an agent is evaluated."""
    slowness = AGENTS.get(name) or AGENTS.get(name.removesuffix(FILTER)) or _OTHERS
    return min(task.episodes, max(LEAST, task.episodes // slowness))


def choose_agents(patterns: Sequence[str]) -> list[str]:
    """Return the names of agents: those of the table first, in its order.

    Args:
        patterns: names of the table, patterns such as `swap-*`, and other names for
            `swarm_envs.agents.load`: path/to/file.py:Class and folders of trained policies.

    Raises:
        ValueError: no agent has this name; the message names the most similar.
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
                + "; a custom agent is path/to/file.py:Class, or the folder of a trained policy"
            )
    if not found and not others:
        raise ValueError("--agent is empty; '*' stands for all included agents")
    return [*(name for name in AGENTS if name in found), *others]


def _may_be_loaded(name: str) -> bool:
    inner = name.removesuffix(FILTER)
    return inner in SHIPPED or ":" in inner or Path(inner).exists()
