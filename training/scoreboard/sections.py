"""The parts of the scoreboard's page that are neither table nor plot."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from typing import Any
from xml.etree.ElementTree import Element

from swarm_envs.training.scoreboard.board import Board, Entry, Metric, Standing
from swarm_envs.training.scoreboard.colors import Palette, color_class, ranked, swatch
from swarm_envs.training.scoreboard.figures import duration, number
from swarm_envs.training.scoreboard.markup import Content, tag
from swarm_envs.training.scoreboard.tables import PRIVILEGED, short_label

_BETTER = {"higher": "more is better", "lower": "less is better", "neither": ""}


def summary(board: Board) -> str:
    """What the page is about, in a line."""
    flown = [cell for cell in board.cells.values() if cell.status == "flown"]
    episodes = sum(cell.episodes for cell in flown)
    return (
        f"{len(board.agents)} agents on {len(board.tasks)} tasks: {len(flown)} pairs flown, "
        f"{number(episodes)} episodes. On a task all fly the same frozen seeds, slow agents the first."
    )


def facts(board: Board) -> Element:
    """When, where and with what it was run."""
    return tag("dl", [_fact(*pair) for pair in _facts(board.manifest)], class_="facts")


def _facts(manifest: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
    started = str(manifest.get("started") or "")
    if started:
        yield "Started", started[:16].replace("T", " ") + " UTC"
    times = [("wall_s", "wall"), ("cpu_s", "CPU")]
    taken = [f"{duration(manifest[k])} {word}" for k, word in times if _is_number(manifest.get(k))]
    if taken:
        yield "Took", ", ".join(taken)
    machine = manifest.get("machine")
    if isinstance(machine, dict):
        cores = machine.get("cores")
        parts = [machine.get("cpu"), f"{cores} cores" if cores else None, machine.get("system")]
        yield "Machine", ", ".join(str(part) for part in parts if part)
    versions = manifest.get("versions")
    if isinstance(versions, dict):
        yield "Versions", ", ".join(f"{name} {v}" for name, v in versions.items() if v)
    if manifest.get("commit"):
        yield "Commit", str(manifest["commit"])[:12]
    yield "Configuration", str(manifest.get("config_hash", "unknown"))[:12]


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _fact(name: str, text: Content) -> Element:
    return tag("div", tag("dt", name), tag("dd", text))


def leaderboards(board: Board, colors: Palette) -> list[Element]:
    """A card for each family: its agents, the best first, with their intervals."""
    entries = {agent.name: agent for agent in board.agents}
    cards = []
    for family in board.families:
        names = ranked(board, family)
        if not names:
            continue
        standings = board.standings[family]
        tasks = [task.id for task in board.tasks if task.family == family]
        rows = []
        for place, name in enumerate(names, 1):
            flown = sum(
                board.cells[t, name].status == "flown" for t in tasks if (t, name) in board.cells
            )
            part = f"{flown}/{len(tasks)}" if flown < len(tasks) else ""
            rows.append(_place(place, entries[name], standings[name], part, colors))
        what = standings[names[0]].metric
        cards.append(
            tag(
                "article",
                tag("h3", family),
                tag("p", f"Interquartile mean of {what}", class_="quiet"),
                tag("ol", rows, _scale(), class_="board"),
            )
        )
    return cards


def _place(place: int, agent: Entry, standing: Standing, part: str, colors: Palette) -> Element:
    low, high = standing.interval or (standing.value, standing.value)
    text = number(standing.value, "%")
    ends = f"{text} %, 95 % interval {number(low, '%')} to {number(high, '%')} %"
    bar = tag(
        "span",
        tag("i", style=f"left:{100 * low:.2f}%;width:{100 * (high - low):.2f}%"),
        tag("b", style=f"left:{100 * standing.value:.2f}%"),
        class_="bar",
        title=ends,
    )
    name = tag(
        "span",
        swatch(colors, agent.name),
        tag("span", agent.label, class_="label", title=agent.label),
        tag("abbr", "◆", title=PRIVILEGED) if agent.privileged else None,
        tag("small", part, title="tasks flown, of those of this family") if part else None,
        class_="who",
    )
    of = color_class(colors, agent.name)
    score = tag("span", text, class_="score", title=ends)
    rank = tag("span", str(place), class_="rank")
    return tag("li", rank, name, bar, score, class_=of, data_agent=agent.name)


def _scale() -> Element:
    ticks = [tag("i", text, style=f"left:{text}%") for text in ("0", "50", "100")]
    axis = tag("span", ticks, class_="bar axis")
    blank = [tag("span"), tag("span")]
    return tag("li", blank, axis, tag("span", "%"), class_="axis", aria_hidden="true")


def not_flown(board: Board) -> Element | None:
    """What has no numbers, or not all, and why: each agent and reason once, with the tasks."""
    labels = {agent.name: agent.label for agent in board.agents}
    tasks = {task.id: task for task in board.tasks}
    groups: dict[tuple[str, str, str], list[str]] = {}
    for (task, name), cell in board.cells.items():
        if cell.status != "flown" or cell.reason:
            groups.setdefault((cell.status, name, cell.reason), []).append(task)
    if not groups:
        return None
    rows = []
    for (status, name, reason), ids in sorted(groups.items()):
        where = ", ".join(f"{tasks[i].family} {short_label(tasks[i])}" for i in ids)
        said = "in part" if status == "flown" else status
        word = tag("span", said, class_=f"word {status}")
        why = reason or "no reason was given"
        rows.append(
            tag(
                "li",
                word,
                " ",
                tag("strong", labels[name]),
                f": {why} ",
                tag("span", f"({where})", class_="quiet"),
            )
        )
    count = sum(map(len, groups.values()))
    title = f"Why {count} of {len(board.cells)} pairs have no numbers, or (†) not of all episodes"
    return tag("details", tag("summary", title), tag("ul", rows, class_="reasons"))


def reproduce(board: Board) -> list[Element]:
    """How to get the same numbers again."""
    manifest = board.manifest
    command = str(manifest.get("command") or "swarm-envs benchmark --out scoreboard")
    config = json.dumps(manifest.get("config", {}), indent=1, ensure_ascii=False)
    seed = manifest.get("seed", "unknown")
    return [
        tag("pre", tag("code", command)),
        tag(
            "p",
            f"The seeds of all episodes follow from seed {seed}; the first of many are those of "
            "few. The same configuration gives the same numbers on the same machine; times of "
            "compute are those of this machine. SHA-256 of the configuration: ",
            tag("code", str(manifest.get("config_hash", "unknown")), class_="hash"),
        ),
        tag(
            "p",
            "Each episode's numbers are in ", tag("code", "episodes.parquet"), ", what this page "
            "shows in ", tag("code", "scores.json"), ", what was run where in ",
            tag("code", "manifest.json"), ".",
        ),
        tag("details", tag("summary", "The configuration"), tag("pre", tag("code", config))),
    ]  # fmt: skip


def glossary(board: Board) -> list[Element]:
    """What each metric, task and agent is."""
    metrics = [_meaning(metric) for metric in board.metrics]
    tasks = [
        _fact_of(task.label, [tag("code", task.id), f" {task.help} ",
                 tag("small", f"{task.episodes} episodes; {_options(task.options)}")])
        for task in board.tasks
    ]  # fmt: skip
    agents = [
        _fact_of(a.label, [a.help, " ", tag("em", f"◆ {PRIVILEGED}") if a.privileged else None])
        for a in board.agents
    ]
    return [
        tag("h3", "Metrics"), tag("dl", metrics, class_="terms"),
        tag("h3", "Tasks"), tag("dl", tasks, class_="terms"),
        tag("h3", "Agents"), tag("dl", agents, class_="terms"),
    ]  # fmt: skip


def _meaning(metric: Metric) -> Element:
    words = [metric.unit, _BETTER[metric.better], metric.name]
    small = tag("small", "; ".join(filter(None, words)))
    return _fact_of(metric.label, [metric.help, " ", small])


def _fact_of(name: str, content: Content) -> Element:
    return tag("div", tag("dt", name), tag("dd", content))


def _options(options: Mapping[str, Any]) -> str:
    return ", ".join(f"{name} {json.dumps(v, ensure_ascii=False)}" for name, v in options.items())
