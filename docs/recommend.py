"""Write which agents are recommended for which task, from the results of benchmarks.

    python docs/recommend.py board/episodes.parquet ...

What an agent did on a task replaces what the file says of it; the rest stays.

Of *robust*, only what is flown in the hall counts, and nothing of *transfer*; see
`swarm_envs.agents.recommended`.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import numpy as np

import swarm_envs.agents
from swarm_envs import task_family
from swarm_envs.agents import SafetyFilter, load
from swarm_envs.agents.evaluation import interquartile_mean
from swarm_envs.agents.policy import PolicyAgent
from swarm_envs.agents.recommendation import FILE
from swarm_envs.agents.registry import FILTER, SHIPPED
from swarm_envs.files import written_whole
from swarm_envs.training.scoreboard.results import Results, read_results
from swarm_envs.training.scoreboard.tasks import TASKS

LEAST_SUCCESS = 0.5
"""An agent that succeeds less often is not recommended."""
_PLAIN = {"classic", "air", "crowd"}
"""Families in which worlds, vehicles and engines are the environments' own; of *robust*, what is
flown in the hall is taken too."""


def recommendations(results: Results) -> list[dict[str, Any]]:
    """Return the shipped agents that succeed on each plain task of a benchmark, the best first."""
    known = [TASKS[name] for name in results.about["tasks"] if name in TASKS]
    return [
        {
            "task": task_family(task.environment),
            "layout": task.options.get("layout"),
            "drones": task.drones,
            **({} if task.family in _PLAIN else {"world": "hall"}),
            "agents": _agents(results, task.id),
        }
        for task in known
        if "team" not in task.options
        if task.family in _PLAIN or (task.family == "robust" and "world" in task.options)
    ]


def _agents(results: Results, task: str) -> dict[str, dict[str, Any]]:
    """Return what is written of each shipped agent that succeeds, by its name, the best first."""
    found = {}
    for cell in results.cells:
        shipped = cell.agent.removesuffix(FILTER) in SHIPPED
        if cell.task != task or not shipped or cell.status != "flown" or cell.reason:
            continue
        success = float(np.mean([row["success"] for row in cell.rows]))
        score = float(interquartile_mean(np.array([row["score"] for row in cell.rows])))
        agent = load(cell.agent)
        inner = agent.agent if isinstance(agent, SafetyFilter) else agent
        if success >= LEAST_SUCCESS:
            found[cell.agent] = {
                "success": round(success, 4),
                "score": round(score, 4),
                "learned": isinstance(inner, PolicyAgent),
                "privileged": results.about["agents"][cell.agent]["privileged"],
            }
    return _best_first(found)


def _best_first(found: dict[str, dict[str, Any]]) -> dict[str, dict[str, Any]]:
    """Sort by success, then by score to two decimals; of equal agents, one without filter first."""

    def rank(name: str) -> tuple[float, float, bool, float]:
        success, score = found[name]["success"], found[name]["score"]
        return -success, -round(score, 2), name.endswith(FILTER), -score

    return {name: found[name] for name in sorted(found, key=rank)}


def replaced(old: list[dict[str, Any]], results: Results) -> list[dict[str, Any]]:
    """Return the rows with what a benchmark measured in place of what they have of the same."""
    rows = {_place(row): row for row in old}
    for row in recommendations(results):
        known = rows.get(key := _place(row), {"agents": {}})
        kept = {k: v for k, v in known["agents"].items() if k not in results.about["agents"]}
        rows[key] = {**row, "agents": _best_first({**kept, **row["agents"]})}
    return [row for row in rows.values() if row["agents"]]


def _place(row: dict[str, Any]) -> tuple[Any, ...]:
    return tuple(row.get(name) for name in ("task", "layout", "drones", "world"))


if __name__ == "__main__":
    file = Path(swarm_envs.agents.__file__).parent / FILE
    rows = json.loads(file.read_text(encoding="utf-8"))["tasks"]
    for path in sys.argv[1:]:
        rows = replaced(rows, read_results(Path(path)))
    lines = ",\n".join(map(json.dumps, rows))
    with written_whole(file) as partial:
        partial.write_text(f'{{"tasks": [\n{lines}\n]}}\n', encoding="utf-8")
