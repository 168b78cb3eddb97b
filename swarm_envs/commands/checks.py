"""Checks of a command's options before it begins its work."""

from __future__ import annotations

import importlib.util
import os
import sys
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from tqdm import tqdm


class Misuse(ValueError):
    """Options with which a command cannot do its job, found before it begins."""


@contextmanager
def as_misuse(*kinds: type[Exception]) -> Iterator[None]:
    """Turn ValueError, and errors of these kinds, into Misuse."""
    expected: tuple[type[Exception], ...] = (ValueError, *kinds)
    try:
        yield
    except expected as error:
        raise Misuse(str(error)) from error


class FlightBar:
    """Counts decisions in a bar that begins with the first: planning and compiling do not count."""

    def __init__(self, total: int) -> None:
        self._total = total
        self.bar: Any = None
        """From the first decision on."""

    def __call__(self, *_: object) -> None:
        """Count a decision."""
        if self.bar is None:
            self.bar = tqdm(total=self._total, desc="flight", unit="decision", mininterval=0.5)
        self.bar.update()

    def close(self) -> None:
        """End the bar."""
        if self.bar is not None:
            self.bar.close()


def check_folder(option: str, folder: Path) -> None:
    """Refuse a folder that cannot be made or written, before hours are spent on its content."""
    _check_writable(f"{option} is {str(folder)!r}", folder)


def check_file(option: str, file: Path, suffixes: tuple[str, ...] = ()) -> None:
    """Refuse a file that cannot be written, or whose name ends otherwise than it may."""
    given = f"{option} is {str(file)!r}"
    if suffixes and file.suffix not in suffixes:
        raise Misuse(f"{given}, but must end in {' or '.join(suffixes)}")
    if _exists(given, file) and file.is_dir():
        raise Misuse(f"{given}, but that is a folder; name a file")
    _check_writable(given, file.absolute().parent)


def output_files(options: Any, kinds: Mapping[str, tuple[str, ...]]) -> dict[str, Path]:
    """Files that a command is to write, by their options; `--out` is a folder for all of them.

    Args:
        options: of the command: `out`, and one of each name in `kinds`; None where not given.
        kinds: by option the name in the folder, empty if it is not written there, then the
            suffixes that are allowed.

    Raises:
        Misuse: a wrong suffix, or a place that cannot be written.
    """
    files = {}
    if options.out is not None:
        check_folder("--out", options.out)
    for option, (name, *suffixes) in kinds.items():
        path = getattr(options, option)
        if path is None and options.out is not None and name:
            path = options.out / name
        if path is not None:
            check_file(f"--{option}", path, tuple(suffixes))
            files[option] = path
    return files


def check_outputs(out: Path, json: Path | None, suffixes: tuple[str, ...] = ()) -> None:
    """Refuse an `--out` that is no folder to write into, or a `--json` that is no such file."""
    check_folder("--out", out)
    if json is not None:
        check_file("--json", json, suffixes)


def _exists(given: str, path: Path) -> bool:
    try:
        return path.exists()
    except OSError as error:  # such as a name that is too long
        raise Misuse(f"{given}, which cannot be reached: {error.strerror}") from error


def _check_writable(given: str, folder: Path) -> None:
    """Write a file in the folder, or where it would be made, and forget it.

    Permissions do not say all: a file system may be read-only, and root may do anything.
    """
    tree = (folder, *folder.absolute().parents)
    existing = next(path for path in tree if _exists(given, path))
    if not existing.is_dir():
        raise Misuse(f"{given}, but {str(existing)!r} is a file; name a folder")
    try:
        with tempfile.TemporaryFile(dir=existing):
            pass
    except OSError as error:
        what = f"{str(existing)!r} cannot be written: {error.strerror}"
        raise Misuse(f"{given}, but {what}") from error


def check_inputs(options: Any) -> None:
    """Refuse options that name data, a force model or an agent that is not there."""
    from swarm_envs.agents import load as load_agent
    from swarm_envs.interactions import load

    data = getattr(options, "data", None)
    if data is not None and not data.exists():
        raise Misuse(f"--data is {str(data)!r}, but there is no such file or folder")
    forces = (("interactions", load), ("feedforward", load))
    named = (*forces, ("agent", load_agent), ("start", load_agent))
    for name, read in named:
        value = getattr(options, name, None)
        if isinstance(value, str | Path):
            with as_misuse(FileNotFoundError):
                read(value)


def need_torch() -> None:
    """Refuse to train where torch is not installed."""
    if importlib.util.find_spec("torch") is None:
        raise ImportError(
            "training needs torch; install it by: pip install 'swarm-envs[train]' "
            "(and where CUDA is not wanted, a CPU build of torch first)"
        )


def forget_output() -> None:
    """Let the end of the process not fail a second time over what it could not print."""
    try:
        sys.stdout.flush()
    except (OSError, ValueError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
