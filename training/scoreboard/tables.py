"""The tables of the scoreboard's page: agents by tasks, and every number."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from itertools import groupby
from xml.etree.ElementTree import Element

from swarm_envs.training.scoreboard.board import Board, Entry, Metric, TaskInfo
from swarm_envs.training.scoreboard.markup import NONE, format_interval, format_value, tag

PRIVILEGED = "sees the true state"  # What the mark beside an agent means
_WORDS = {"failed": "failed", "unsupported": "n/a"}


class Tables:
    """The tables of a board.

    Args:
        board: what is shown.
        linked: whether a replay's page is there.
    """

    def __init__(self, board: Board, linked: Callable[[str], bool]) -> None:
        self._board, self._linked = board, linked
        self._tasks = {task.id: k for k, task in enumerate(board.tasks)}
        self._agents = {name: k for k, name in enumerate(board.agents)}
        self._tints: dict[tuple[str, str, str], float] = {}
        for task in board.tasks:
            flown = [c for c in board.cells if c["task"] == task.id and c["status"] == "flown"]
            for metric in board.metrics:
                values = [c["values"].get(metric.name, {}).get("value") for c in flown]
                for cell, tint in zip(flown, goodness(metric, values), strict=True):
                    if tint is not None:
                        self._tints[task.id, cell["agent"], metric.name] = tint

    def matrix(self) -> Element:
        """Agents by tasks, of one metric: a script puts in another."""
        board = self._board
        over = [tag("td")]
        for family, tasks in groupby(board.tasks, lambda task: task.task):
            span = {"colspan": len(list(tasks)), "scope": "colgroup", "data_family": family}
            over.append(tag("th", tag("span", family), **span))
        heads = [_sortable("agent")] + [
            _sortable(short_label(task), data_task=task.id, data_family=task.task, title=task.id)
            for task in board.tasks
        ]
        agents = sorted(board.agents.values(), key=lambda agent: -self._total(agent["name"]))
        return tag(
            "table",
            tag("caption", f"{board.metrics[0].label} of every agent on every task"),
            tag("thead", tag("tr", over), tag("tr", heads)),
            tag("tbody", [self._matrix_row(agent) for agent in agents]),
            id="matrix",
            data_metric=board.metrics[0].name,
        )

    def every_number(self) -> Element:
        """A row for each flown cell, with all metrics."""
        board = self._board
        heads = [_sortable("task"), _sortable("agent"), tag("th", "replay", scope="col")]
        heads += [_sortable("episodes")]
        for metric in board.metrics:
            text = f"{metric.label}, {metric.unit}" if metric.unit else metric.label
            about = {"data_metric": metric.name, "data_better": metric.better}
            heads.append(_sortable(text, **about, title=metric.help))
        body = []
        for task in board.tasks:
            for agent in board.agents.values():
                cell = board.pairs.get((task.id, agent["name"]))
                if cell is not None and cell["status"] == "flown":
                    body.append(self._number_row(task, agent, cell))
        caption = tag("caption", "Every number, with its 95 % interval")
        return tag(
            "table", caption, tag("thead", tag("tr", heads)), tag("tbody", body), id="numbers"
        )

    def _total(self, agent: str) -> float:
        """Of all leaderboards together."""
        boards = self._board.aggregates.values()
        return sum(standings[agent]["value"] for standings in boards if agent in standings)

    def _matrix_row(self, agent: Entry) -> Element:
        cells = [self._matrix_cell(task, agent) for task in self._board.tasks]
        privileged = "yes" if agent["privileged"] else "no"
        return tag("tr", _head(agent), cells, data_agent=agent["name"], data_privileged=privileged)

    def _matrix_cell(self, task: TaskInfo, agent: Entry) -> Element:
        cell = self._board.pairs.get((task.id, agent["name"]))
        if cell is None:
            return tag("td", NONE, data_family=task.task)
        if cell["status"] != "flown":
            text = tag("abbr", _WORDS[cell["status"]], title=cell["reason"] or None)
            return tag("td", text, class_=cell["status"], data_family=task.task)
        metric = self._board.metrics[0]
        part = tag("abbr", "†", title=cell["reason"], class_="part") if cell["reason"] else None
        shown = tag("a", self._number(cell, metric), class_="n", href=f"#{self._row_id(cell)}")
        data = {"data_family": task.task, **self._data(cell, metric)}
        return tag("td", self._replay(cell), part, shown, class_="flown", **data)

    def _number_row(self, task: TaskInfo, agent: Entry, cell: Entry) -> Element:
        values = [
            tag("td", self._number(cell, metric), **self._data(cell, metric))
            for metric in self._board.metrics
        ]
        replay = tag("td", self._replay(cell))
        if (shown := cell["replay"]) is not None:
            why = f"Episode {shown['episode'] + 1} of {cell['episodes']}, seed {shown['seed']}"
            replay.set("data-why", f"{why}: {shown['why']}." if shown["why"] else f"{why}.")
        return tag(
            "tr",
            tag("th", tag("code", task.id), scope="row"),
            _head(agent, scope=None),
            replay,
            tag("td", str(cell["episodes"]), data_v=cell["episodes"]),
            values,
            id=self._row_id(cell),
            data_task=task.id,
            data_agent=agent["name"],
            data_label=self._label(cell),
            data_note=cell["reason"] or None,
        )

    def _number(self, cell: Entry, metric: Metric) -> list[Element | str]:
        given = cell["values"].get(metric.name, {})
        if given.get("value") is None:
            return [NONE]
        text, ends = format_value(given["value"], metric.unit), given.get("interval")
        return [text, " ", tag("small", format_interval(ends, metric.unit))] if ends else [text]

    def _data(self, cell: Entry, metric: Metric) -> dict[str, float | str | None]:
        """Attributes of the cell of a table that shows a value: by what to sort, how good it is."""
        tint = self._tints.get((cell["task"], cell["agent"], metric.name))
        return {
            "data_v": cell["values"].get(metric.name, {}).get("value"),
            "style": None if tint is None else f"--t:{tint:.3f}",
        }

    def _replay(self, cell: Entry) -> Element | None:
        if cell["replay"] is None or not self._linked(cell["replay"]["file"]):
            return None
        said = f"Replay: {self._label(cell)}"
        return tag("a", class_="play", href=cell["replay"]["file"], aria_label=said, title=said)

    def _label(self, cell: Entry) -> str:
        agent, task = self._board.agents[cell["agent"]], self._tasks[cell["task"]]
        return f"{agent['label']}, {self._board.tasks[task].label}"

    def _row_id(self, cell: Entry) -> str:
        """The place of a cell's row among all numbers: free of what a user wrote."""
        return f"n{self._tasks[cell['task']]}-{self._agents[cell['agent']]}"


