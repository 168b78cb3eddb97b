"""The plots of the scoreboard's page: performance profiles, and success over compute."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from xml.etree.ElementTree import Element

from swarm_envs.training.scoreboard.axes import Axes, decades, linear_ticks, plot
from swarm_envs.training.scoreboard.board import Board, Interval, Task
from swarm_envs.training.scoreboard.colors import Palette, color_class, mark, ranked
from swarm_envs.training.scoreboard.figures import micros, number
from swarm_envs.training.scoreboard.labels import Box, Label, placed
from swarm_envs.training.scoreboard.markup import tag

MEDIAN, SLOW = "act_us_p50", "act_us_p99"
"""The metrics of compute."""


@dataclass(frozen=True)
class Point:
    """An agent in a plot of success over compute."""

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


def profile(board: Board, colors: Palette, family: str) -> Element:
    """How many of a family's runs reach each score, a line an agent."""
    what = board.profiles[family]
    axes = Axes((what.thresholds[0], what.thresholds[-1]))
    labels = {agent.name: agent.label for agent in board.agents}
    lines = []
    behind_first = sorted(what.curves, key=lambda name: -colors.get(name, len(colors)))
    for name in behind_first:
        curve, x = what.curves[name], what.thresholds
        band = tag("path", d=axes.area(x, curve.low, curve.high), class_="band")
        line = tag(
            "path", tag("title", labels[name]), d=axes.path(x, curve.fraction), class_="line"
        )
        of = color_class(colors, name)
        lines.append(tag("g", band, line, class_=of, data_agent=name))
    ticks = linear_ticks(*axes.x)
    frame = axes.frame(ticks, what.label, "runs that reach it, %")
    return plot(f"Performance profiles, {family}", frame, lines)


def family_points(board: Board, family: str) -> list[Point]:
    """A family's agents: the score of the leaderboard, and the geometric mean of their times."""
    tasks = [task.id for task in board.tasks if task.family == family]
    points = []
    for name in ranked(board, family):
        times = [_times(board, task, name) for task in tasks]
        known = [pair for pair in times if pair is not None]
        if known:
            standing = board.standings[family][name]
            middle, slow = (math.exp(sum(map(math.log, each)) / len(each)) for each in zip(*known))
            points.append(Point(name, middle, slow, standing.value, standing.interval))
    return points


def task_points(board: Board, task: Task) -> list[Point]:
    """The agents that flew a task: their success rate and their times."""
    points = []
    for agent in board.agents:
        times = _times(board, task.id, agent.name)
        cell = board.cells.get((task.id, agent.name))
        success = cell.values.get("success_rate") if cell is not None else None
        if times is not None and success is not None and success.value is not None:
            points.append(Point(agent.name, *times, success.value, success.interval))
    return points


def _times(board: Board, task: str, agent: str) -> tuple[float, float] | None:
    """Median and 99th percentile, microseconds, if they were taken."""
    cell = board.cells.get((task, agent))
    if cell is None:
        return None
    found = [cell.values[name].value for name in (MEDIAN, SLOW) if name in cell.values]
    if len(found) < 2 or found[0] is None or found[1] is None or min(found[0], found[1]) <= 0.0:
        return None
    return found[0], found[1]


def scatter(
    board: Board, colors: Palette, points: Sequence[Point], label: str, y_label: str
) -> Element:
    """Success over compute: up is better, left is cheaper. Whiskers: the interval, and the p99."""
    low, high = min(p.micros for p in points), max(p.slow for p in points)
    powers = decades(low, high)
    axes = Axes((powers[0], powers[-1]), (-0.04, 1.04), logarithmic=True)
    labels = {agent.name: agent.label for agent in board.agents}
    behind_first = sorted(points, key=lambda p: -colors.get(p.agent, len(colors)))
    marks = [_marked(axes, colors, p, labels[p.agent]) for p in behind_first]
    ticks = [(power, micros(power)) for power in powers]
    frame = axes.frame(ticks[:: 1 + len(ticks) // 7], "one decision of the team, median", y_label)
    return plot(label, frame, marks, _names(axes, colors, points, labels))


def _marked(axes: Axes, colors: Palette, point: Point, label: str) -> Element:
    x, y = axes.right(point.micros), axes.down(point.score)
    whisker = f"M{x:.1f} {y:.1f}H{axes.right(point.slow):.1f}"
    if point.interval is not None:
        low, high = (axes.down(end) for end in point.interval)
        whisker += f"M{x:.1f} {low:.1f}V{high:.1f}"
    said = f"{label}: {number(point.score, '%')} %, {micros(point.micros)}"
    drawn = mark(colors, point.agent, x, y, f"{said} (p99 {micros(point.slow)})")
    of = color_class(colors, point.agent)
    return tag(
        "g", tag("path", d=whisker, class_="whisker"), drawn, class_=of, data_agent=point.agent
    )


def _boxes(axes: Axes, point: Point) -> list[Box]:
    """What a mark and its whiskers take."""
    x, y = axes.right(point.micros), axes.down(point.score)
    low, high = (axes.down(end) for end in point.interval or (point.score, point.score))
    slow = axes.right(point.slow)
    return [(x - 5, y - 5, x + 5, y + 5), (x, y - 1, slow, y + 1), (x - 1, high, x + 1, low)]


def _names(
    axes: Axes, colors: Palette, points: Sequence[Point], labels: Mapping[str, str]
) -> list[Element]:
    """Names beside the marks that have a colour, where there is room."""
    named = [p for p in points if p.agent in colors]
    taken = [box for point in points for box in _boxes(axes, point)]
    wanted = [
        Label(labels[p.agent], axes.right(p.micros), axes.down(p.score), p.agent) for p in named
    ]
    return [
        tag(
            "text",
            label.text,
            x=x,
            y=y,
            class_=color_class(colors, label.key),
            data_agent=label.key,
        )
        for label, x, y in placed(wanted, taken)
    ]
