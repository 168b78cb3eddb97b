"""The scoreboard as one HTML page that needs no server and no network.

It is whole without JavaScript: the script only sorts, filters, and puts one metric in the place
of another, out of numbers that stand in the page. A policy in its head forbids it to fetch
anything, and any script but its own to run.
"""

from __future__ import annotations

import base64
import hashlib
import re
from html import escape
from importlib import resources
from pathlib import Path
from xml.etree.ElementTree import Element

from swarm_envs.files import written_whole
from swarm_envs.training.scoreboard import plots, sections
from swarm_envs.training.scoreboard.board import Board
from swarm_envs.training.scoreboard.colors import Palette, legend, palette
from swarm_envs.training.scoreboard.markup import html, tag
from swarm_envs.training.scoreboard.reading import read
from swarm_envs.training.scoreboard.tables import Linked, Rows, every_number, matrix, short_label

FILE = "report.html"
"""The page's name in a scoreboard's folder."""


def write(folder: Path) -> Path:
    """Write the page of a scoreboard's folder, whole or not at all.

    Args:
        folder: holds `scores.json`; replays that it names are linked if they are there.

    Returns:
        The page.

    Raises:
        FileNotFoundError: there is no `scores.json`.
        ValueError: it is of another format or version, or damaged; the message says where.
        OSError: the page cannot be written.
    """
    text = page(read(folder), lambda file: (folder / file).is_file())
    with written_whole(folder / FILE) as partial:
        partial.write_text(text, encoding="utf-8")
    return folder / FILE


def page(board: Board, linked: Linked) -> str:
    """The page as text.

    Args:
        board: what it shows.
        linked: whether a replay's page is there.
    """
    colors, rows, script = palette(board), Rows(board, linked), _asset("report.js")
    texts = {
        "title": "swarm-envs scoreboard",
        "script_hash": base64.b64encode(hashlib.sha256(script.encode()).digest()).decode(),
        "css": _asset("report.css"),
        "script": script,
        "summary": escape(sections.summary(board)),
        "facts": html(sections.facts(board)),
        "leaderboards": html(sections.leaderboards(board, colors)),
        "families": html(_options(board)),
        "metrics": html([tag("option", m.label, value=m.name) for m in board.metrics]),
        "matrix": html(matrix(rows)),
        "not_flown": html(sections.not_flown(board)),
        "legend": html(legend(board, colors)),
        "profiles": html(_profiles(board, colors)),
        "compute": html(_compute(board, colors)),
        "numbers": html(every_number(rows)),
        "reproduce": html(sections.reproduce(board)),
        "glossary": html(sections.glossary(board)),
    }
    return re.sub(r"\{\{(\w+)\}\}", lambda found: texts[found[1]], _asset("report.html"))


def _options(board: Board) -> list[Element]:
    return [tag("option", family, value=family) for family in board.families]


def _profiles(board: Board, colors: Palette) -> list[Element]:
    families = [family for family in board.families if family in board.profiles]
    return [_figure(family, plots.profile(board, colors, family)) for family in families]


def _compute(board: Board, colors: Palette) -> list[Element]:
    """A plot for each family, and behind a fold one for each task."""
    figures, single = [], []
    for family in board.families:
        points = plots.family_points(board, family)
        if points:
            drawn = plots.scatter(
                board, colors, points, f"Score over compute, {family}", "score, %"
            )
            figures.append(_figure(family, drawn))
    for task in board.tasks:
        points = plots.task_points(board, task)
        if points:
            name = f"{task.family} {short_label(task)}"
            said = f"Success over compute, {name}"
            single.append(_figure(name, plots.scatter(board, colors, points, said, "success, %")))
    fold = tag("summary", "Task by task: success rate"), tag("div", single, class_="cards")
    return [tag("div", figures, class_="cards"), tag("details", *fold)]


def _figure(name: str, drawn: Element) -> Element:
    return tag("figure", tag("figcaption", name), drawn)


def _asset(name: str) -> str:
    folder = resources.files("swarm_envs.training.scoreboard").joinpath("page")
    return folder.joinpath(name).read_text(encoding="utf-8")
