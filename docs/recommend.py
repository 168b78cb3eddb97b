"""Write who is recommended for which task, from the folders of benchmarks.

    python docs/recommend.py DIR ...

What an agent did on a task replaces what the file says of it; the rest stays.

Of *robust*, only what is flown in the hall counts, and nothing of *transfer*; see
`swarm_envs.agents.recommended`.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import swarm_envs.agents
from swarm_envs import task_family
from swarm_envs.agents import SafetyFilter, load
from swarm_envs.agents.policy import PolicyAgent
from swarm_envs.agents.recommendation import FILE
from swarm_envs.agents.registry import FILTER, SHIPPED
from swarm_envs.files import written_whole
from swarm_envs.training.scoreboard.board import Board, read
from swarm_envs.training.scoreboard.tasks import TASKS

LEAST_SUCCESS = 0.5
"""Who succeeds less often is recommended to nobody."""
_PLAIN = {"classic", "air", "crowd"}
"""Families in which worlds, vehicles and engines are the environments' own; of *robust*, what is
flown in the hall is taken too."""


def recommendations(board: Board) -> list[dict[str, Any]]:
    """For each plain task of a benchmark, the shipped agents that succeed, the best first."""
    known = [TASKS[task.id] for task in board.tasks if task.id in TASKS]
    return [
        {
            "task": task_family(task.environment),
            "layout": task.options.get("layout"),
            "drones": task.drones,
            **({} if task.task in _PLAIN else {"world": "hall"}),
            "agents": _agents(board, task.id),
        }
        for task in known
        if "team" not in task.options
        if task.task in _PLAIN or (task.task == "robust" and "world" in task.options)
    ]


def _agents(board: Board, task: str) -> dict[str, dict[str, Any]]:
    """What is said of each shipped agent that succeeds, by its name, the best first."""
    found = {}
    for name, about in board.agents.items():
        cell = board.pairs.get((task, name), {"status": "unsupported"})
        if name.removesuffix(FILTER) not in SHIPPED or cell["status"] != "flown" or cell["reason"]:
            continue
        values = {key: cell["values"][key]["value"] for key in ("success_rate", "score")}
        agent = load(name)
        inner = agent.agent if isinstance(agent, SafetyFilter) else agent
        if values["success_rate"] >= LEAST_SUCCESS:
            found[name] = {
                "success": round(values["success_rate"], 4),
                "score": round(values["score"], 4),
                "learned": isinstance(inner, PolicyAgent),
                "privileged": about["privileged"],
            }
    return _best_first(found)


def _best_first(found: dict[str, dict[str, Any]]) -> dict[str, dict[str, Any]]:
    best = sorted(found, key=lambda name: (-found[name]["success"], -found[name]["score"]))
    return {name: found[name] for name in best}


def replaced(old: list[dict[str, Any]], board: Board) -> list[dict[str, Any]]:
    """The rows, with what a benchmark measured in place of what they say of the same."""
    rows = {_place(row): row for row in old}
    for row in recommendations(board):
        known = rows.get(key := _place(row), {"agents": {}})
        kept = {k: v for k, v in known["agents"].items() if k not in board.agents}
        rows[key] = {**row, "agents": _best_first({**kept, **row["agents"]})}
    return [row for row in rows.values() if row["agents"]]


def _place(row: dict[str, Any]) -> tuple[Any, ...]:
    return tuple(row.get(name) for name in ("task", "layout", "drones", "world"))


if __name__ == "__main__":
    file = Path(swarm_envs.agents.__file__).parent / FILE
    rows = json.loads(file.read_text(encoding="utf-8"))["tasks"]
    for folder in sys.argv[1:]:
        rows = replaced(rows, read(Path(folder)))
    lines = ",\n".join(map(json.dumps, rows))
    with written_whole(file) as partial:
        partial.write_text(f'{{"tasks": [\n{lines}\n]}}\n', encoding="utf-8")
