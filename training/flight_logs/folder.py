"""What lies at a path of data: tables of rows, logs of flights, and what is not read."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import NamedTuple

from swarm_envs.training.collection.collect import MANIFEST
from swarm_envs.training.flight_logs.report import FileReport
from swarm_envs.training.flight_table import SUFFIXES

TABLE_SUFFIX = ".npz"
"""How the name of a table of rows ends."""


class Found(NamedTuple):
    """What lies at a path; all sorted by name."""

    tables: list[Path]
    """Tables of rows."""
    logs: list[Path]
    """Logs of flights."""
    twice: list[FileReport]
    """Flights that are there in several files, of which none can be preferred."""
    not_read: tuple[str, ...] = ()
    """Names of visible entries that are neither; of folders with a slash."""


def find_data(path: Path) -> Found:
    """Return the tables and logs at a path: itself, or those right in the folder.

    Endings count in capitals too.

    Raises:
        FileNotFoundError: there is nothing at `path`.
    """
    if not path.exists():
        raise FileNotFoundError(
            f"no data at {str(path)!r}; give a file of rows or logs, or a folder"
        )
    if not path.is_dir():
        return Found([path], [], []) if _ending(path) == TABLE_SUFFIX else Found([], [path], [])
    visible = sorted(file for file in path.iterdir() if not file.name.startswith("."))
    tables = [file for file in visible if file.is_file() and _ending(file) == TABLE_SUFFIX]
    logs = [file for file in visible if file.is_file() and _ending(file) in SUFFIXES]
    count = Counter(log.stem for log in logs)
    twice = [FileReport(log.name, _twice(log.stem, logs)) for log in logs if count[log.stem] > 1]
    not_read = tuple(
        f"{file.name}/" if file.is_dir() else file.name
        for file in visible
        if file not in tables and file not in logs and file.name != MANIFEST
    )
    return Found(tables, [log for log in logs if count[log.stem] == 1], twice, not_read)


def _ending(file: Path) -> str:
    return file.suffix.lower()


def _twice(stem: str, logs: list[Path]) -> str:
    names = " and as ".join(log.name for log in logs if log.stem == stem)
    return f"flight {stem!r} is there as {names}; keep one of them"
