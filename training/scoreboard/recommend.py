"""Write who is recommended for which task, from the folder of a benchmark.

    python -m swarm_envs.training.scoreboard.recommend DIR

Tasks are those of version 2 in the ideal world and the usual air; see
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
from swarm_envs.training.scoreboard.tasks import TASKS, ScoredTask

LEAST_SUCCESS = 0.5
"""Who succeeds less often is recommended to nobody."""
_ELSEWHERE = {"world", "randomization", "team", "physics", "interactions", "obstacles"}
"""Options of tasks that are no plain task of so many drones."""


def recommendations(board: Board) -> list[dict[str, Any]]:
    """For each plain task of a benchmark, the shipped agents that succeed, the best first."""
    plain = [task for task in map(_scored, board.tasks) if task is not None]
    return [
        {
            "task": task_family(task.environment),
            "layout": task.options.get("layout"),
            "drones": task.drones,
            "agents": _agents(board, task.id),
        }
        for task in plain
    ]


def _scored(task: Any) -> ScoredTask | None:
    """The row of the table, if it is a plain task of version 2."""
    found = TASKS.get(task.id)
    plain = found is not None and found.certificate and not _ELSEWHERE & set(found.options)
    return found if plain else None


def _agents(board: Board, task: str) -> dict[str, dict[str, Any]]:
    """What is said of each shipped agent that succeeds, by its name, the best first."""
    found = {}
    for name, about in board.agents.items():
        cell = board.pairs.get((task, name))
        if name.removesuffix(FILTER) not in SHIPPED or cell is None or cell["status"] != "flown":
            continue
        success, score = (cell["values"][key]["value"] for key in ("success_rate", "score"))
        if success >= LEAST_SUCCESS and not cell["reason"]:
            found[name] = {
                "success": round(success, 4),
                "score": round(score, 4),
                "learned": _is_learned(name),
                "privileged": about["privileged"],
            }
    best = sorted(found, key=lambda name: (-found[name]["success"], -found[name]["score"]))
    return {name: found[name] for name in best}


def _is_learned(name: str) -> bool:
    agent = load(name)
    return isinstance(agent.agent if isinstance(agent, SafetyFilter) else agent, PolicyAgent)


def write_recommendations(board: Board, path: Path) -> None:
    """Write them, a line a task."""
    lines = ",\n".join(json.dumps(row) for row in recommendations(board))
    with written_whole(path) as partial:
        partial.write_text(f'{{"tasks": [\n{lines}\n]}}\n', encoding="utf-8")


if __name__ == "__main__":
    (folder,) = sys.argv[1:]
    write_recommendations(read(Path(folder)), Path(swarm_envs.agents.__file__).parent / FILE)
