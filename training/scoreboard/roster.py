"""Agents of the benchmark: every included one, and behind a safety filter who gains by it.

How many of a task's episodes an agent flies follows from what it costs, and is frozen here: all
agents on all tasks take less than an hour on two processors.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase
from pathlib import Path
from types import MappingProxyType

from swarm_envs.agents.registry import FILTER, SHIPPED
from swarm_envs.errors import unknown_name
from swarm_envs.training.scoreboard.tasks import ScoredTask

__all__ = ["ROSTER", "choose_agents"]

LEAST = 8  # Episodes that every agent flies at least


@dataclass(frozen=True)
class Place:
    """An agent in the roster."""

    label: str  # For people
    help: str  # What it is, in a sentence
    share: int = 1  # It flies the first 1 / share of a task's episodes
    cost: float = 0.001
    """CPU seconds for each drone and second of the clock, about: what the bar reckons with."""


_POLICY = "One network for every drone, on its own observation."
_COMPENSATED = "The same, with a controller that feeds forward the force that its model predicts."
_ADAPTIVE = "The same, with a controller that compensates an estimate of the force (INDI)."
_FILTERED = "The same, behind a filter of barrier functions."

ROSTER: Mapping[str, Place] = MappingProxyType(
    {
        "hover": Place("hover", "Stays where it starts: the score of no motion.", 2),
        "random": Place("random", "Draws every action uniformly: the score of chance.", 2, 0.0005),
        "straight-line": Place("straight line", "A PD law to the goal that ignores other drones."),
        "straight-line+filter": Place("straight line + filter", _FILTERED),
        "fast-line": Place("fast line", "A faster PD law, behind the filter.", 1, 0.0015),
        "orca": Place("ORCA", "Reciprocal velocity obstacles.", 1, 0.0015),
        "roundabout": Place(
            "roundabout", "Where paths cross: slower, to the right, at separate heights.", 1, 0.0015
        ),
        "tracking": Place("tracking", "The controller of Neural-Swarm2, for moving references.", 2),
        "tracking+compensated": Place("tracking, compensated", _COMPENSATED, 2),
        "tracking+adaptive": Place("tracking, adaptive", _ADAPTIVE, 2),
        "tracking+compensated+adaptive": Place(
            "tracking, compensated and adaptive", "The same, with feed-forward and estimate.", 2
        ),
        "air-blind": Place(
            "air, blind", "Stiff gains and an integrator, without a force model.", 2
        ),
        "air-blind+adaptive": Place("air, blind and adaptive", _ADAPTIVE, 2),
        "air-aware": Place(
            "air, aware", "Force model and estimate, for fast and precise flight.", 2
        ),
        "air-on-top": Place(
            "air, on top", "The same with soft gains, for drones near their thrust limit.", 2
        ),
        "detour": Place(
            "detour", "Smooth paths around each other, planned once, for every task.", 4
        ),
        "detour+compensated": Place("detour, compensated", _COMPENSATED, 4, 0.004),
        "swap-dagger": Place("swap DAgger", f"{_POLICY} It imitates a roundabout, for circles."),
        "gates-dagger": Place(
            "gates DAgger", f"{_POLICY} It flies gates in the downwash of others."
        ),
        "pursuit-dagger": Place(
            "pursuit DAgger",
            f"{_POLICY} It imitates tracking and a roundabout, for goals that move.",
        ),
        "pursuit-dagger+filter": Place("pursuit DAgger + filter", _FILTERED),
        "crowd-dagger": Place(
            "crowd DAgger", f"{_POLICY} It imitates a script that knows all obstacles."
        ),
        "crowd-dagger+filter": Place("crowd DAgger + filter", _FILTERED),
        "stack-dagger": Place(
            "stack DAgger", f"{_POLICY} It puts heavy drones on top, for small drones."
        ),
        "mixed-dagger": Place(
            "mixed DAgger", f"{_POLICY} It puts heavy drones on top, for mixed teams."
        ),
        "sprint-dagger": Place(
            "sprint DAgger", f"{_POLICY} It imitates minimum-jerk paths, for short times."
        ),
        "delivery-dagger": Place(
            "delivery DAgger", f"{_POLICY} It imitates minimum-jerk paths, for docks."
        ),
        "ring-dagger": Place(
            "ring DAgger", f"{_POLICY} It leads set-points against the force, for rings."
        ),
        "neural-swarm-planner": Place(
            "Neural-Swarm2 planner", "Plans paths with bounded forces, and tracks them.", 8, 0.1
        ),
        "mlr-dmpc": Place(
            "MLR-DMPC", "Distributed MPC over a radio, five times a second.", 4, 0.009
        ),
        "mlr-dmpc+compensated": Place("MLR-DMPC, compensated", _COMPENSATED, 4, 0.009),
        "rth3d": Place(
            "RTH3D", "Plans on a grid and flies splines along the plan, for many drones.", 4, 0.007
        ),
        "rth3d+compensated": Place("RTH3D, compensated", _COMPENSATED, 4, 0.007),
    }
)
"""Agents by name, in the order in which they are shown."""


def place_of(name: str) -> Place:
    """An agent's place; one that does not ship has that of the slow ones."""
    if name in ROSTER:
        return ROSTER[name]
    if inner := ROSTER.get(name.removesuffix(FILTER)):
        return replace(inner, label=f"{inner.label} + filter", help=_FILTERED)
    path, _, part = name.rpartition(":")
    return Place(part if path else Path(name).name, "Given by its file.", 4, 0.003)


def episodes_of(name: str, task: ScoredTask) -> int:
    """How many of a task's episodes an agent flies."""
    return min(task.episodes, max(LEAST, task.episodes // place_of(name).share))


def seconds_of(name: str, task: ScoredTask) -> float:
    """What an episode costs at most, about, CPU seconds."""
    return place_of(name).cost * task.drones * task.clock_s


def choose_agents(patterns: Sequence[str]) -> list[str]:
    """Names of the agents that are meant: those of the roster first, in its order.

    Args:
        patterns: names of the roster, or such as `swap-*`; and agents as `swarm_envs.agents.load`
            takes them: path/to/file.py:Class, folders of trained policies.

    Raises:
        ValueError: nothing has this name; the message names the nearest.
    """
    found: dict[str, None] = {}
    others: dict[str, None] = {}
    for pattern in patterns:
        matched = [name for name in ROSTER if fnmatchcase(name, pattern)]
        if matched:
            found |= dict.fromkeys(matched)
        elif _may_be_loaded(pattern):
            others[pattern] = None
        else:
            raise ValueError(
                unknown_name("agent", pattern, ROSTER)
                + "; one of your own is path/to/file.py:Class, or a folder of a trained policy"
            )
    if not found and not others:
        raise ValueError("no agent is named; '*' names all that ship")
    return [*(name for name in ROSTER if name in found), *others]


def _may_be_loaded(name: str) -> bool:
    inner = name.removesuffix(FILTER)
    return inner in SHIPPED or ":" in inner or Path(inner).exists()
