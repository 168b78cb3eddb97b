"""The table of recommended agents: `<!-- recommended agents -->` becomes it.

It says what `swarm_envs.agents.recommended` returns for each task of the benchmark, so it follows
from the agents' own checks and the benchmark's results.
"""

from __future__ import annotations

from typing import Any

from swarm_envs.agents.recommendation import benchmark_rows, recommended

CHOICES: dict[str, dict[str, bool]] = {
    "any": {},
    "`privileged=False`": {"privileged": False},
    "`learned=True`": {"learned": True},
    "`obstacles=True`": {"obstacles": True},
}
"""Columns of the table: what is asked for."""


def recommendation_table() -> str:
    """One table in Markdown: a row for each task, layout, world and number of drones."""
    head = ["task", "layout", "drones", "world", *CHOICES]
    rows = sorted(benchmark_rows(), key=lambda row: (row["task"], row["layout"] or ""))
    return "\n".join([_line(head), _line(["---"] * len(head)), *map(_row, rows)])


def _row(row: Any) -> str:
    world = row.get("world", "ideal")
    about = [row["task"], row["layout"] or "", str(row["drones"]), world]
    given = {"num_drones": row["drones"], "layout": row["layout"], "world": world}
    return _line([*about, *(_name(row["task"], **given, **asked) for asked in CHOICES.values())])


def _name(task: str, **asked: Any) -> str:
    try:
        return f"`{recommended(task, **asked)}`"
    except ValueError:
        return ""


def _line(cells: list[str]) -> str:
    return f"| {' | '.join(cells)} |"
