"""The page: every item with the paper's values, results, reasons, pictures and commands."""

from __future__ import annotations

import base64
from collections import Counter
from collections.abc import Iterator, Sequence
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING

from swarm_envs.training.reproduce.claims import Agreement, Claim, format_quantity
from swarm_envs.training.reproduce.papers import PAPERS

if TYPE_CHECKING:
    from swarm_envs.training.reproduce.reproduce_all import StudyOutcome

_STYLE = Path(__file__).with_name("page") / "side_by_side.css"
_HEADS = ("quantity", "paper", "result", "agrees if", "difference")
_SAID: dict[Agreement, str] = {
    "agrees": "agrees",
    "explained": "differs, explained",
    "unexplained": "differs, unexplained",
    "ours alone": "nothing to compare",
}
_COUNTED: dict[Agreement, str] = {
    "agrees": "agree",
    "explained": "differ for a known reason",
    "unexplained": "differ, unexplained",
    "ours alone": "have nothing to be compared with",
}


def html_page(outcomes: Sequence[StudyOutcome], about: Sequence[str], out: Path) -> str:
    """The page as HTML that needs nothing else: lines `about` it, pictures from folder `out`."""
    by_paper: dict[str, list[StudyOutcome]] = {}
    for outcome in outcomes:
        by_paper.setdefault(outcome.study.paper, []).append(outcome)
    parts = [
        "<!DOCTYPE html>",
        '<html lang="en"><head><meta charset="utf-8">',
        '<meta name="viewport" content="width=device-width, initial-scale=1">',
        '<link rel="icon" href="data:,">',
        "<title>Three papers, side by side</title><style>",
        f"{_STYLE.read_text('utf-8')}</style></head><body>",
        "<h1>Three papers, side by side</h1>",
        *(f"<p>{_text(line)}</p>" for line in about),
        *_summary(outcomes),
    ]
    for paper, own in by_paper.items():
        parts.append(f'<h2 id="{escape(paper)}">{escape(PAPERS[paper].title)}</h2>')
        links = list[str]()
        for outcome in own:
            soft = "" if outcome.state == "done" else ' class="soft"'
            label = escape(outcome.study.label)
            links.append(f'<a{soft} href="#{escape(_anchor(outcome))}">{label}</a>')
        parts.append(f"<nav>{''.join(links)}</nav>")
        parts += [part for outcome in own for part in _item(outcome, out)]
    return "\n".join([*parts, "</body></html>", ""])


def _text(line: str) -> str:
    """A line with what stands between backquotes as code."""
    pieces = escape(line).split("`")
    return "".join(f"<code>{piece}</code>" if k % 2 else piece for k, piece in enumerate(pieces))


def _summary(outcomes: Sequence[StudyOutcome]) -> Iterator[str]:
    states = Counter(outcome.state for outcome in outcomes)
    yield "<p>Items: " + ", ".join(f"{count} {state}" for state, count in states.items()) + ".</p>"
    yield from (f"<p>{escape(line)}</p>" for line in _count(outcomes))
    failed = [outcome for outcome in outcomes if outcome.state == "failed"]
    for outcome in failed:
        yield (
            f'<p class="failed">Failed: <a href="#{escape(_anchor(outcome))}">'
            f"{escape(outcome.study.key)}</a>: {escape(outcome.error)}</p>"
        )


def _anchor(outcome: StudyOutcome) -> str:
    return outcome.study.key.replace("/", "-")


def _item(outcome: StudyOutcome, out: Path) -> Iterator[str]:
    study = outcome.study
    yield f'<section class="item" id="{escape(_anchor(outcome))}">'
    yield f"<h3>{escape(study.label)}: {_text(study.shows)}</h3>"
    if study.missing:
        yield f'<p class="soft">Not reproduced: {_text(study.missing)}.</p>'
    elif outcome.state == "failed":
        yield f'<p class="failed">Failed: {escape(outcome.error)}</p>'
    elif outcome.state == "not run":
        yield '<p class="soft">Not run yet.</p>'
    if study.note:
        yield f'<p class="soft">{_text(study.note)}</p>'
    if outcome.claims:
        yield from _table(outcome.claims)
    if outcome.state == "done":
        for name in study.pictures:
            data = base64.b64encode((out / study.key / name).read_bytes()).decode("ascii")
            says = f'alt="{escape(study.label)}, swarm-envs"'
            yield f'<img loading="lazy" {says} src="data:image/png;base64,{data}">'
    if outcome.commands:
        spent = f", {outcome.cpu_s:.0f} s of CPU time" if outcome.state == "done" else ""
        lines = "\n".join(escape(command) for command in outcome.commands)
        yield f"<details open><summary>Reproduced by{spent}</summary><pre>{lines}</pre></details>"
    yield "</section>"


def _table(claims: Sequence[Claim]) -> Iterator[str]:
    heads = "".join(f"<th>{escape(head)}</th>" for head in _HEADS)
    yield f"<table><thead><tr>{heads}</tr></thead><tbody>"
    for claim in claims:
        looks = ["", *["number"] * 3, claim.agreement.replace(" ", "-")]
        cells = [
            f'<td data-name="{escape(name)}" class="{look}">{_text(text)}</td>'
            for name, text, look in zip(_HEADS, _cells(claim), looks, strict=True)
        ]
        cells[0] = f"<td>{_text(claim.quantity)}</td>"
        yield f"<tr>{''.join(cells)}</tr>"
    yield "</tbody></table>"


def _cells(claim: Claim) -> tuple[str, str, str, str, str]:
    """A claim as text: quantity, paper, result with its spread, tolerance, difference."""
    ours = format_quantity(claim.ours)
    if claim.spread is not None:
        low, high = map(format_quantity, claim.spread)
        ours += f" ({low} to {high}, {claim.spread_is})"
    said = _SAID[claim.agreement] + (f": {claim.reason.text}" if claim.reason else "")
    return claim.quantity, claim.paper, ours, str(claim.agrees or ""), said


def markdown_page(outcomes: Sequence[StudyOutcome], about: Sequence[str]) -> str:
    """The same numbers as a page in Markdown, without pictures and commands."""
    head = [line for paragraph in about for line in (paragraph, "")]
    lines = ["# Side by side", "", *head, *_count(outcomes), ""]
    lines += ["| item | quantity | paper | result | difference |", "|---|---|---|---|---|"]
    for outcome in outcomes:
        study = outcome.study
        key = f"{study.paper}, {study.label}"
        if not outcome.claims:
            said = outcome.error or outcome.state
            said = f"not reproduced: {study.missing}" if study.missing else said
            lines.append(_line((key, study.shows, "", "", said)))
        for claim in outcome.claims:
            quantity, paper, ours, _, said = _cells(claim)
            lines.append(_line((key, quantity, paper, ours, said)))
            key = ""
    return "\n".join([*lines, ""])


def _count(outcomes: Sequence[StudyOutcome]) -> Iterator[str]:
    """How many numbers agree, in a sentence; nothing if there are none."""
    found = Counter(claim.agreement for outcome in outcomes for claim in outcome.claims)
    said = [f"{found[kind]} {says}" for kind, says in _COUNTED.items() if found[kind]]
    if said:
        yield f"Of {found.total()} numbers {', '.join(said)}."


def _line(cells: Sequence[str]) -> str:
    return f"| {' | '.join(cell.replace('|', '&#124;') for cell in cells)} |"
