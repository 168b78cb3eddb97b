"""The grader's side of a submission: its files, and the process in its sandbox."""

from __future__ import annotations

import math
import os
import shutil
import tempfile
import threading
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, NamedTuple

from swarm_envs.grading.pipes import Array, BadMessage, receive, send
from swarm_envs.grading.sandbox import Confined, Sandbox

MOST_SOURCE, MOST_FOLDER = 1 << 20, 1 << 28
"""Most bytes of a source file, and of the files that are copied with it."""
LONGEST = 500
"""Most characters of a submission's message."""
WORK_S, DECISION_S = 600.0, 30.0
"""Time until a submission's first decision, and again for all others, by default, and time for a
decision after the first, of one team or of many, s."""
_SPARE = 1 << 20  # Bytes that an answer may have in excess to be reported as wrong in shape
_DECISIONS = ("act", "batch", "plan")


class WorkFailed(RuntimeError):
    """A submission raised an exception, gave an invalid answer, took too long or ended."""


def printable(words: str) -> str:
    """Return a text on one line, with control characters escaped, of at most `LONGEST`."""
    shown = "".join(c if c.isprintable() else ascii(c)[1:-1] for c in words[: LONGEST + 1])
    return shown if len(shown) <= LONGEST else shown[: LONGEST - 1] + "…"


def path_of(name: str) -> Path:
    """Return the file or folder of a submission."""
    return Path(name.rpartition(":")[0] if ".py:" in name else name)


class Clock:
    """The time that a submission has left, for all its processes together.

    Args:
        work_s: the time until its first decision, and again for all others, s.
    """

    def __init__(self, work_s: float = WORK_S) -> None:
        self.work_s, self.left_s, self._decides = work_s, work_s, False

    def begin_decisions(self) -> None:
        """Restart the time at the first decision, after compilation."""
        if not self._decides:
            self.left_s, self._decides = self.work_s, True


class Entry(NamedTuple):
    """A submission, and the settings of its grading."""

    work: str  # Its name in the copy of its folder
    home: Path  # The copy
    sandbox: Sandbox
    clock: Clock
    seeds: Sequence[int] = ()  # Seeds of the episodes
    shown: str | None = None  # Its name in the recording of the first failure; None for none

    @contextmanager
    def opened(self, flies: bool = False) -> Iterator[tuple[RemoteWork, dict[str, Any]]]:
        """Start the process of the submission, and end it with its descendants.

        Args:
            flies: True if it is an agent; else its class is called without arguments.

        Yields:
            The submission, and its attributes, which are not checked.

        Raises:
            WorkFailed: it cannot be loaded.
        """
        with tempfile.TemporaryDirectory(prefix="swarm-envs-") as folder:
            errors = Path(folder, "errors")
            with errors.open("ab") as file:
                process = Confined(self.sandbox, self.home, file, flies)
            work = RemoteWork(process, self.clock, errors)
            begin = {"flies": flies, "work": self.work, "memory": self.sandbox.memory}
            try:
                yield work, work.ask("begin", begin)[0]
            finally:
                work.close()


@contextmanager
def entered(
    name: str, expected: str, sandbox: Sandbox, clock: Clock, **more: Any
) -> Iterator[Entry]:
    """Copy a submission to a temporary folder.

    The other files of its folder are copied too if the file has the name of the assignment, because
    the folder is then the student's. A file with another name may be among files of others.

    Args:
        name: the name of the submission.
        expected: the name of submissions in the assignment, `file.py:Class`.
        sandbox: its sandbox.
        clock: its time.
        **more: other fields of the entry.

    Raises:
        WorkFailed: it is a link, no regular file, or too large.
    """
    path = path_of(name)
    with tempfile.TemporaryDirectory(prefix="swarm-envs-work-") as home:
        Path(home).chmod(0o755)  # the user in a container may differ
        _copy(path, path.is_dir() or path.name == path_of(expected).name, Path(home))
        chosen = f":{name.rpartition(':')[2]}" if path.suffix == ".py" else ""
        work = f"{path.name}{chosen}" if path.is_file() else "."
        yield Entry(work, Path(home), sandbox, clock, **more)


