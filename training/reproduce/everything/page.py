"""The page: every item with the paper's values, ours, the reason, our pictures, the command."""

from __future__ import annotations

import base64
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from html import escape
from pathlib import Path
from typing import Any

from swarm_envs.training.reproduce.everything.look import STYLE
from swarm_envs.training.reproduce.everything.registry import TITLES
from swarm_envs.training.reproduce.everything.rows import Row, Verdict, number
from swarm_envs.training.reproduce.everything.runner import Outcome

_HEADS = ("quantity", "paper", "ours", "agrees if", "difference")
_VERDICTS: Mapping[Verdict, str] = {
    "agrees": "agrees",
    "explained": "differs, explained",
    "unexplained": "differs, unexplained",
    "ours alone": "nothing to compare",
}


def page(outcomes: Sequence[Outcome], about: Sequence[str], out: Path) -> str:
    """The whole page as HTML that asks for nothing outside itself.

    Args:
        outcomes: of every item, in the order of the page.
        about: lines that stand at the top.
        out: folder of the run; pictures of finished items are taken from there.
    """
    by_paper: dict[str, list[Outcome]] = {}
    for outcome in outcomes:
        by_paper.setdefault(outcome.item.paper, []).append(outcome)
    parts = [
        "<!DOCTYPE html>",
        '<html lang="en"><head><meta charset="utf-8">',
        '<meta name="viewport" content="width=device-width, initial-scale=1">',
        '<link rel="icon" href="data:,">',
        f"<title>Three papers, side by side</title><style>{STYLE}</style></head><body>",
        "<h1>Three papers, side by side</h1>",
        *(f"<p>{_text(line)}</p>" for line in about),
        *_summary(outcomes),
    ]
    for paper, own in by_paper.items():
        parts.append(f'<h2 id="{escape(paper)}">{escape(TITLES.get(paper, paper))}</h2>')
        parts.append(f"<nav>{''.join(_links(own))}</nav>")
        parts += [part for outcome in own for part in _item(outcome, out)]
    return "\n".join([*parts, "</body></html>", ""])


def _text(line: str) -> str:
    """A line with what stands between backquotes as code."""
    pieces = escape(line).split("`")
    return "".join(f"<code>{piece}</code>" if k % 2 else piece for k, piece in enumerate(pieces))


def _summary(outcomes: Sequence[Outcome]) -> Iterator[str]:
    states = Counter(outcome.state for outcome in outcomes)
    verdicts = Counter(row.verdict for outcome in outcomes for row in outcome.rows)
    yield "<p>Items: " + ", ".join(f"{count} {state}" for state, count in states.items()) + ".</p>"
    if verdicts:
        said = (
            f'<span class="{_css(verdict)}">{verdicts[verdict]} {_VERDICTS[verdict]}</span>'
            for verdict in _VERDICTS
            if verdict in verdicts
        )
        yield f"<p>Numbers: {', '.join(said)}.</p>"
    failed = [outcome for outcome in outcomes if outcome.state == "failed"]
    for outcome in failed:
        yield (
            f'<p class="failed">Failed: <a href="#{escape(_anchor(outcome))}">'
            f"{escape(outcome.item.key)}</a>: {escape(outcome.error)}</p>"
        )


def _anchor(outcome: Outcome) -> str:
    return outcome.item.key.replace("/", "-")


def _css(verdict: str) -> str:
    return verdict.replace(" ", "-")


def _links(outcomes: Sequence[Outcome]) -> Iterator[str]:
    for outcome in outcomes:
        soft = "" if outcome.state == "done" else ' class="soft"'
        label = escape(outcome.item.label)
        yield f'<a{soft} href="#{escape(_anchor(outcome))}">{label}</a>'


def _item(outcome: Outcome, out: Path) -> Iterator[str]:
    item = outcome.item
    yield f'<section class="item" id="{escape(_anchor(outcome))}">'
    yield f"<h3>{escape(item.label)}: {_text(item.shows)}</h3>"
    if item.missing:
        yield f'<p class="soft">Not remade: {_text(item.missing)}.</p>'
    elif outcome.state == "failed":
        yield f'<p class="failed">Failed: {escape(outcome.error)}</p>'
    elif outcome.state == "not run":
        yield '<p class="soft">Not run yet.</p>'
    if item.note:
        yield f'<p class="soft">{_text(item.note)}</p>'
    if outcome.rows:
        yield from _table(outcome.rows)
    if outcome.state == "done":
        for name in item.pictures:
            yield _picture(out / item.key / name, f"{item.label}, ours")
    if outcome.commands:
        spent = f", {outcome.cpu_s:.0f} s of CPU time" if outcome.state == "done" else ""
        lines = "\n".join(escape(command) for command in outcome.commands)
        yield f"<details open><summary>Remade by{spent}</summary><pre>{lines}</pre></details>"
    yield "</section>"


def _picture(path: Path, says: str) -> str:
    data = base64.b64encode(path.read_bytes()).decode("ascii")
    return f'<img loading="lazy" alt="{escape(says)}" src="data:image/png;base64,{data}">'


def _table(rows: Sequence[Row]) -> Iterator[str]:
    heads = "".join(f"<th>{escape(head)}</th>" for head in _HEADS)
    yield f"<table><thead><tr>{heads}</tr></thead><tbody>"
    for row in rows:
        cells = dict(zip(_HEADS, cells_of(row), strict=True))
        yield "<tr>" + "".join(_cell(name, text, row) for name, text in cells.items()) + "</tr>"
    yield "</tbody></table>"


def _cell(name: str, text: str, row: Row) -> str:
    if name == "quantity":
        return f"<td>{_text(text)}</td>"
    look = f' class="{_css(row.verdict)}"' if name == "difference" else ' class="number"'
    return f'<td data-name="{escape(name)}"{look}>{_text(text)}</td>'


def cells_of(row: Row) -> tuple[str, str, str, str, str]:
    """A row as text: quantity, the paper's, ours with its spread, tolerance, what it comes to."""
    ours = number(row.ours)
    if row.spread is not None:
        ours += f" ({number(row.spread[0])} to {number(row.spread[1])}, {row.spread_is})"
    said = _VERDICTS[row.verdict] + (f": {row.reason.text}" if row.reason else "")
    return row.quantity, row.paper, ours, str(row.agrees or ""), said


def markdown(outcomes: Sequence[Outcome]) -> str:
    """The same numbers as a table in Markdown, without pictures and commands."""
    lines = ["| item | quantity | paper | ours | difference |", "|---|---|---|---|---|"]
    for outcome in outcomes:
        item = outcome.item
        key = f"{item.paper}, {item.label}"
        if not outcome.rows:
            said = f"not remade: {item.missing}" if item.missing else outcome.error or outcome.state
            lines.append(_line((key, item.shows, "", "", said)))
        for row in outcome.rows:
            quantity, paper, ours, _, said = cells_of(row)
            lines.append(_line((key, quantity, paper, ours, said)))
            key = ""
    return "\n".join([*lines, ""])


def _line(cells: Sequence[str]) -> str:
    return f"| {' | '.join(cell.replace('|', '&#124;') for cell in cells)} |"


def results(outcomes: Sequence[Outcome], settings: Mapping[str, object]) -> dict[str, Any]:
    """Everything, ready for JSON."""
    return {**settings, "items": [outcome.as_json() for outcome in outcomes]}
