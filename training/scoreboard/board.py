"""`scores.json` as the report reads it: agents on tasks, and what they add up to.

`standings.scores_of` writes the file and describes it. Agents, cells, aggregates and
profiles are read as they stand there.
"""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, Literal, NoReturn

__all__ = ["FILE", "read"]

FILE = "scores.json"
"""Its name in a scoreboard's folder."""
FORMAT, VERSION = "swarm-envs scoreboard", 1
"""What the file says that it is."""
Entry = Mapping[str, Any]  # An agent, a cell, a standing or a profile of the file
Interval = Sequence[float]
"""The two ends of a 95 % interval."""
_REPLAY = re.compile(r"replays/[A-Za-z0-9][A-Za-z0-9._+-]*\.html")


@dataclass(frozen=True)
class Metric:
    """One thing that is measured, with a label for people, and what it means, in a sentence."""

    name: str  # In the files, with its unit
    label: str  # Short name
    unit: str  # `%` for fractions in [0, 1]; empty for counts
    better: Literal["higher", "lower", "neither"]  # Which values are
    help: str  # Explanation


@dataclass(frozen=True)
class TaskInfo:
    """One thing that is flown, a versioned setting of a task; label and help are for people."""

    id: str  # Such as `swap-circle-4-v2`; another meaning has another version
    task: str  # Its family, such as `classic` or `air`
    label: str  # Short name
    options: Mapping[str, Any]  # Of `swarm_envs.make`, beside what an agent requires
    episodes: int  # Of each agent
    environment: str  # First argument of `swarm_envs.make`
    help: str = ""  # Description


class Board:
    """The whole file; metrics, tasks and agents in the order of the page.

    Args:
        content: of the file.

    Raises:
        KeyError: a part is missing.
        ValueError: the file is of another format or version, or a part is not what it must be.
    """

    def __init__(self, content: Any) -> None:
        _check_format(content)
        self.manifest: Entry = content["manifest"]
        self.metrics = [
            Metric(
                **_known(Metric, {**each, "label": each["label"][:1].upper() + each["label"][1:]})
            )
            for each in content["metrics"]
        ]
        self.tasks = [TaskInfo(**_known(TaskInfo, each)) for each in content["tasks"]]
        self.agents: dict[str, Entry] = {
            each["name"]: {"help": "", **each, "label": each.get("label") or each["name"]}
            for each in content["agents"]
        }
        self.cells: list[Entry] = [_cell(each) for each in content["cells"]]
        self.aggregates: Mapping[str, Mapping[str, Entry]] = content["aggregates"]
        self.profiles: Mapping[str, Entry] = content["profiles"]
        self.families = list(dict.fromkeys(task.task for task in self.tasks))
        self.pairs = {(cell["task"], cell["agent"]): cell for cell in self.cells}
        self._check_names()

    def _check_names(self) -> None:
        tasks = {task.id for task in self.tasks}
        for task, agent in self.pairs:
            if task not in tasks or agent not in self.agents:
                raise ValueError(f"cells name {agent!r} on {task!r}, which the file does not list")
        for family, standings in self.aggregates.items():
            for name, standing in standings.items():
                if family not in self.families or name not in self.agents:
                    raise ValueError(
                        f"aggregates name {name!r} in {family!r}, which the file does not list"
                    )
                if not 0.0 <= standing["value"] <= 1.0:
                    raise ValueError(
                        f"aggregates.{family}.{name}.value is {standing['value']}, but must be a "
                        "score in [0, 1]"
                    )

    def ranked(self, family: str) -> list[str]:
        """A family's agents, the best first."""
        standings = self.aggregates.get(family, {})
        return sorted(standings, key=lambda name: -standings[name]["value"])


def read(folder: Path) -> Board:
    """Read a scoreboard's folder.

    Raises:
        FileNotFoundError: it holds no `scores.json`.
        ValueError: the file is of another format or version, or a part of it is missing or not what
            it must be; the message names the part.
    """
    file = folder / FILE
    if not file.is_file():
        raise FileNotFoundError(
            f"there is no {FILE} in {str(folder)!r}; `swarm-envs benchmark --out {folder}` makes it"
        )
    try:
        content = json.loads(file.read_text(encoding="utf-8"), parse_constant=_refuse_constant)
        return Board(content)
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        said = f"{error} is missing" if isinstance(error, KeyError) else error
        raise ValueError(
            f"{str(file)!r} cannot be shown: {said}; write it again with `swarm-envs benchmark`"
        ) from error


def _refuse_constant(constant: str) -> NoReturn:
    raise ValueError(f"it holds {constant}, which is no number; null says that there is none")


def _check_format(content: Any) -> None:
    if not isinstance(content, dict):
        raise ValueError(f"it holds {content!r:.80}, but must hold an object")
    for key, wanted in (("format", FORMAT), ("version", VERSION)):
        if key not in content:
            raise ValueError(f"{key} is missing")
        if content[key] != wanted:
            raise ValueError(f"its {key} is {content[key]!r}, but this package reads {wanted!r}")


def _known(kind: Any, content: Entry) -> dict[str, Any]:
    """The entries that a class has fields for."""
    return {field.name: content[field.name] for field in fields(kind) if field.name in content}


def _cell(content: Entry) -> Entry:
    """A cell, whose replay may be linked; one that was not flown has none."""
    cell = {"episodes": 0, "replay": None, **content, "reason": content.get("reason") or ""}
    if cell["status"] != "flown":
        cell["replay"] = None
    if cell["replay"] is not None:
        cell["replay"] = {"episode": 0, "why": "", "success": None, **cell["replay"]}
        file = cell["replay"]["file"]
        if not _REPLAY.fullmatch(file):
            raise ValueError(
                f"the replay's file is {file!r:.80}, but must be replays/NAME.html, of letters, "
                "digits, '.', '_', '+' and '-'"
            )
    return cell
