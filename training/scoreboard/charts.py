"""The charts of the scoreboard's page: performance profiles, and score over compute.

Matplotlib draws them as SVG in the page. They need no JavaScript and have the page's
own colours, light or dark. What belongs to an agent is in groups with its name, so that a script
can bring it out.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Sequence
from io import StringIO
from typing import Any, NamedTuple
from xml.etree.ElementTree import Element, fromstring

import matplotlib as mpl
import numpy as np
from matplotlib.artist import Artist
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.markers import MarkerStyle
from matplotlib.ticker import LogLocator
from matplotlib.transforms import Bbox

from swarm_envs.training.scoreboard.board import Board, Interval, TaskInfo
from swarm_envs.training.scoreboard.markup import format_micros, format_value, tag

WIDTH, HEIGHT = 400, 280
"""Of a chart, in units of which its text is 12 high."""
FRAME = (0.13, 0.145, 0.815, 0.82)
"""Left, bottom, width and height of its axes, as shares of that."""
_MARKERS, _OTHER = "osD^vP*X", "."
"""Shapes, so that nobody needs colours to tell agents apart; and of agents without a colour."""
_DASHES = ("-", (0, (3.5, 1.5)), (0, (1, 1.25)), (0, (4.5, 1.5, 1, 1.5)))
_OWN, _QUIET, _LINE, _PAPER = "#010101", "#020202", "#030303", "#040404"
_THEME = {
    _OWN: "var(--own)",
    _QUIET: "var(--quiet)",
    _LINE: "var(--line)",
    _PAPER: "var(--paper)",
}
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
_LONGEST = 22
"""Characters of a name in a chart; it stands in full in the legend."""
_PLACES = [
    (right, up, side)
    for up in (0, 12, -13, 26, -27)
    for right, side in ((-8, "right"), (8, "left"), (0, "center"))
]
"""Where a name may stand, points from its mark: left, right, above, below; then farther off."""
_TIMES = ("act_us_p50", "act_us_p99")
"""The metrics of compute."""

Palette = dict[str, int]
"""Number of each agent's colour and marker, if it has one: the same all over the page."""


class ComputePoint(NamedTuple):
    """An agent in a chart of score over compute."""

    agent: str
    """Its name."""
    micros: float
    """Of a median decision."""
    slow: float
    """Of a decision at the 99th percentile, microseconds."""
    score: float
    """In [0, 1]."""
    interval: Interval | None
    """Of the score."""


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


class _Chart:
    """Axes of shares in per cent, and what is drawn in them for each agent."""

    def __init__(self, board: Board, colors: Palette, x_label: str, y_label: str) -> None:
        self.colors = colors
        self.labels = {name: agent["label"] for name, agent in board.agents.items()}
        self._groups: dict[str, tuple[str, str, str]] = {}
        self.figure = Figure(figsize=(WIDTH / 72, HEIGHT / 72), dpi=72, frameon=False)
        FigureCanvasAgg(self.figure)  # knows how large a text is
        self.axes = self.figure.add_axes(FRAME, frameon=False)
        self.axes.grid(axis="y")
        shares = (0.0, 0.25, 0.5, 0.75, 1.0)
        self.axes.set_yticks(shares, [f"{100 * share:.0f}" for share in shares])
        self.axes.set(xlabel=x_label, ylabel=y_label)

    def behind_first(self, names: Iterable[str]) -> list[str]:
        """The agents in the order in which they are drawn: those with the first colours last."""
        return sorted(names, key=lambda name: -self.colors.get(name, len(self.colors)))

    def belongs(self, artist: Artist, kind: str, name: str, title: str = "") -> None:
        """Say whose a part of the drawing is; the title is shown to whoever points at it."""
        key = f"{kind}-{len(self._groups)}"
        artist.set_gid(key)
        self._groups[key] = f"{kind} {color_class(self.colors, name)}", name, title

    def element(self, label: str) -> Element:
        """The drawing; the label says what it shows to whoever cannot see it."""
        file = StringIO()
        self.figure.savefig(file, format="svg")
        drawn = fromstring(file.getvalue())
        for each in drawn.iter():
            self._adopt(each)
        content = [each for each in drawn if each.tag == "g"]
        size = f"0 0 {WIDTH} {HEIGHT}"
        return tag("svg", content, viewBox=size, role="img", aria_label=label)

    def _adopt(self, element: Element) -> None:
        """Make an element of the drawing one of the page: without namespaces, in its colours."""
        given = {key.rpartition("}")[2]: value for key, value in element.attrib.items()}
        given.pop("clip-path", None)  # nothing is drawn outside of the axes
        if "d" in given:
            given["d"] = re.sub(r"(\.\d\d)\d+", r"\1", " ".join(given["d"].split()))
        for color, variable in _THEME.items():
            if "style" in given:
                given["style"] = given["style"].replace(color, variable)
        element.tag = element.tag.rpartition("}")[2]
        if element.tag == "g":
            kind, name, title = self._groups.get(given.pop("id", ""), ("", "", ""))
            if kind:
                given |= {"class": kind, "data-agent": name}
            if title:
                element.insert(0, tag("title", title))
        element.attrib.clear()
        element.attrib.update(given)


