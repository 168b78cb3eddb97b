"""A scoreboard in a few tables of text, for terminals and for pages.

    python -m swarm_envs.training.scoreboard.standings DIR --into docs/benchmark.md

puts those of a benchmark's folder into a page, between two marks.
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
    lines = [head, "|" + "---|" * len(rows[0]), *others]
    return [line.replace("*", "\\*") for line in lines]


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


def told(content: Mapping[str, Any]) -> str:
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
    parts.append("Score [95 % interval]\n\n" + "\n".join(markdown(standings(content))))
    for family in content["aggregates"]:
        rows = markdown(success_rates(content, family))
        parts.append(f"Success in {family}, % of episodes\n\n" + "\n".join(rows))
    return "\n\n".join(parts)


def put_into(page: str, text: str) -> str:
    """A page with a text between its marks `<!-- results -->` and `<!-- end -->`.

    Raises:
        ValueError: it has no such marks.
    """
    new, count = _MARKED.subn(lambda found: f"{found[1]}\n{text}\n{found[3]}", page)
    if count != 1:
        raise ValueError(
            f"the page must have one {BEGIN!r} and one {END!r}, to put results between"
        )
    return new


BEGIN, END = "<!-- results -->", "<!-- end -->"
"""Marks of the place for results in a page."""
_MARKED = re.compile(f"({BEGIN})(.*?)({END})", re.DOTALL)


def main(arguments: Sequence[str] | None = None) -> None:
    """Put a benchmark's tables into a page."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path, help="of a benchmark")
    parser.add_argument("--into", type=Path, required=True, help="page with the marks")
    options = parser.parse_args(arguments)
    content = json.loads((options.folder / "scores.json").read_text(encoding="utf-8"))
    text = put_into(options.into.read_text(encoding="utf-8"), told(content))
    with written_whole(options.into) as partial:
        partial.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
