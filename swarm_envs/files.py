"""Atomic writing of files, and locks of output folders."""

from __future__ import annotations

import csv
import glob
import importlib
import json
import os
import platform
import re
import zipfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, TextIO
from zlib import crc32

import numpy as np
import numpy.typing as npt

__all__ = [
    "claimed",
    "parse_note",
    "pyarrow",
    "read_npz",
    "write_json",
    "write_table",
    "written_whole",
]

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None  # type: ignore[assignment]

LOCK = ".lock"
"""Name of the file that a process locks to claim a folder; the unlocked file may remain."""
_PARTIAL = re.compile(r"\..+\.\d+\.partial(\..+)?")


@contextmanager
def written_whole(path: Path) -> Iterator[Path]:
    """Yield a temporary path next to `path`, with its suffix, that replaces it on success.

    A reader sees the old file or the complete new one. After an exception the temporary file is
    removed, as are those of killed processes of this machine.

    Raises:
        OSError: the folder cannot be created or written.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    # A long name is cut, because file systems limit the length of a name.
    name = f".{path.stem[:48]}.{crc32(platform.node().encode())}"
    partial = path.with_name(f"{name}.{os.getpid()}.partial{path.suffix}")
    for old in path.parent.glob(glob.escape(name) + f".*.partial{glob.escape(path.suffix)}"):
        if not _runs(int(old.name.removeprefix(name).split(".")[1])):
            old.unlink(missing_ok=True)
    try:
        yield partial
        partial.replace(path)
    finally:
        partial.unlink(missing_ok=True)


def _runs(process: int) -> bool:
    """Return True if a process of this machine runs, or if that cannot be determined."""
    if fcntl is None:  # On Windows, signal 0 would end it
        return True
    try:
        os.kill(process, 0)
    except OSError as error:
        return not isinstance(error, ProcessLookupError)  # other errors: another user's process
    return True


def write_json(path: Path, content: object) -> None:
    """Write JSON atomically.

    Raises:
        OSError: the folder cannot be created or written.
        ValueError: the content has a NaN or infinity, which JSON does not support.
    """
    with written_whole(path) as partial:
        partial.write_text(json.dumps(content, indent=1, allow_nan=False) + "\n", encoding="utf-8")


def parse_note(text: str) -> dict[str, Any]:
    """Return the JSON object in the metadata of a weights file.

    Raises:
        ValueError: it is no object, no JSON, or nested too deeply to be read.
    """
    try:
        note = json.loads(text)
    except RecursionError:
        raise ValueError("its note is nested too deeply to be read") from None
    if not isinstance(note, dict):
        raise ValueError(f"its note is {note!r:.80}, not a JSON object")
    return note


_SMALL = 2**28  # Bytes to which any npz file may unpack
_RATIO = 100  # Larger files may unpack to this many times their size, more than any flight needs


def read_npz(path: Path) -> dict[str, npt.NDArray[Any]]:
    """Return the arrays of an npz file by name, without unpickling anything.

    Raises:
        OSError: the file cannot be opened.
        ValueError: it is no npz file, is damaged, or unpacks to more than 256 MiB and 100 times
            its size.
    """
    with path.open("rb") as file:
        if not zipfile.is_zipfile(file):  # numpy's message would suggest to unpickle it
            raise ValueError(f"{path} is not an npz file")
        try:
            with zipfile.ZipFile(file) as archive:
                size = sum(member.file_size for member in archive.infolist())
            if size <= max(_SMALL, _RATIO * path.stat().st_size):
                file.seek(0)
                with np.load(file, allow_pickle=False) as stored:
                    return {name: stored[name] for name in stored.files}
        except Exception as error:  # zip, zlib and numpy raise many kinds for a damaged file
            raise ValueError(f"{path} is not an npz file, or damaged: {error}") from error
    raise ValueError(f"{path} unpacks to {size / 1e9:.1f} GB, which no file of this package does")


@contextmanager
def claimed(folder: Path) -> Iterator[None]:
    """Lock an output folder, so that no other process can write to it.

    The lock ends with the process. Incomplete files of killed processes are removed when it is
    acquired. A folder that was created here and remained empty is removed at the end. On systems
    without `flock`, there is no lock.

    Raises:
        BlockingIOError: another process writes to the folder; the message names it.
        OSError: the folder cannot be created or written.
    """
    made = not folder.exists()
    folder.mkdir(parents=True, exist_ok=True)
    with (folder / LOCK).open("a+", encoding="utf-8") as lock:
        if fcntl is not None:
            _lock(folder, lock)
            for path in folder.iterdir():
                if _PARTIAL.fullmatch(path.name):
                    path.unlink()
        try:
            yield
        finally:
            with suppress(OSError):  # Windows does not remove open files
                if made and [path.name for path in folder.iterdir()] == [LOCK]:
                    (folder / LOCK).unlink()
                    folder.rmdir()


def _lock(folder: Path, lock: TextIO) -> None:
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError as error:
        lock.seek(0)
        raise BlockingIOError(
            f"process {lock.read().strip() or 'of another user'} writes into {str(folder)!r}; wait "
            "for it, end it, or choose another folder"
        ) from error
    lock.truncate(0)
    lock.write(str(os.getpid()))
    lock.flush()


def write_table(path: Path, rows: Sequence[Mapping[str, Any]]) -> None:
    """Write rows as CSV atomically; the keys of the first row are the columns.

    Raises:
        OSError: the file cannot be written.
        ValueError: there is no row, or a row has other keys.
    """
    if not rows:
        raise ValueError(f"there is no row to write into {str(path)!r}")
    with written_whole(path) as partial, partial.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)


def pyarrow(what: str, otherwise: str) -> tuple[Any, Any]:
    """Return the modules pyarrow and pyarrow.parquet, which read and write Parquet.

    Args:
        what: the task that needs them, for the message.
        otherwise: the alternative without them, for the message.

    Raises:
        ImportError: pyarrow is not installed; the message gives the command that installs it.
    """
    try:
        return importlib.import_module("pyarrow"), importlib.import_module("pyarrow.parquet")
    except ImportError as error:
        raise ImportError(
            f"{what} needs pyarrow; install it by: pip install 'swarm-envs[parquet]', or "
            f"{otherwise}"
        ) from error