def profile_chart(board: Board, colors: Palette, family: str) -> Element:
    """How many of a family's runs reach each score, a line an agent."""
    profile, label = board.profiles[family], f"Performance profiles, {family}"
    with mpl.rc_context({**_STYLE, "svg.hashsalt": label}):
        chart = _Chart(board, colors, profile["label"], "runs that reach it, %")
        chart.axes.set(xlim=(profile["thresholds"][0], profile["thresholds"][-1]), ylim=(0.0, 1.0))
        for name in chart.behind_first(profile["agents"]):
            curve, x = profile["agents"][name], profile["thresholds"]
            around = [*curve["high"], *curve["low"][::-1]]
            (band,) = chart.axes.fill([*x, *x[::-1]], around, color=_OWN, alpha=0.14, linewidth=0)
            chart.belongs(band, "band", name)
            dashes = _DASHES[colors.get(name, 0) % len(_DASHES)]
            (line,) = chart.axes.plot(x, curve["fraction"], color=_OWN, linestyle=dashes)
            chart.belongs(line, "line", name, chart.labels[name])
        return chart.element(label)


def family_points(board: Board, family: str) -> list[ComputePoint]:
    """A family's agents: the score of the leaderboard, and the geometric mean of their times."""
    tasks = [task.id for task in board.tasks if task.task == family]
    points = []
    for name in board.ranked(family):
        times = [_times(board, task, name) for task in tasks]
        known = [pair for pair in times if pair is not None]
        if known:
            standing = board.aggregates[family][name]
            middle, slow = (math.exp(sum(map(math.log, each)) / len(each)) for each in zip(*known))
            score, interval = standing["value"], standing.get("interval")
            points.append(ComputePoint(name, middle, slow, score, interval))
    return points


def task_points(board: Board, task: TaskInfo) -> list[ComputePoint]:
    """The agents that flew a task: their success rate and their times."""
    points = []
    for name in board.agents:
        times = _times(board, task.id, name)
        cell = board.pairs.get((task.id, name))
        success = cell["values"].get("success_rate") if cell is not None else None
        if times is not None and success is not None and success["value"] is not None:
            score, interval = success["value"], success.get("interval")
            points.append(ComputePoint(name, *times, score, interval))
    return points


def _times(board: Board, task: str, agent: str) -> tuple[float, float] | None:
    """Median and 99th percentile, microseconds, if they were taken."""
    cell = board.pairs.get((task, agent))
    if cell is None:
        return None
    median, slow = (cell["values"].get(name, {}).get("value") for name in _TIMES)
    return (median, slow) if median and slow and min(median, slow) > 0.0 else None


def compute_chart(
    board: Board, colors: Palette, points: Sequence[ComputePoint], label: str, y_label: str
) -> Element:
    """Score over compute: up is better, left is cheaper. Whiskers: the interval, and the p99."""
    with mpl.rc_context({**_STYLE, "svg.hashsalt": label}):
        chart = _Chart(board, colors, "one decision of the team, median", y_label)
        low, high = min(p.micros for p in points), max(p.slow for p in points)
        first, last = math.floor(math.log10(low)), math.ceil(math.log10(high))
        chart.axes.set(xscale="log", ylim=(-0.04, 1.04))
        chart.axes.set_xlim(10.0**first, 10.0 ** max(last, first + 1))
        chart.axes.xaxis.set_major_locator(LogLocator(numticks=7))
        chart.axes.xaxis.set_major_formatter(lambda power, _: format_micros(power))
        chart.axes.minorticks_off()
        by_name = {point.agent: point for point in points}
        for name in chart.behind_first(by_name):
            _draw_point(chart, by_name[name])
        _name_points(chart, points)
        return chart.element(label)


def _draw_point(chart: _Chart, point: ComputePoint) -> None:
    x, y, name = point.micros, point.score, point.agent
    low, high = point.interval or (y, y)
    whiskers = [x, point.slow, math.nan, x, x], [y, y, math.nan, low, high]
    (line,) = chart.axes.plot(*whiskers, color=_OWN, linewidth=1.4, alpha=0.5)
    chart.belongs(line, "whisker", name)
    marker, size = _marker(chart.colors, name), 9 if name in chart.colors else 8
    (mark,) = chart.axes.plot(
        [x], [y], marker, color=_OWN, markersize=size, markeredgecolor=_PAPER, markeredgewidth=1
    )
    said = f"{chart.labels[name]}: {format_value(y, '%')} %, {format_micros(x)}"
    chart.belongs(mark, "mark", name, f"{said} (p99 {format_micros(point.slow)})")


def _name_points(chart: _Chart, points: Sequence[ComputePoint]) -> None:
    taken = [box for point in points for box in _boxes(chart, point)]
    inside = chart.axes.bbox
    for point in points:
        if point.agent not in chart.colors:
            continue
        full = chart.labels[point.agent]
        text = full if len(full) <= _LONGEST else full[: _LONGEST - 1] + "…"
        for right, up, side in _PLACES:
            name = chart.axes.annotate(
                text, (point.micros, point.score), (right, up),
                textcoords="offset points", ha=side, va="center", fontsize=11.5, color=_OWN,
            )  # fmt: skip
            box = name.get_window_extent()
            within = inside.x0 < box.x0 and box.x1 < inside.x1 and inside.y0 < box.y0
            if within and box.y1 < HEIGHT and not box.count_overlaps(taken):
                taken.append(box)
                chart.belongs(name, "name", point.agent)
                break
            name.remove()


def _boxes(chart: _Chart, point: ComputePoint) -> list[Bbox]:
    """What a mark and its whiskers take, in points from the left and from below."""
    low, high = point.interval or (point.score, point.score)
    places = [(point.micros, point.score), (point.slow, low), (point.micros, high)]
    (x, y), (slow, bottom), (_, top) = chart.axes.transData.transform(places)
    ends = (x - 5, y - 5, x + 5, y + 5), (x, y - 1, slow, y + 1), (x - 1, bottom, x + 1, top)
    return [Bbox.from_extents(*each) for each in ends]
