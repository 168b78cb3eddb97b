"""The best included agent for a task, from the results of the benchmark.

`recommended.json` has an entry for each task of the benchmark with the agents that succeeded, the
best first. `python docs/recommend.py DIR` writes it from the results of a benchmark.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from functools import cache
from importlib import resources
from typing import Any, Literal

from swarm_envs import TASKS, task_family
from swarm_envs.agents.protocol import Agent, check_task
from swarm_envs.agents.registry import load_agent
from swarm_envs.agents.safety import SafetyFilter
from swarm_envs.envs.config import MOST_DRONES
from swarm_envs.envs.options import blueprint_of
from swarm_envs.errors import check_integer, check_name
from swarm_envs.tasks.base import Task

__all__ = ["FILE", "avoids_obstacles", "benchmark_rows", "recommended"]

FILE = "recommended.json"
"""Name of the file in the folder of the agents."""
_SLOW_AROUND = {("crowd-dagger+filter", "circle")}
"""Agents and layouts that are slower among obstacles than scripts are."""


@cache
def benchmark_rows() -> list[Mapping[str, Any]]:
    """Return the tasks of the benchmark: task, layout, drones, world and agents of each."""
    text = resources.files("swarm_envs.agents").joinpath(FILE).read_text(encoding="utf-8")
    rows: list[Mapping[str, Any]] = json.loads(text)["tasks"]
    return rows


def recommended(
    task: str,
    *,
    num_drones: int | None = None,
    team: str | None = None,
    learned: bool | None = None,
    privileged: bool | None = None,
    layout: str | None = None,
    obstacles: bool = False,
    world: Literal["ideal", "hall"] | None = None,
) -> str:
    """Return the name of the best included agent for a task, for `load` and `swarm-envs fly`.

    It has the highest success rate in the benchmark, and of equal ones the highest score to two
    decimals, without a safety filter if possible. If the benchmark has no task with as many drones,
    the result is that of the next larger number, or of the largest, for which scripts are preferred
    to policies.

    Args:
        task: the task, such as `swap`, or with a version.
        num_drones: the number of drones if no team is given; None for the task's default.
        team: the vehicle types, such as `L2S`; None for the task's default.
        learned: True for a trained policy, False for a script, None for either.
        privileged: False for an agent that does not observe the true state; None for either.
        layout: the layout; None for the first one in the benchmark, which is also used for layouts
            that are not in the benchmark.
        obstacles: True if the environment has the option `obstacles`. As the benchmark does not use
            it, the result is the best agent that avoids obstacles, or if none succeeds, the best
            script, which may collide with them.
        world: the world of the environment. Results in `hall` are used if the benchmark has the
            task there, with as many drones or more.

    Raises:
        ValueError: the benchmark does not have the task, the task does not support the team or
            layout, or no included agent qualifies; the message names agents with other properties.
    """
    if num_drones is not None:
        check_integer("num_drones", num_drones, at_least=1, at_most=MOST_DRONES)
    if world is not None:
        check_name("world", world, ("ideal", "hall"))
    rows = _rows_of(task, layout)
    plain = [row for row in rows if "world" not in row]
    flown = _task_of(task, num_drones, team, layout or rows[0]["layout"], obstacles)
    size = len(flown.team)
    there = [row for row in rows if row.get("world") == world and row["drones"] >= size]
    row = _row_for(there or plain, size)
    agents, wanted = _best_first(row, size), {"learned": learned, "privileged": privileged}
    named = {k: v for k, v in wanted.items() if v is not None}
    names = [name for name, about in agents.items() if named.items() <= about.items()]
    if obstacles:
        scripts = [name for name in names if not agents[name]["learned"]]
        names = [name for name in names if _flies_around(name, row["layout"])] + scripts
    for name in names:  # to the first, since each agent's module has to be imported
        if _flies(name, flown):
            return name
    others = [name for name in agents if _flies(name, flown)]
    properties = " and ".join(f"{name}={value}" for name, value in named.items())
    raise ValueError(
        f"no included agent{f' with {properties}' if properties else ''} flies {task!r} with "
        f"{size} drones{' among obstacles' if obstacles else ''}; "
        f"agents with other properties: {', '.join(others) or 'none'}"
    )


def _task_of(
    task: str, num_drones: int | None, team: str | None, layout: str | None, obstacles: bool
) -> Task:
    """Return the task with the given options, and one obstacle if it has any."""
    versions = [name for name in TASKS if task_family(name) == task_family(task)]
    options: dict[str, Any] = {} if num_drones is None else {"num_drones": num_drones}
    options = options if team is None else {"team": team}
    options |= {"layout": layout} if layout is not None else {}
    options |= {"obstacles": "column=1:1:0.15"} if obstacles else {}
    return blueprint_of(versions[-1], **options).task


def _rows_of(task: str, layout: str | None) -> list[Mapping[str, Any]]:
    """Return the rows of a task and layout, sorted by the number of drones."""
    family = task_family(task)
    rows = [row for row in benchmark_rows() if row["task"] == family]
    if not rows:
        known = ", ".join(dict.fromkeys(row["task"] for row in benchmark_rows()))
        raise ValueError(f"the benchmark has no task {task!r}; it has {known}")
    like = layout if layout in {row["layout"] for row in rows} else rows[0]["layout"]
    return sorted((row for row in rows if row["layout"] == like), key=lambda row: row["drones"])


def _row_for(rows: list[Mapping[str, Any]], num_drones: int) -> Mapping[str, Any]:
    """Return the row of the smallest number of drones that is enough, or of the largest."""
    return next((row for row in rows if row["drones"] >= num_drones), rows[-1])


def _best_first(row: Mapping[str, Any], num_drones: int) -> dict[str, Mapping[str, Any]]:
    """Return the agents of a row, best first; for more drones than it has, scripts by score first.

    Larger teams take longer, so that slow agents reach the time limit; policies were not evaluated.
    """
    agents: dict[str, Mapping[str, Any]] = row["agents"]
    if num_drones <= row["drones"]:
        return agents
    ranked = sorted(agents, key=lambda name: (agents[name]["learned"], -agents[name]["score"]))
    return {name: agents[name] for name in ranked}


def _flies(name: str, task: Task) -> bool:
    """Return True if an agent supports a task with its team, by its own check."""
    try:
        check_task(load_agent(name), task)
    except ValueError:
        return False
    return True


def _flies_around(name: str, layout: str | None) -> bool:
    return avoids_obstacles(load_agent(name)) and (name, layout) not in _SLOW_AROUND


def avoids_obstacles(agent: Agent) -> bool:
    """Return True if an agent steers around obstacles at any position."""
    return isinstance(agent, SafetyFilter) and agent.avoids_obstacles
