"""The tables of the scoreboard's page: agents by tasks, and every number."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from itertools import groupby
from xml.etree.ElementTree import Element

from swarm_envs.training.scoreboard.board import Board, Cell, Entry, Metric, Task
from swarm_envs.training.scoreboard.figures import NONE, goodness, interval, number
from swarm_envs.training.scoreboard.markup import tag

Linked = Callable[[str], bool]
"""Whether a replay's page is there."""
PRIVILEGED = "sees the true state"
"""What the mark beside an agent means."""
_WORDS = {"failed": "failed", "unsupported": "n/a"}


@dataclass(frozen=True)
class Rows:
    """What the tables share: the board, and each value's colour."""

    board: Board
    """What is shown."""
    linked: Linked
    """Whether a replay's page is there."""
    tints: Mapping[tuple[str, str, str], float] = field(init=False)
    """How good a value is, in [0, 1], by task, agent and metric."""

    def __post_init__(self) -> None:
        """Compare what belongs into one column."""
        found = {}
        for task in self.board.tasks:
            cells = [c for (id_, _), c in self.board.cells.items() if id_ == task.id]
            flown = [cell for cell in cells if cell.status == "flown"]
            for metric in self.board.metrics:
                column = [
                    c.values[metric.name].value if metric.name in c.values else None for c in flown
                ]
                for cell, tint in zip(flown, goodness(metric, column), strict=True):
                    if tint is not None:
                        found[task.id, cell.agent, metric.name] = tint
        object.__setattr__(self, "tints", found)

    def number(self, cell: Cell, metric: Metric) -> list[Element | str]:
        """A value as text, with its interval."""
        given = cell.values.get(metric.name)
        if given is None or given.value is None:
            return [NONE]
        ends = interval(given, metric.unit)
        small = [" ", tag("small", ends)] if ends else []
        return [number(given.value, metric.unit), *small]

    def data(self, cell: Cell, metric: Metric) -> dict[str, float | str | None]:
        """Attributes of the cell of a table that shows a value: by what to sort, how good it is."""
        given = cell.values.get(metric.name)
        tint = self.tints.get((cell.task, cell.agent, metric.name))
        return {
            "data_v": None if given is None else given.value,
            "style": None if tint is None else f"--t:{tint:.3f}",
        }

    def replay(self, cell: Cell) -> Element | None:
        """A link to a cell's replay, if it is there."""
        if cell.replay is None or not self.linked(cell.replay.file):
            return None
        said = f"Replay: {self.label(cell)}"
        return tag("a", class_="play", href=cell.replay.file, aria_label=said, title=said)

    def label(self, cell: Cell) -> str:
        """An agent on a task, for people."""
        agent = next(a.label for a in self.board.agents if a.name == cell.agent)
        return f"{agent}, {next(t.label for t in self.board.tasks if t.id == cell.task)}"


def row_id(board: Board, cell: Cell) -> str:
    """The place of a cell's row among all numbers: free of what a user wrote."""
    tasks, agents = [t.id for t in board.tasks], [a.name for a in board.agents]
    return f"n{tasks.index(cell.task)}-{agents.index(cell.agent)}"


def agent_head(agent: Entry, scope: str | None = "row") -> Element:
    """An agent's name at the head of its row."""
    mark = tag("abbr", "◆", title=PRIVILEGED) if agent.privileged else None
    return tag("th", tag("span", agent.label), mark, scope=scope, title=agent.help or None)


def matrix(rows: Rows) -> Element:
    """Agents by tasks, of one metric: a script puts in another."""
    board = rows.board
    families = [(name, list(tasks)) for name, tasks in groupby(board.tasks, lambda t: t.family)]
    over = [tag("td")] + [
        tag("th", tag("span", name), colspan=len(tasks), scope="colgroup", data_family=name)
        for name, tasks in families
    ]
    heads = [_sortable("agent"), *(_task_head(task) for task in board.tasks)]
    body = [_matrix_row(rows, agent) for agent in sorted(board.agents, key=_order(board))]
    return tag(
        "table",
        tag("caption", f"{board.metrics[0].label} of every agent on every task"),
        tag("thead", tag("tr", over), tag("tr", heads)),
        tag("tbody", body),
        id="matrix",
        data_metric=board.metrics[0].name,
    )


