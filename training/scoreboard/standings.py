"""A scoreboard in a few tables of text, for terminals and for pages.

python -m swarm_envs.training.scoreboard.standings DIR
prints those of a benchmark's folder as Markdown.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

NOTE = "* sees the true state; (k of n): of the tasks it supports, all where nothing stands"
"""What the marks in the tables mean."""
_NOT_FLOWN = {"unsupported": "-", "failed": "failed"}


def standings(content: Mapping[str, Any]) -> list[list[str]]:
    """Rows of the agents' aggregates by family, a head first.

    Args:
        content: what `scores.json` holds.
    """
    families = list(content["aggregates"])
    rows = [["agent", *families]]
    for agent in content["agents"]:
        found = (content["aggregates"][family].get(agent["name"]) for family in families)
        rows.append([_name(agent), *map(_standing, found)])
    return rows


def success_rates(content: Mapping[str, Any], family: str) -> list[list[str]]:
    """Rows of the agents' success rates on the tasks of a family, percent, a head first.

    Agents that support none of them are left out.

    Args:
        content: what `scores.json` holds.
        family: such as `swap`.
    """
    tasks = [task for task in content["tasks"] if task["task"] == family]
    cells = {(cell["task"], cell["agent"]): cell for cell in content["cells"]}
    rows = [["agent", *(_short(task["id"]) for task in tasks)]]
    for agent in content["agents"]:
        row = [_rate(cells[task["id"], agent["name"]]) for task in tasks]
        if set(row) != {_NOT_FLOWN["unsupported"]}:
            rows.append([_name(agent), *row])
    return rows


def aligned(rows: Sequence[Sequence[str]]) -> list[str]:
    """Lines of a table whose columns stand below each other."""
    widths = [max(len(row[k]) for row in rows) for k in range(len(rows[0]))]
    lines = ("  ".join(c.ljust(w) for c, w in zip(row, widths, strict=True)) for row in rows)
    return [line.rstrip() for line in lines]


def markdown(rows: Sequence[Sequence[str]]) -> list[str]:
    """Lines of a table in Markdown."""
    head, *others = (f"| {' | '.join(row)} |" for row in rows)
    return [head, "|" + "---|" * len(rows[0]), *others]


def _name(agent: Mapping[str, Any]) -> str:
    return f"{agent['name']}{'*' if agent['privileged'] else ''}"


def _short(task: str) -> str:
    """`circle 4` of `swap-circle-4-v1`."""
    return " ".join(task.split("-")[1:-1])


def _standing(standing: Mapping[str, Any] | None) -> str:
    if standing is None:
        return "-"
    (low, high), flown, of = standing["interval"], standing["tasks"], standing["of"]
    part = "" if flown == of else f" ({flown} of {of})"
    return f"{standing['value']:.2f} [{low:.2f}, {high:.2f}]{part}"


def _rate(cell: Mapping[str, Any]) -> str:
    if cell["status"] != "flown":
        return _NOT_FLOWN[cell["status"]]
    return f"{100.0 * cell['values']['success_rate']['value']:.0f}"


def pages_text(content: Mapping[str, Any]) -> str:
    """All tables as Markdown, each after the name of what it shows."""
    parts = [["Scores", *markdown(standings(content))]]
    for family in content["aggregates"]:
        parts.append([f"Success, {family}, %", *markdown(success_rates(content, family))])
    return "\n\n".join("\n".join([part[0], "", *part[1:]]) for part in parts)


if __name__ == "__main__":
    folder = Path(sys.argv[1])
    found = json.loads((folder / "scores.json").read_text(encoding="utf-8"))
    sys.stdout.write(pages_text(found) + "\n")
