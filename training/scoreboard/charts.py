"""The charts of the scoreboard's page: performance profiles.

Matplotlib draws them as SVG in the page. They need no JavaScript and have the page's
own colours, light or dark. What belongs to an agent is in groups with its name, so that a script
can bring it out.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from io import StringIO
from typing import Any
from xml.etree.ElementTree import Element, fromstring

import matplotlib as mpl
import numpy as np
from matplotlib.artist import Artist
from matplotlib.figure import Figure
from matplotlib.markers import MarkerStyle

from swarm_envs.training.scoreboard.board import Board
from swarm_envs.training.scoreboard.markup import tag

WIDTH, HEIGHT = 400, 280
"""Of a chart, in units of which its text is 12 high."""
FRAME = (0.13, 0.145, 0.815, 0.82)  # Left, bottom, width and height of its axes, as shares of that
_MARKERS, _OTHER = "osD^vP*X", "."
"""Shapes, so that nobody needs colours to tell agents apart; and of agents without a colour."""
_DASHES = ("-", (0, (3.5, 1.5)), (0, (1, 1.25)), (0, (4.5, 1.5, 1, 1.5)))
_OWN, _QUIET, _LINE = "#010101", "#020202", "#030303"
_THEME = {_OWN: "var(--own)", _QUIET: "var(--quiet)", _LINE: "var(--line)"}
"""What stands for a colour in a drawing, and the style sheet's name of that colour."""
_STYLE: Any = {
    "font.size": 12,
    "font.sans-serif": ["DejaVu Sans"],
    "text.color": _QUIET,
    "text.parse_math": False,  # users choose names
    "axes.labelcolor": _QUIET,
    "axes.axisbelow": True,
    "xtick.color": _QUIET,
    "ytick.color": _QUIET,
    "ytick.major.size": 0,
    "grid.color": _LINE,
    "lines.linewidth": 2,
    "path.simplify": False,
    "svg.fonttype": "none",
}
Palette = dict[str, int]
"""Number of each agent's colour and marker, if it has one: the same all over the page."""


def palette(board: Board) -> Palette:
    """Colours for the best of each family in turn, as many as people tell apart."""
    orders = [board.ranked(family) for family in board.families]
    turns = [order[k] for k in range(len(board.agents)) for order in orders if k < len(order)]
    return {name: k for k, name in enumerate([*dict.fromkeys(turns)][: len(_MARKERS)])}


def color_class(colors: Palette, name: str) -> str:
    """The class that gives an element its agent's colour."""
    return f"c{colors[name]}" if name in colors else "cx"


def swatch(colors: Palette, name: str) -> Element:
    """An agent's marker beside its name in a text."""
    style = MarkerStyle(_marker(colors, name))
    path = style.get_path().transformed(style.get_transform())
    outline = np.asarray(path.to_polygons()[0]).tolist()
    points = "L".join(f"{7 + 9 * x:.1f} {7 - 9 * y:.1f}" for x, y in outline)
    of = color_class(colors, name)
    drawn = tag("path", d=f"M{points}Z")
    return tag("svg", drawn, viewBox="0 0 14 14", class_=f"swatch {of}", aria_hidden="true")


def _marker(colors: Palette, name: str) -> str:
    return _MARKERS[colors[name]] if name in colors else _OTHER


def profile_chart(board: Board, colors: Palette, family: str) -> Element:
    """How many of a family's runs reach each score, a line an agent."""
    profile, label = board.profiles[family], f"Performance profiles, {family}"
    groups: dict[str, tuple[str, str, str]] = {}

    def belongs(artist: Artist, kind: str, name: str, title: str = "") -> None:
        """Say whose a part of the drawing is; the title is shown to whoever points at it."""
        artist.set_gid(key := f"{kind}-{len(groups)}")
        groups[key] = f"{kind} {color_class(colors, name)}", name, title

    with mpl.rc_context({**_STYLE, "svg.hashsalt": label}):
        figure = Figure(figsize=(WIDTH / 72, HEIGHT / 72), dpi=72, frameon=False)
        axes = figure.add_axes(FRAME, frameon=False)
        axes.grid(axis="y")
        shares, x = (0.0, 0.25, 0.5, 0.75, 1.0), profile["thresholds"]
        axes.set_yticks(shares, [f"{100 * share:.0f}" for share in shares])
        axes.set(xlabel=profile["label"], ylabel="runs that reach it, %")
        axes.set(xlim=(x[0], x[-1]), ylim=(0.0, 1.0))
        # Those with the first colours are drawn last, above the others.
        for name in sorted(profile["agents"], key=lambda name: -colors.get(name, len(colors))):
            curve = profile["agents"][name]
            around = [*curve["high"], *curve["low"][::-1]]
            (band,) = axes.fill([*x, *x[::-1]], around, color=_OWN, alpha=0.14, linewidth=0)
            belongs(band, "band", name)
            dashes = _DASHES[colors.get(name, 0) % len(_DASHES)]
            (line,) = axes.plot(x, curve["fraction"], color=_OWN, linestyle=dashes)
            belongs(line, "line", name, board.agents[name]["label"])
        file = StringIO()
        figure.savefig(file, format="svg")
    drawn = fromstring(file.getvalue())
    for each in drawn.iter():
        _adopt(each, groups)
    content = [each for each in drawn if each.tag == "g"]
    return tag("svg", content, viewBox=f"0 0 {WIDTH} {HEIGHT}", role="img", aria_label=label)


def _adopt(element: Element, groups: Mapping[str, tuple[str, str, str]]) -> None:
    """Make an element of a drawing one of the page: without namespaces, in its colours."""
    given = {key.rpartition("}")[2]: value for key, value in element.attrib.items()}
    given.pop("clip-path", None)  # nothing is drawn outside of the axes
    if "d" in given:
        given["d"] = re.sub(r"(\.\d\d)\d+", r"\1", " ".join(given["d"].split()))
    for color, variable in _THEME.items():
        if "style" in given:
            given["style"] = given["style"].replace(color, variable)
    element.tag = element.tag.rpartition("}")[2]
    if element.tag == "g":
        kind, name, title = groups.get(given.pop("id", ""), ("", "", ""))
        if kind:
            given |= {"class": kind, "data-agent": name}
        if title:
            element.insert(0, tag("title", title))
    element.attrib.clear()
    element.attrib.update(given)
