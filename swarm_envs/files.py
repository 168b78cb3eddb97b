"""Files that are written whole or not at all, in folders that one process at a time writes into."""

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
except ImportError:  # Windows has none
    fcntl = None  # type: ignore[assignment]

LOCK = ".lock"
"""Name of the file by which a process claims a folder; it stays, and says nothing by itself."""
_PARTIAL = re.compile(r"\..+\.\d+\.partial(\..+)?")


@contextmanager
def written_whole(path: Path) -> Iterator[Path]:
    """Give a temporary path next to `path`, with its suffix, that replaces it on success.

    A reader sees the old file or the whole new one. After an exception nothing is left behind, and
    what processes of this machine left that were killed is removed.

    Raises:
        OSError: the folder cannot be made or written.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    # Of a long name a part: with what is added it might be longer than a name may be.
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
    """Whether a process of this machine is there; where that cannot be told, that it is."""
    if fcntl is None:  # Windows: a signal 0 would end it
        return True
    try:
        os.kill(process, 0)
    except OSError as error:
        return not isinstance(error, ProcessLookupError)  # else it is another user's
    return True


def write_json(path: Path, content: object) -> None:
    """Write JSON, whole or not at all.

    Raises:
        OSError: the folder cannot be made or written.
        ValueError: the content holds NaN or infinity, which JSON cannot say.
    """
    with written_whole(path) as partial:
        partial.write_text(json.dumps(content, indent=1, allow_nan=False) + "\n", encoding="utf-8")


def parse_note(text: str) -> dict[str, Any]:
    """The JSON object that a file of weights carries as its note.

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


_SMALL = 2**28  # An npz file may unpack to so many bytes, whatever its size
_RATIO = 100  # and otherwise to so many times its size, which no flight does


def read_npz(path: Path) -> dict[str, npt.NDArray[Any]]:
    """Return the arrays of an npz file by name; nothing is unpickled.

    Raises:
        OSError: the file cannot be opened.
        ValueError: it is no npz file, is damaged, or unpacks to more than 256 MiB and 100 times
            its size.
    """
    with path.open("rb") as file:
        if not zipfile.is_zipfile(file):  # numpy would advise to unpickle it
            raise ValueError(f"{path} is not an npz file")
        try:
            with zipfile.ZipFile(file) as archive:
                size = sum(member.file_size for member in archive.infolist())
            if size <= max(_SMALL, _RATIO * path.stat().st_size):
                file.seek(0)
                with np.load(file, allow_pickle=False) as stored:
                    return {name: stored[name] for name in stored.files}
        except Exception as error:  # whatever zip, zlib and numpy raise of a damaged file
            raise ValueError(f"{path} is not an npz file, or damaged: {error}") from error
    raise ValueError(f"{path} unpacks to {size / 1e9:.1f} GB, which no file of this package does")


@contextmanager
def claimed(folder: Path) -> Iterator[None]:
    """Write into a folder alone: a second process that claims it is refused.

    The claim ends with its process, however that ends. Once it holds, what killed processes left
    half written is removed. A folder that it made and that stayed empty is removed at its end.
    Where the system has no `flock`, nothing is claimed.

    Raises:
        BlockingIOError: another process writes into the folder; the message names it.
        OSError: the folder cannot be made or written.
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
            with suppress(OSError):  # Windows keeps a lock that is open
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
            "for its end, end it, or choose another folder"
        ) from error
    lock.truncate(0)
    lock.write(str(os.getpid()))
    lock.flush()


def write_table(path: Path, rows: Sequence[Mapping[str, Any]]) -> None:
    """Write rows as CSV, whole or not at all; the first row's keys are the columns.

    Raises:
        OSError: the file cannot be written.
        ValueError: there is no row, or one has other keys.
    """
    if not rows:
        raise ValueError(f"there is no row to write into {str(path)!r}")
    with written_whole(path) as partial, partial.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)


def pyarrow(what: str, otherwise: str) -> tuple[Any, Any]:
    """Give the packages pyarrow and pyarrow.parquet, which read and write Parquet.

    Args:
        what: needs them, for the message.
        otherwise: how to do without, likewise.

    Raises:
        ImportError: they are not installed; the message says how to get them.
    """
    try:
        return importlib.import_module("pyarrow"), importlib.import_module("pyarrow.parquet")
    except ImportError as error:
        raise ImportError(
            f"{what} needs pyarrow; install it by: pip install 'swarm-envs[parquet]', or "
            f"{otherwise}"
        ) from error
