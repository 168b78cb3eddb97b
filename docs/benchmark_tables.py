"""The tables of the benchmark's page, out of a benchmark's folder.

    python docs/benchmark_tables.py DIR --into docs/generated/benchmark.md

puts them into the page, between two marks.
"""

from __future__ import annotations

import argparse
import json
import re
import shlex
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from swarm_envs.files import written_whole
from swarm_envs.training.scoreboard.board import FILE
from swarm_envs.training.scoreboard.standings import NOTE, standings

BEGIN, END = "<!-- results -->", "<!-- end -->"
"""Marks of the place for results in a page."""
_MARKED = re.compile(f"({BEGIN})(.*?)({END})", re.DOTALL)
_NOT_FLOWN = {"unsupported": "-", "failed": "failed"}


def success_rates(content: Mapping[str, Any], family: str) -> list[list[str]]:
    """Rows of the agents' success rates on a family's tasks, percent, a head first.

    Agents that support none of them are left out.
    """
    tasks = [task for task in content["tasks"] if task["task"] == family]
    cells = {(cell["task"], cell["agent"]): cell for cell in content["cells"]}
    rows = [["agent", *(_short(task["id"], family) for task in tasks)]]
    for agent in content["agents"]:
        row = [_rate(cells[task["id"], agent["name"]]) for task in tasks]
        if set(row) != {_NOT_FLOWN["unsupported"]}:
            rows.append([f"{agent['name']}{'*' if agent['privileged'] else ''}", *row])
    return rows


def _short(task_id: str, family: str) -> str:
    """A task's id without version, and without what the table's title or the other words say."""
    first, *words, _ = task_id.split("-")
    return " ".join(words if first in {family, "swap", "formation"} else [first, *words])


def _markdown(rows: Sequence[Sequence[str]]) -> list[str]:
    head, *others = (f"| {' | '.join(row)} |" for row in rows)
    lines = [head, "|" + "---|" * len(rows[0]), *others]
    return [line.replace("*", "\\*") for line in lines]


def _rate(cell: Mapping[str, Any]) -> str:
    if cell["status"] != "flown":
        return _NOT_FLOWN[cell["status"]]
    return f"{100.0 * cell['values']['success_rate']['value']:.0f}"


def results_text(content: Mapping[str, Any]) -> str:
    """What was run, and all tables as Markdown, each after the name of what it shows."""
    manifest, flown = content["manifest"], sum(cell["episodes"] for cell in content["cells"])
    machine, minutes = manifest["machine"], manifest["cpu_s"] / 60.0
    words = shlex.split(manifest["command"])
    words = ["board" if before == "--out" else word for before, word in zip(["", *words], words)]
    parts = [
        f"`{shlex.join(words)}`: {flown:,} episodes, {minutes:.0f} CPU minutes on "
        f"{machine['cores']} processors ({machine['cpu']}), swarm-envs "
        f"{manifest['versions']['swarm_envs']}. {NOTE[0].replace('*', chr(92) + '*')}{NOTE[1:]}."
    ]
    parts.append("Score [95 % interval]\n\n" + "\n".join(_markdown(standings(content))))
    for family in content["aggregates"]:
        rows = _markdown(success_rates(content, family))
        parts.append(f"Success in {family}, % of episodes\n\n" + "\n".join(rows))
    return "\n\n".join(parts)


def put_into(page: str, text: str) -> str:
    """A page with a text between its marks `<!-- results -->` and `<!-- end -->`."""
    new, count = _MARKED.subn(lambda found: f"{found[1]}\n{text}\n{found[3]}", page)
    if count != 1:
        raise ValueError(
            f"the page must have one {BEGIN!r} and one {END!r}, to put results between"
        )
    return new


def update_page(arguments: Sequence[str] | None = None) -> None:
    """Put a benchmark's tables into a page."""
    parser = argparse.ArgumentParser(
        description="A scoreboard in a few tables of text, for terminals and for pages."
    )
    parser.add_argument("folder", type=Path, help="of a benchmark")
    parser.add_argument("--into", type=Path, required=True, help="page with the marks")
    options = parser.parse_args(arguments)
    content = json.loads((options.folder / FILE).read_text(encoding="utf-8"))
    text = put_into(options.into.read_text(encoding="utf-8"), results_text(content))
    with written_whole(options.into) as partial:
        partial.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    update_page()
