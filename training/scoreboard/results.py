"""The file of a benchmark's results: one row per episode, and metadata.

The key `swarm-envs benchmark` of the metadata of `episodes.parquet` is JSON: the command, the seed,
versions and machine, digests of tasks and agents, and the reasons of missing results.
"""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

from swarm_envs.files import pyarrow, written_whole
from swarm_envs.training.scoreboard.metrics import COLUMNS, EpisodeRow

__all__ = ["FILE", "Cell", "Results", "need_parquet", "read_results"]

FILE = "episodes.parquet"
"""Name of the file in a benchmark's folder."""
_KEY = b"swarm-envs benchmark"


@dataclass
class Cell:
    """The episodes of an agent on a task, in the order of the seeds."""

    task: str
    agent: str
    rows: list[EpisodeRow] = field(default_factory=list)
    failure: str = ""
    """The error of an agent that failed, without episodes; empty for none."""
    mismatch: str = ""
    """The reason that the agent does not support the task; empty for none."""

    @property
    def status(self) -> Literal["flown", "failed", "unsupported"]:
        """The status; an agent that refuses every episode does not support a task."""
        if self.failure:
            return "failed"
        return "flown" if any(row["refusal"] is None for row in self.rows) else "unsupported"

    @property
    def reason(self) -> str:
        """The reason of missing or refused episodes; empty for none."""
        refusals = [row["refusal"] for row in self.rows if row["refusal"] is not None]
        if self.status == "flown" and refusals:
            return f"refused {len(refusals)} of {len(self.rows)} episodes: {refusals[0]}"
        return self.failure or self.mismatch or "".join(refusals[:1])


@dataclass
class Results:
    """The results of a benchmark.

    Args:
        about: the metadata: `command`, `seed`, `versions`, `machine`; `tasks` by id and `agents`
            by name, each with its `digest`.
        cells: the results of every agent on every task.
    """

    about: dict[str, Any]
    cells: list[Cell]

    def write(self, path: Path) -> None:
        """Write the file atomically.

        Raises:
            OSError: it cannot be written.
        """
        arrow, parquet = need_parquet()
        not_flown = [
            {"task": c.task, "agent": c.agent, "failure": c.failure, "mismatch": c.mismatch}
            for c in self.cells
            if not c.rows
        ]
        note = {_KEY: json.dumps({**self.about, "not_flown": not_flown})}
        schema = arrow.schema([(name, getattr(arrow, kind)()) for name, kind in COLUMNS.items()])
        rows = [row for cell in self.cells for row in cell.rows]
        table = arrow.Table.from_pylist(rows, schema.with_metadata(note))
        with written_whole(path) as partial, partial.open("wb") as file:
            parquet.write_table(table, file)  # pyarrow takes no path that is not Unicode


def read_results(path: Path) -> Results:
    """Read a benchmark's file, or that of its folder.

    Raises:
        FileNotFoundError: there is no such file.
        ImportError: pyarrow is not installed.
        ValueError: it is no file of a benchmark.
    """
    arrow, parquet = need_parquet()
    path = path / FILE if path.is_dir() else path
    if not path.is_file():
        raise FileNotFoundError(f"there is no file {str(path)!r}; `swarm-envs benchmark` writes it")
    try:
        with path.open("rb") as file:
            table = parquet.read_table(file)
        about = json.loads(table.schema.metadata[_KEY])
    except (arrow.ArrowException, KeyError, TypeError) as error:
        raise ValueError(f"{str(path)!r} is no file of a benchmark: {error!r}") from error
    cells = {(task, name): Cell(task, name) for task in about["tasks"] for name in about["agents"]}
    for each in about.pop("not_flown"):
        cells[each["task"], each["agent"]] = Cell(**each)
    for row in table.to_pylist():
        cells[row["task"], row["agent"]].rows.append(row)
    return Results(about, [*cells.values()])


def need_parquet() -> tuple[Any, Any]:
    """Return pyarrow and pyarrow.parquet.

    Raises:
        ImportError: pyarrow is not installed.
    """
    return pyarrow("the benchmark", "evaluate agents with `swarm-envs evaluate`")