def _copy(path: Path, with_folder: bool, home: Path) -> None:
    if path.is_symlink() or path.parent.is_symlink():
        raise WorkFailed("it or its folder is a symbolic link; submit the file itself")
    if not (path.is_file() or path.is_dir()):
        raise WorkFailed("it is no regular file or folder; submit one")
    if path.suffix == ".py" and (size := path.stat().st_size) > MOST_SOURCE:
        raise WorkFailed(f"its source has {size} bytes, but may have at most {MOST_SOURCE}")
    if with_folder:
        _copy_folder(path if path.is_dir() else path.parent, home)
    else:
        shutil.copy(path, home)


def _copy_folder(folder: Path, home: Path) -> None:
    """Copy the regular files of a folder, without links, pipes and hidden files and folders."""
    left = MOST_FOLDER
    for place, folders, names in os.walk(folder):
        folders[:] = [name for name in folders if not name.startswith((".", "__pycache__"))]
        (home / Path(place).relative_to(folder)).mkdir(exist_ok=True)
        for file in (Path(place, name) for name in names if not name.startswith(".")):
            if file.is_symlink() or not file.is_file():
                continue
            size = file.stat().st_size
            left -= size + (MOST_FOLDER >> 12)  # so that there are at most 4096 files
            if left < 0:
                raise WorkFailed(
                    f"its folder has more than {MOST_FOLDER >> 20} MB, or too many files; submit "
                    "fewer, or grade it in a separate folder"
                )
            if file.suffix == ".py" and size > MOST_SOURCE:
                raise WorkFailed(
                    f"its source {file.name} has {size} bytes, but may have at most {MOST_SOURCE}"
                )
            shutil.copy(file, home / file.relative_to(folder))


class RemoteWork:
    """A submission in its process, which answers requests; created by `Entry.opened`."""

    def __init__(self, process: Confined, clock: Clock, errors: Path) -> None:
        self.process, self._clock, self._errors = process, clock, errors
        self._known, self._why = set[str](), ""
        self._until, self._over = math.inf, threading.Event()
        threading.Thread(target=self._watch, daemon=True).start()

    def _watch(self) -> None:
        """Kill the process if an answer is late, which closes its pipe."""
        while not self._over.wait(0.05):
            if time.monotonic() > self._until:
                self.process.kill()
                return

    def ask(
        self,
        kind: str,
        header: Mapping[str, Any] | None = None,
        arrays: Sequence[Array] = (),
        most: int = 0,
        limit_s: float = math.inf,
    ) -> tuple[dict[str, Any], list[Array]]:
        """Send a request, and return the answer; the wait counts against the submission's time.

        Args:
            kind: the kind of request.
            header: its header.
            arrays: its arrays.
            most: the largest size of the answer's arrays, bytes.
            limit_s: the time limit of this answer, s.

        Raises:
            WorkFailed: the submission failed.
        """
        clock, begun = self._clock, time.monotonic()
        limit = DECISION_S if kind in self._known else limit_s
        self._until = begun + min(limit, clock.left_s)
        try:
            if self._why:
                raise EOFError
            send(self.process.sink, kind, header, arrays)
            answer, given = receive(self.process.source, most + _SPARE)
        except (BadMessage, EOFError, OSError) as error:
            self._why = self._why or self._explained(error, limit)
            self.close()
            raise WorkFailed(self._why) from None
        finally:
            self._until = math.inf
            clock.left_s -= time.monotonic() - begun
        if answer["kind"] == "error":
            raise WorkFailed(printable(str(answer.get("words"))))
        if kind in _DECISIONS:
            clock.begin_decisions()
            self._known.add(kind)
        return answer, given

    def _explained(self, error: Exception, limit: float) -> str:
        """Return the reason that there is no answer."""
        if isinstance(error, BadMessage):
            return printable(f"gave an invalid answer: {error}")
        if time.monotonic() > self._until:
            slow = f"an answer took longer than {limit:g} s"
            most = f"took longer than {self._clock.work_s:g} s"
            return slow if limit < self._clock.left_s else most
        code = self.process.end(1.0)  # its pipe is closed, so it is about to end
        errors = self._errors.read_bytes()[-2000:].decode(errors="replace")
        lines = errors.strip().splitlines() or ["no message"]
        return printable(f"ended with exit code {code}: {lines[-1]}")

    def close(self) -> None:
        """End the process and its descendants."""
        self._over.set()
        self.process.end()
        for pipe in (self.process.sink, self.process.source):
            with suppress(OSError):
                pipe.close()
