"""What a fit is given: a table of rows, or logs of flights that are made into one."""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import TYPE_CHECKING

from swarm_envs.training.force_model.log_options import LogOptions
from swarm_envs.training.force_model.rows import InteractionRows, read_rows

if TYPE_CHECKING:
    from swarm_envs.training.flight_logs import LogReport


def read_data(
    path: Path, options: LogOptions, progress: bool = False
) -> tuple[InteractionRows, LogReport | None]:
    """Read rows (`.npz`), a flight log (`.csv`, `.parquet`), or a folder of logs.

    Returns:
        The rows, and what became of the logs if that is what they come from.

    Raises:
        FileNotFoundError: there is nothing to read.
        ImportError: a log is Parquet, and pyarrow is not installed.
        ValueError: the file has none of the formats, or no log is sound.
    """
    if not path.is_dir() and path.suffix not in (".csv", ".parquet"):
        return read_rows(path), None
    from swarm_envs.training.flight_logs import read_logs  # imports rows from this package

    return read_logs(path, options, progress)


def data_sha256(path: Path) -> str:
    """Hexadecimal SHA-256 of a file, or of the names and contents of a folder's files."""
    if not path.is_dir():
        return hashlib.sha256(path.read_bytes()).hexdigest()
    digest = hashlib.sha256()
    for file in sorted(path.iterdir()):
        if file.is_file() and not file.name.startswith("."):
            digest.update(f"{file.name}\0{data_sha256(file)}\n".encode())
    return digest.hexdigest()
