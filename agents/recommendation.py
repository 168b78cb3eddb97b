"""The best shipped agent for a task, by what the benchmark measured.

`recommended.json` holds a line for each task of the benchmark: what was flown, and the agents that
succeeded, the best first. `python -m swarm_envs.training.scoreboard.recommend DIR` writes it from
the folder of a benchmark.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from functools import cache
from importlib import resources
from typing import Any

from swarm_envs import task_family
from swarm_envs.agents.registry import load_agent
from swarm_envs.arguments import Count, typed

__all__ = ["FILE", "recommended"]

FILE = "recommended.json"
"""Its name, in the folder of the agents."""
Row = Mapping[str, Any]
"""A task of the benchmark: `task`, `layout`, `drones`, and `agents` by name, the best first, each
with `success`, `score`, `learned` and `privileged`."""


@cache
def _rows() -> list[Row]:
    text = resources.files("swarm_envs.agents").joinpath(FILE).read_text(encoding="utf-8")
    rows: list[Row] = json.loads(text)["tasks"]
    return rows


@typed
def recommended(
    task: str,
    *,
    num_drones: Count = 4,
    learned: bool | None = None,
    privileged: bool | None = None,
    layout: str | None = None,
) -> str:
    """Name of the best shipped agent for a task: for `load`, and for `swarm-envs fly --agent`.

    It is the one that succeeded most often in the benchmark, of equals the one with the highest
    score. Where no task of the benchmark has as many drones, the next larger one counts, or the
    largest.

    Args:
        task: such as `swap`, or with its version.
        num_drones: how many fly.
        learned: True for a trained policy, False for a script; None for either.
        privileged: False for one that sees what is observed alone; None for either.
        layout: of the task; None, or one that the benchmark does not fly, stands for the first one
            that it does.

    Raises:
        ValueError: the benchmark does not have this task, or no shipped agent flies it so; the
            message says who flies something near.
    """
    rows = _of_task(task, layout)
    row = _row_for(rows, num_drones)
    wanted = {"learned": learned, "privileged": privileged}
    named = {k: v for k, v in wanted.items() if v is not None}
    fine = [name for name, about in row["agents"].items() if named.items() <= about.items()]
    for name in fine:
        if _takes(name, num_drones):
            return name
    said = " and ".join(f"{name}={value}" for name, value in named.items())
    others = ", ".join(row["agents"]) or "none"
    raise ValueError(
        f"no shipped agent with {said or 'any property'} flies {task!r} with {num_drones} drones; "
        f"others that do: {others}"
    )


def _of_task(task: str, layout: str | None) -> list[Row]:
    family = task_family(task)
    rows = [row for row in _rows() if row["task"] == family]
    if not rows:
        known = ", ".join(dict.fromkeys(row["task"] for row in _rows()))
        raise ValueError(f"the benchmark has no task {task!r}; it has {known}")
    found = [row for row in rows if row["layout"] == layout]
    return found or [row for row in rows if row["layout"] == rows[0]["layout"]]


def _row_for(rows: list[Row], num_drones: int) -> Row:
    """The row of as many drones, else of the next larger number, else of the largest."""
    enough = [row for row in rows if row["drones"] >= num_drones]
    drones = min(row["drones"] for row in enough) if enough else max(r["drones"] for r in rows)
    return next(row for row in rows if row["drones"] == drones)


def _takes(name: str, num_drones: int) -> bool:
    """Whether an agent takes teams of so many: trained policies do not take all."""
    agent = load_agent(name)
    note = getattr(getattr(getattr(agent, "agent", agent), "policy", None), "note", None)
    return note is None or bool(note.fewest <= num_drones <= note.drones)