def short_label(task: TaskInfo) -> str:
    """A task's label without its family."""
    return task.label.removeprefix(task.task).strip(" ,:") or task.label


def _sortable(text: str, **attributes: str) -> Element:
    return tag("th", tag("span", text), scope="col", data_sort=True, **attributes)


def _head(agent: Entry, scope: str | None = "row") -> Element:
    mark = tag("abbr", "◆", title=PRIVILEGED) if agent["privileged"] else None
    return tag("th", tag("span", agent["label"]), mark, scope=scope, title=agent["help"] or None)


def goodness(metric: Metric, values: Sequence[float | None]) -> list[float | None]:
    """How good each value of a column is, in [0, 1]; None where nothing can be said.

    Rates stand on their own; other values lie between the worst and the best of the column, by
    their logarithm where that is more than a factor of 30 away.
    """
    found = [value for value in values if value is not None]
    if metric.better == "neither" or not found:
        return [None] * len(values)
    low, high = (0.0, 1.0) if metric.unit == "%" else (min(found), max(found))
    if low == high:
        return [None if value is None else 0.5 for value in values]
    logarithmic = low > 0.0 and high / low > 30.0
    shares = [None if value is None else _share(value, low, high, logarithmic) for value in values]
    higher = metric.better == "higher"
    return [None if share is None else share if higher else 1.0 - share for share in shares]


def _share(value: float, low: float, high: float, logarithmic: bool) -> float:
    if logarithmic:
        return math.log(value / low) / math.log(high / low)
    return (value - low) / (high - low)
