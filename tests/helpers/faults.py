"""A disk that fails at the n-th operation: opening, writing, syncing, renaming, removing ..."""

from __future__ import annotations

import builtins
import errno
import io
import os
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from types import FrameType
from typing import Any
from unittest import mock

from tests.helpers.sources import ROOT

NEVER = 1 << 60
_OPERATIONS = ("replace", "rename", "mkdir", "unlink", "fsync", "sendfile")  # of `os`


class FaultyDisk:
    """Counts what is done to files below a folder, and fails once, at the operation `fails_at`.

    Reading never fails. What was buffered when a write failed is lost, as on a full disk.
    """

    def __init__(self, folder: Path, fails_at: int = NEVER, error: type[Exception] = OSError):
        self.done: list[str] = []
        self.places: dict[tuple[Any, ...], list[int]] = {}
        """Numbers of the operations by the lines of the package that they come from."""
        self._folder, self._fails_at, self._error = str(folder), fails_at, error

    def step(self, what: str, path: Any) -> None:
        """Count an operation, and raise if it is the one that fails."""
        if isinstance(path, int):
            path = Path(f"/proc/self/fd/{path}").readlink()
        if not str(os.fspath(path)).startswith(self._folder):
            return
        self.done.append(what)
        self.places.setdefault((what, *_lines()), []).append(len(self.done))
        if len(self.done) == self._fails_at:
            if self._error is not OSError:
                raise self._error
            raise OSError(errno.ENOSPC, f"No space left on device ({what})", str(path))

    def ends(self) -> list[int]:
        """The first and the last operation of each place."""
        return sorted({n for numbers in self.places.values() for n in (numbers[0], numbers[-1])})

    @contextmanager
    def mounted(self) -> Iterator[FaultyDisk]:
        """Files are on this disk while the context lasts."""
        real, disk = io.open, self

        class Raw(io.FileIO):
            def write(self, data: Any) -> int:
                disk.step("write", self.name)
                return int(super().write(data) or 0)

        def faulty_open(file: Any, mode: str = "r", buffering: int = -1, *given: Any, **named: Any):
            own = isinstance(file, int) or "opener" in named  # as tempfile's are
            if own or not set(mode) & set("wxa+"):
                return real(file, mode, buffering, *given, **named)
            disk.step("open", file)
            raw = Raw(file, mode.replace("b", "").replace("t", ""))
            buffered: Any = io.BufferedRandom(raw) if "+" in mode else io.BufferedWriter(raw)
            names = ("encoding", "errors", "newline")
            options = {**dict(zip(names, given, strict=False)), **named}
            options = {name: options.get(name) for name in names}
            return buffered if "b" in mode else io.TextIOWrapper(buffered, **options)

        def noted(name: str) -> Any:
            function = getattr(os, name)

            def called(path: Any, *given: Any, **named: Any) -> Any:
                disk.step(name, path)
                return function(path, *given, **named)

            return called

        with ExitStack() as patches:
            for module in (io, builtins):
                patches.enter_context(mock.patch.object(module, "open", faulty_open))
            for name in _OPERATIONS:
                patches.enter_context(mock.patch.object(os, name, noted(name)))
            yield self


def _lines() -> tuple[tuple[str, int], ...]:
    """Where in the package this was called from."""
    frame: FrameType | None = sys._getframe(2)
    found: list[tuple[str, int]] = []
    while frame is not None:
        name = frame.f_code.co_filename
        if name.startswith(str(ROOT)) and "/tests/" not in name:
            found.append((name, frame.f_lineno))
        frame = frame.f_back
    return tuple(found)
