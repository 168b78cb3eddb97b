"""One colour and one mark an agent, the same all over the page."""

from __future__ import annotations

from xml.etree.ElementTree import Element

from swarm_envs.training.scoreboard.axes import MARKS, OTHER_MARK
from swarm_envs.training.scoreboard.board import Board
from swarm_envs.training.scoreboard.markup import tag

COUNT = len(MARKS)
"""Agents that have a colour: as many as people tell apart."""

Palette = dict[str, int]
"""Number of each agent's colour, if it has one."""


def ranked(board: Board, family: str) -> list[str]:
    """A family's agents, the best first."""
    standings = board.standings.get(family, {})
    return sorted(standings, key=lambda name: -standings[name].value)


def palette(board: Board) -> Palette:
    """Colours for the best of each family in turn, until there are no more."""
    orders = [ranked(board, family) for family in board.families]
    turns = [order[k] for k in range(len(board.agents)) for order in orders if k < len(order)]
    return {name: k for k, name in enumerate([*dict.fromkeys(turns)][:COUNT])}


def color_class(colors: Palette, name: str) -> str:
    """The class that gives an element its agent's colour."""
    return f"c{colors[name]}" if name in colors else "cx"


def mark(colors: Palette, name: str, x: float, y: float, title: str = "") -> Element:
    """An agent's mark in a plot."""
    shape = MARKS[colors[name]] if name in colors else OTHER_MARK
    place = f"translate({x:.1f} {y:.1f})"
    return tag("path", tag("title", title) if title else None, d=shape, transform=place)


def swatch(colors: Palette, name: str) -> Element:
    """An agent's mark beside its name in a text."""
    drawn = mark(colors, name, 7, 7)
    of = color_class(colors, name)
    return tag("svg", drawn, viewBox="0 0 14 14", class_=f"swatch {of}", aria_hidden="true")


def legend(board: Board, colors: Palette) -> Element:
    """All agents of the plots; a script makes each a switch that brings it out."""
    shown = {name for family in board.families for name in ranked(board, family)}
    names = [*colors, *(a.name for a in board.agents if a.name in shown and a.name not in colors)]
    labels = {agent.name: agent.label for agent in board.agents}
    entries = [
        tag("li", tag("span", swatch(colors, name), labels[name], data_key=name)) for name in names
    ]
    return tag("ul", entries, class_="legend")
