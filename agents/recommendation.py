"""The best shipped agent for a task, by what the benchmark measured.

`recommended.json` holds a line for each task of the benchmark: what was flown, and the agents that
succeeded, the best first. `python docs/recommend.py DIR` writes it from
the results of a benchmark.
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
from swarm_envs.envs.options import blueprint_of
from swarm_envs.envs.setting import MOST_DRONES
from swarm_envs.errors import check_integer, check_name
from swarm_envs.tasks.base import Task

__all__ = ["FILE", "avoids_obstacles", "benchmark_rows", "recommended"]

FILE = "recommended.json"
"""Its name, in the folder of the agents."""
_SLOW_AROUND = {("crowd-dagger+filter", "circle")}
"""Agents and layouts in which drones wait for each other around obstacles, longer than scripts."""


@cache
def benchmark_rows() -> list[Mapping[str, Any]]:
    """Return what the benchmark has flown: task, layout, drones, world and agents of each row."""
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
    """Name of the best shipped agent for a task: for `load`, and for `swarm-envs fly --agent`.

    It is the one that succeeded most often in the benchmark, of equals the one with the highest
    score. Where no task of the benchmark has as many drones, the next larger one counts, or the
    largest, of which then scripts come first, by their score.

    Args:
        task: such as `swap`, or with its version.
        num_drones: how many fly, if no team is given; None for the task's default.
        team: the vehicles, such as `L2S`; None for those of the task. Some policies fly few types.
        learned: True for a trained policy, False for a script; None for either.
        privileged: False for one that sees what is observed alone; None for either.
        layout: of the task; None for the first one that the benchmark flies, whose results also
            count for a layout that it does not fly.
        obstacles: whether the environment has the option `obstacles`. The benchmark flies without
            it: then the best agent that flies around obstacles; where none succeeds, the best
            script, which may fly into them.
        world: of the environment. `hall` counts where the benchmark has flown the task there too,
            with as many drones or more.

    Raises:
        ValueError: the benchmark does not have this task, the task does not take such a team or
            layout, or no shipped agent flies it so; the message names those that fly it otherwise.
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
    agents = {name: about for name, about in _best_first(row, size).items() if _flies(name, flown)}
    wanted = {"learned": learned, "privileged": privileged}
    named = {k: v for k, v in wanted.items() if v is not None}
    names = [name for name, about in agents.items() if named.items() <= about.items()]
    if obstacles:
        scripts = [name for name in names if not agents[name]["learned"]]
        names = [name for name in names if _flies_around(name, row["layout"])] or scripts
    if names:
        return names[0]
    said = " and ".join(f"{name}={value}" for name, value in named.items())
    raise ValueError(
        f"no shipped agent with {said or 'any property'} flies {task!r} with {size} drones"
        f"{' among obstacles' if obstacles else ''}; "
        f"others that do: {', '.join(agents) or 'none'}"
    )


def _task_of(
    task: str, num_drones: int | None, team: str | None, layout: str | None, obstacles: bool
) -> Task:
    """The task that is flown, with one obstacle for any."""
    versions = [name for name in TASKS if task_family(name) == task_family(task)]
    options: dict[str, Any] = {} if num_drones is None else {"num_drones": num_drones}
    options = options if team is None else {"team": team}
    options |= {"layout": layout} if layout is not None else {}
    options |= {"obstacles": "column=1:1:0.15"} if obstacles else {}
    return blueprint_of(versions[-1], **options).task


def _rows_of(task: str, layout: str | None) -> list[Mapping[str, Any]]:
    """The rows of a task and layout, by the number of drones."""
    family = task_family(task)
    rows = [row for row in benchmark_rows() if row["task"] == family]
    if not rows:
        known = ", ".join(dict.fromkeys(row["task"] for row in benchmark_rows()))
        raise ValueError(f"the benchmark has no task {task!r}; it has {known}")
    like = layout if layout in {row["layout"] for row in rows} else rows[0]["layout"]
    return sorted((row for row in rows if row["layout"] == like), key=lambda row: row["drones"])


def _row_for(rows: list[Mapping[str, Any]], num_drones: int) -> Mapping[str, Any]:
    """The row of as many drones, else of the next larger number, or the largest."""
    return next((row for row in rows if row["drones"] >= num_drones), rows[-1])


def _best_first(row: Mapping[str, Any], num_drones: int) -> dict[str, Mapping[str, Any]]:
    """The agents of a row, as they are listed; for more drones than it has, scripts by score.

    A larger team takes longer: what is slow runs into the time limit, and no policy was measured.
    """
    agents: dict[str, Mapping[str, Any]] = row["agents"]
    if num_drones <= row["drones"]:
        return agents
    ranked = sorted(agents, key=lambda name: (agents[name]["learned"], -agents[name]["score"]))
    return {name: agents[name] for name in ranked}


def _flies(name: str, task: Task) -> bool:
    """Return whether an agent flies such a task and team, by its own check."""
    try:
        check_task(load_agent(name), task)
    except ValueError:
        return False
    return True


def _flies_around(name: str, layout: str | None) -> bool:
    return avoids_obstacles(load_agent(name)) and (name, layout) not in _SLOW_AROUND


def avoids_obstacles(agent: Agent) -> bool:
    """Return whether an agent steers around obstacles wherever they stand."""
    return isinstance(agent, SafetyFilter) and agent.avoids_obstacles
