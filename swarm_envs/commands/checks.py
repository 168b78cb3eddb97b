"""Checks of a command's options before the command begins its work."""

from __future__ import annotations

import importlib.util
import os
import sys
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any


class Misuse(ValueError):
    """Options with which a command cannot run, detected before it begins."""


@contextmanager
def as_misuse(*kinds: type[Exception]) -> Iterator[None]:
    """Convert ValueError, and exceptions of these kinds, to Misuse."""
    expected: tuple[type[Exception], ...] = (ValueError, *kinds)
    try:
        yield
    except expected as error:
        raise Misuse(str(error)) from error


def check_folder(option: str, folder: Path) -> None:
    """Raise Misuse if a folder cannot be created or written."""
    _check_writable(f"{option} is {str(folder)!r}", folder)


def check_file(option: str, file: Path, suffixes: tuple[str, ...] = ()) -> None:
    """Raise Misuse if a file cannot be written, or has none of the allowed suffixes."""
    given = f"{option} is {str(file)!r}"
    if suffixes and file.suffix not in suffixes:
        raise Misuse(f"{given}, but must end in {' or '.join(suffixes)}")
    if _exists(given, file) and file.is_dir():
        raise Misuse(f"{given}, but that is a folder; name a file")
    _check_writable(given, file.absolute().parent)


def output_files(options: Any, kinds: Mapping[str, tuple[str, ...]]) -> dict[str, Path]:
    """Return the output files of a command by option; `--out` is a folder for all of them.

    Args:
        options: the command's options, with the fields `out` and every name in `kinds`; a field
            is None if the option was not given.
        kinds: for each option, the file's name in the folder, and the allowed suffixes.

    Raises:
        Misuse: a suffix is not allowed, or a file cannot be written.
    """
    files = {}
    if options.out is not None:
        check_folder("--out", options.out)
    for option, (name, *suffixes) in kinds.items():
        path = getattr(options, option)
        if path is None and options.out is not None:
            path = options.out / name
        if path is not None:
            check_file(f"--{option}", path, tuple(suffixes))
            files[option] = path
    return files


def check_outputs(out: Path, json: Path | None, suffixes: tuple[str, ...] = ()) -> None:
    """Raise Misuse if the folder `--out` or the file `--json` cannot be written."""
    check_folder("--out", out)
    if json is not None:
        check_file("--json", json, suffixes)


def _exists(given: str, path: Path) -> bool:
    try:
        return path.exists()
    except OSError as error:  # such as a name that is too long
        raise Misuse(f"{given}, but that cannot be accessed: {error.strerror}") from error


def _check_writable(given: str, folder: Path) -> None:
    """Raise Misuse if no temporary file can be written to the folder or its nearest parent.

    Permission bits are not enough: a file system may be read-only, and root may write anywhere.
    """
    tree = (folder, *folder.absolute().parents)
    existing = next(path for path in tree if _exists(given, path))
    if not existing.is_dir():
        raise Misuse(f"{given}, but {str(existing)!r} is a file; name a folder")
    try:
        with tempfile.TemporaryFile(dir=existing):
            pass
    except OSError as error:
        raise Misuse(
            f"{given}, but {str(existing)!r} cannot be written: {error.strerror}"
        ) from error


def check_inputs(options: Any) -> None:
    """Raise Misuse if the data, a force model or an agent that an option names does not exist."""
    from swarm_envs.agents import load as load_agent
    from swarm_envs.interactions import load

    data = getattr(options, "data", None)
    if data is not None and not data.exists():
        raise Misuse(f"--data is {str(data)!r}, but there is no such file or folder")
    readers = {"interactions": load, "feedforward": load, "agent": load_agent, "start": load_agent}
    for name, read in readers.items():
        value = getattr(options, name, None)
        if isinstance(value, str | Path):
            with as_misuse(FileNotFoundError):
                read(value)


def need_torch() -> None:
    """Raise ImportError if torch is not installed."""
    if importlib.util.find_spec("torch") is None:
        raise ImportError(
            "training needs torch; install it by: pip install 'swarm-envs[train]' "
            "(without a GPU, install a CPU build of torch first)"
        )


def forget_output() -> None:
    """Discard output that cannot be written, so that Python's exit does not fail on it again."""
    try:
        sys.stdout.flush()
    except (OSError, ValueError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
