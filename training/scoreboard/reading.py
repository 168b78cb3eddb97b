"""`scores.json`, read and checked."""

from __future__ import annotations

import json
import re
from collections.abc import Sequence
from pathlib import Path

from swarm_envs.training.scoreboard.board import (
    Board,
    Cell,
    Curve,
    Entry,
    Metric,
    Profile,
    Replay,
    Standing,
    Task,
    Value,
)
from swarm_envs.training.scoreboard.parts import Part, finite, part_of

FILE = "scores.json"
"""Its name in a scoreboard's folder."""
FORMAT, VERSION = "swarm-envs scoreboard", 1
"""What the file says that it is."""
_REPLAY = re.compile(r"replays/[A-Za-z0-9][A-Za-z0-9._+-]*\.html")


def read(folder: Path) -> Board:
    """Read a scoreboard's folder.

    Raises:
        FileNotFoundError: it holds no `scores.json`.
        ValueError: the file is of another format or version, or a part of it is not what it must
            be; the message names the part.
    """
    file = folder / FILE
    if not file.is_file():
        raise FileNotFoundError(
            f"there is no {FILE} in {str(folder)!r}; `swarm-envs benchmark --out {folder}` makes it"
        )
    try:
        content = json.loads(file.read_text(encoding="utf-8"), parse_constant=finite)
        return _board(part_of(content))
    except ValueError as error:
        raise ValueError(
            f"{str(file)!r} cannot be shown: {error}; write it anew with `swarm-envs benchmark`"
        ) from error


def _board(top: Part) -> Board:
    for key, wanted in (("format", FORMAT), ("version", VERSION)):
        if top.raw(key) != wanted:
            raise ValueError(f"its {key} is {top.raw(key)!r}, but this package reads {wanted!r}")
    metrics = tuple(map(_metric, top.parts("metrics")))
    tasks = tuple(map(_task, top.parts("tasks")))
    agents = tuple(map(_entry, top.parts("agents")))
    families = {task.family for task in tasks}
    names = {agent.name for agent in agents}
    known = {task.id for task in tasks}, names, {metric.name for metric in metrics}
    for what, given in (("metrics", metrics), ("tasks", tasks), ("agents", agents)):
        _check_unique(what, [getattr(each, "id", getattr(each, "name", "")) for each in given])
    cells = [_cell(part, *known) for part in top.parts("cells")]
    _check_unique("cells", [(cell.task, cell.agent) for cell in cells])
    aggregates, profiles = top.part("aggregates"), top.part("profiles")
    return Board(
        manifest=top.part("manifest").content,
        metrics=metrics,
        tasks=tasks,
        agents=agents,
        cells={(cell.task, cell.agent): cell for cell in cells},
        standings={
            family: {name: _standing(each) for name, each in part.named(names)}
            for family, part in aggregates.named(families)
        },
        profiles={family: _profile(part, names) for family, part in profiles.named(families)},
    )


def _check_unique(what: str, keys: Sequence[object]) -> None:
    twice = [key for key in dict.fromkeys(keys) if keys.count(key) > 1]
    if twice:
        raise ValueError(f"{what} has {twice[0]!r} twice")


def _metric(part: Part) -> Metric:
    better = part.one_of("better", ("higher", "lower", "neither"))
    label = part.text("label")
    return Metric(
        name=part.text("name"),
        label=label[:1].upper() + label[1:],
        unit=part.text("unit"),
        better=better,  # type: ignore[arg-type]
        help=part.text("help"),
    )


def _task(part: Part) -> Task:
    return Task(
        id=part.text("id"),
        family=part.text("task"),
        label=part.text("label"),
        environment=part.text("environment", part.text("task") + "_v0"),
        options=part.part("options").content,
        episodes=part.integer("episodes"),
        help=part.text("help", ""),
    )


def _entry(part: Part) -> Entry:
    name = part.text("name")
    return Entry(name, part.text("label", name), part.flag("privileged"), part.text("help", ""))


def _cell(part: Part, tasks: set[str], agents: set[str], metrics: set[str]) -> Cell:
    replay = None if part.raw("replay", None) is None else _replay(part.part("replay"))
    status = part.one_of("status", ("flown", "failed", "unsupported"))
    return Cell(
        task=part.one_of("task", tasks),
        agent=part.one_of("agent", agents),
        status=status,  # type: ignore[arg-type]
        reason=part.text("reason", ""),
        episodes=part.integer("episodes", 0),
        values={name: _value(each) for name, each in part.part("values").named(metrics)},
        replay=replay if status == "flown" else None,
    )


def _replay(part: Part) -> Replay:
    file = part.text("file")
    if not _REPLAY.fullmatch(file):
        rule = "replays/NAME.html, of letters, digits, '.', '_', '+' and '-'"
        raise ValueError(f"{part.where}.file is {file!r}, but must be {rule}")
    seed, episode = part.integer("seed"), part.integer("episode", 0)
    success = part.flag("success") if "success" in part.content else None
    return Replay(seed, episode, file, part.text("why", ""), success)


def _value(part: Part) -> Value:
    return Value(part.number("value"), part.interval("interval"))


def _standing(part: Part) -> Standing:
    value = part.number("value")
    if value is None or not 0.0 <= value <= 1.0:
        raise ValueError(f"{part.where}.value is {value!r}, but must be a score in [0, 1]")
    return Standing(value, part.interval("interval"), part.text("metric", "score"))


def _profile(part: Part, agents: set[str]) -> Profile:
    thresholds = part.numbers("thresholds")
    if len(thresholds) < 2 or list(thresholds) != sorted(set(thresholds)):
        raise ValueError(f"{part.where}.thresholds must be two or more, and increase")
    curves = {}
    for name, each in part.part("agents").named(agents):
        count = len(thresholds)
        curves[name] = Curve(*(each.numbers(key, count) for key in ("fraction", "low", "high")))
    return Profile(part.text("label", part.text("metric", "score")), thresholds, curves)
