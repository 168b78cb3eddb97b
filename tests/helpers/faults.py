"""A disk that fails at the n-th operation: opening, writing, syncing, replacing, making folders."""

from __future__ import annotations

import builtins
import errno
import io
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from unittest import mock

NEVER = 1 << 60


class FaultyDisk:
    """Counts what is done to files below a folder, and fails once, at the operation `fails_at`.

    Reading never fails. What was buffered when a write failed is lost, as on a full disk.
    """

    def __init__(self, folder: Path, fails_at: int = NEVER) -> None:
        self.done: list[str] = []
        self._folder, self._fails_at = str(folder), fails_at

    def step(self, what: str, path: Any) -> None:
        """Count an operation, and raise OSError if it is the one that fails."""
        if isinstance(path, int) or not str(os.fspath(path)).startswith(self._folder):
            return
        self.done.append(what)
        if len(self.done) == self._fails_at:
            raise OSError(errno.ENOSPC, f"No space left on device ({what})", str(path))

    @contextmanager
    def mounted(self) -> Iterator[FaultyDisk]:
        """Files are on this disk while the context lasts."""
        real, replace, mkdir, fsync = io.open, os.replace, os.mkdir, os.fsync
        disk = self

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

        def noted(what: str, function: Any) -> Any:
            def called(path: Any, *given: Any, **named: Any) -> Any:
                disk.step(what, path)
                return function(path, *given, **named)

            return called

        def faulty_fsync(descriptor: int) -> None:
            disk.step("fsync", Path(f"/proc/self/fd/{descriptor}").readlink())
            fsync(descriptor)

        with (
            mock.patch.object(io, "open", faulty_open),
            mock.patch.object(builtins, "open", faulty_open),
            mock.patch.object(os, "replace", noted("replace", replace)),
            mock.patch.object(os, "mkdir", noted("mkdir", mkdir)),
            mock.patch.object(os, "fsync", faulty_fsync),
        ):
            yield self