def _order(board: Board) -> Callable[[Entry], float]:
    """Puts the agents with the best mean over their leaderboards first."""

    def key(agent: Entry) -> float:
        scores = [s[agent.name].value for s in board.standings.values() if agent.name in s]
        return -sum(scores) / len(scores) if scores else 0.0

    return key


def short_label(task: Task) -> str:
    """A task's label without its family."""
    return task.label.removeprefix(task.family).strip(" ,:") or task.label


def _task_head(task: Task) -> Element:
    return _sortable(short_label(task), data_task=task.id, data_family=task.family, title=task.id)


def _sortable(text: str, **attributes: str) -> Element:
    """A column's head; a script makes its text a button."""
    return tag("th", tag("span", text), scope="col", data_sort=True, **attributes)


def _matrix_row(rows: Rows, agent: Entry) -> Element:
    cells = [_matrix_cell(rows, task, agent) for task in rows.board.tasks]
    told = "yes" if agent.privileged else "no"
    return tag("tr", agent_head(agent), cells, data_agent=agent.name, data_privileged=told)


def _matrix_cell(rows: Rows, task: Task, agent: Entry) -> Element:
    cell = rows.board.cells.get((task.id, agent.name))
    if cell is None:
        return tag("td", NONE, data_family=task.family)
    if cell.status != "flown":
        text = tag("abbr", _WORDS[cell.status], title=cell.reason or None)
        return tag("td", text, class_=cell.status, data_family=task.family)
    metric = rows.board.metrics[0]
    target = f"#{row_id(rows.board, cell)}"
    shown = tag("a", rows.number(cell, metric), class_="n", href=target)
    data = rows.data(cell, metric)
    replay = rows.replay(cell)
    part = tag("abbr", "†", title=cell.reason, class_="part") if cell.reason else None
    return tag("td", replay, part, shown, class_="flown", data_family=task.family, **data)


def every_number(rows: Rows) -> Element:
    """A row for each flown cell, with all metrics."""
    board = rows.board
    heads = [_sortable("task"), _sortable("agent"), tag("th", "replay", scope="col")]
    heads += [_sortable("episodes")]
    heads += [_metric_head(metric) for metric in board.metrics]
    body = [
        _number_row(rows, task, agent)
        for task in board.tasks
        for agent in board.agents
        if (task.id, agent.name) in board.cells
        and board.cells[task.id, agent.name].status == "flown"
    ]
    caption = tag("caption", "Every number, with its 95 % interval")
    head = tag("thead", tag("tr", heads))
    return tag("table", caption, head, tag("tbody", body), id="numbers")


def _metric_head(metric: Metric) -> Element:
    unit = f", {metric.unit}" if metric.unit else ""
    head = _sortable(metric.label + unit, data_metric=metric.name, data_better=metric.better)
    head.set("title", metric.help)
    return head


def _number_row(rows: Rows, task: Task, agent: Entry) -> Element:
    cell = rows.board.cells[task.id, agent.name]
    values = [tag("td", rows.number(cell, m), **rows.data(cell, m)) for m in rows.board.metrics]
    replay = tag("td", rows.replay(cell))
    if cell.replay is not None:
        chosen = f"Episode {cell.replay.episode + 1} of {cell.episodes}, seed {cell.replay.seed}"
        replay.set("data-why", f"{chosen}: {cell.replay.why}." if cell.replay.why else f"{chosen}.")
    return tag(
        "tr",
        tag("th", tag("code", task.id), scope="row"),
        agent_head(agent, None),
        replay,
        tag("td", str(cell.episodes), data_v=cell.episodes),
        values,
        id=row_id(rows.board, cell),
        data_task=task.id,
        data_agent=agent.name,
        data_label=rows.label(cell),
        data_note=cell.reason or None,
    )
