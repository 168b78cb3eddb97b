"""Commands with somewhere bad to write to: `python -m tests.robustness.outputs`.

Each of a few small commands is run in each of the situations below, where something was written
before. It must end as the situation asks: with another exit code than 0 and one line that says why,
what was there before as it was and nothing half written beside it; or with its work done. Disks
that are full or read-only are real ones, in memory; to mount them takes root.
"""

from __future__ import annotations

import fcntl
import os
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from types import FrameType
from typing import NamedTuple

from tqdm import tqdm

from swarm_envs.cli import main as command_line

FLY = ["fly", "--agent", "hover", "--physics", "batch", "--horizon-s", "1"]
COLLECT = ["collect", "--teams", "S", "--duration-s", "4", "--no-progress", "--walks", "1"]
COLLECT += ["--swaps", "0", "--low-walks", "0", "--low-swaps", "0"]
COMMANDS: dict[str, tuple[list[str], str]] = {
    "plan --out": (["plan", "--grid", "12x12x6"], ""),
    "plan --json": (["plan", "--grid", "12x12x6"], "plan.json"),
    "plan --save": (["plan", "--grid", "12x12x6"], "plan.npz"),
    "fly --json": (FLY, "flight.json"),
    "fly --trajectory": (FLY, "flight.npz"),
    "fly --replay": (FLY, "flight.html"),
    "fly --video": (FLY, "flight.gif"),
    "evaluate --out": (["evaluate", "--agent", "hover", "--episodes", "3", "--horizon-s", "1"], ""),
    "evaluate --json": (
        ["evaluate", "--agent", "hover", "--episodes", "3", "--horizon-s", "1"],
        "report.json",
    ),
    "export force --out": (["export", "force"], "learned.h"),
    "collect --out": (COLLECT, ""),
}
"""Commands, small, whose name ends in the option that says where to write, and what: a file of this
name, or a folder."""
PATIENCE_S = 300
"""A command that takes longer hangs."""
BEFORE = b"what was there before"
BARS = re.compile(r"%\||\?|it/s|kernels, once|pybullet build|phase|episode/s|^\s*$")
"""Lines of progress."""


class Ended(NamedTuple):
    """How a command ended."""

    code: int
    said: list[str]
    """Lines of its standard error that are no progress."""


def nothing(*_: object) -> None:
    """Prepare nothing."""


def run(
    name: str,
    folder: Path,
    prepare: Callable[[], object] = nothing,
    after: Callable[[int], object] = nothing,
) -> Ended:
    """Run a command in a process of its own, which has everything loaded already."""
    words, file = COMMANDS[name]
    target = folder / file if file else folder
    with tempfile.TemporaryFile() as error:
        ready, tell = os.pipe()
        child = os.fork()
        if child == 0:
            _become([*words, name.split()[-1], str(target)], prepare, error.fileno(), tell)
        os.close(tell)
        os.read(ready, 1)
        os.close(ready)
        after(child)
        status = _wait(child)
        error.seek(0)
        text = error.read().decode(errors="replace").replace("\r", "\n")
    said = [line for line in text.splitlines() if not BARS.search(line)]
    return Ended(os.waitstatus_to_exitcode(status), said)


def _wait(child: int) -> int:
    """The status with which a process ended; killed after `PATIENCE_S`."""
    until = time.monotonic() + PATIENCE_S
    while True:
        ended, status = os.waitpid(child, os.WNOHANG)
        if ended:
            return status
        if time.monotonic() > until:
            os.kill(child, signal.SIGKILL)
        time.sleep(0.005)


def _become(words: list[str], prepare: Callable[[], object], error: int, tell: int) -> None:
    """Be a command's process, and end as the interpreter does."""
    code = 99
    try:
        os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
        os.dup2(error, 2)
        prepare()
        os.close(tell)  # its reader goes on
        try:
            code = command_line(words)
        except SystemExit as end:
            code = end.code if isinstance(end.code, int) else 1
        sys.stdout.flush()
    except BaseException:
        os.write(2, traceback.format_exc().encode())
    os._exit(code)


@contextmanager
def disk(folder: Path, kib: int) -> Iterator[Path]:
    """A file system of so many KiB, mounted."""
    folder.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", f"size={kib}k", "tmpfs", str(folder)]
    subprocess.run(mount, check=True)
    try:
        yield folder
    finally:
        subprocess.run(["umount", "-l", str(folder)], check=True)


def full(name: str, folder: Path) -> Ended:
    """The disk is full before anything can be written."""
    with disk(folder / "disk", 64) as small:
        before = note(name, small)
        with suppress(OSError):
            (small / "ballast").write_bytes(b"x" * 2**20)
        found = run(name, small)
        check_kept(before)
    return refused(found, "No space left|cannot be written")


def read_only(name: str, folder: Path) -> Ended:
    """The disk is read-only."""
    with disk(folder / "disk", 4096) as small:
        before = note(name, small)
        subprocess.run(["mount", "-o", "remount,ro", str(small)], check=True)
        found = run(name, small)
        check_kept(before)
    return refused(found, "Read-only")


def interrupted(name: str, folder: Path) -> Ended:
    """Ctrl-C at some moment of its work: also between the last write and the end."""
    (whole := folder / "whole").mkdir()
    run(name, whole)
    before = note(name, folder)

    def press(child: int) -> None:
        time.sleep(0.02)
        os.kill(child, signal.SIGINT)

    found = run(name, folder, lambda: signal.signal(signal.SIGINT, _interrupt), press)
    if found.code == 0:  # it was done by then
        return found
    if before.read_bytes() == BEFORE:
        check_kept(before)
    else:  # it was written by then: whole, but for digits of a wall time
        size, full_size = before.stat().st_size, (whole / before.name).stat().st_size
        assert abs(size - full_size) <= 8, f"{before.name} has {size} bytes of {full_size}"
    return refused(found, "interrupted", code=130)


def _interrupt(number: int, frame: FrameType | None) -> None:
    """Interrupt the command; before it begins, and after it has ended, there is nothing to do."""
    while frame is not None:
        if frame.f_code is command_line.__code__:
            raise KeyboardInterrupt
        frame = frame.f_back


def reader_gone(name: str, folder: Path) -> Ended:
    """Who read what it prints is gone, as with `| head`."""
    read, write = os.pipe()
    os.close(read)
    found = run(name, folder, lambda: os.dup2(write, 1))
    os.close(write)
    return refused(found, "Broken pipe")


def print_full(name: str, folder: Path) -> Ended:
    """What it prints goes to a full disk."""
    found = run(name, folder, lambda: os.dup2(os.open("/dev/full", os.O_WRONLY), 1))
    return refused(found, "No space left")


def strange_name(name: str, folder: Path) -> Ended:
    """Spaces, letters of all kinds and a line break in the path."""
    found = run(name, folder / "a b\n Ω\U0001f681'\"; $HOME %s")
    assert found.code == 0, found
    return found


def bare_environment(name: str, folder: Path) -> Ended:
    """No HOME, a TMPDIR that is not there, and a terminal that nobody knows."""
    given = {"TMPDIR": str(folder / "none"), "TERM": "nobody", "COLUMNS": "0", "LANG": "C"}

    def prepare() -> None:
        os.environ.clear()
        os.environ.update(given)
        tempfile.tempdir = None

    found = run(name, folder / "out", prepare)
    assert found.code == 0, found
    return found


def taken(name: str, folder: Path) -> Ended:
    """Another process writes into the folder."""
    if COMMANDS[name][1]:
        return Ended(0, [])  # a file is replaced whole, by whoever comes last
    with (folder / ".lock").open("a+") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        found = run(name, folder)
    return refused(found, "writes into")


SITUATIONS = {
    "disk full": full,
    "read-only": read_only,
    "Ctrl-C": interrupted,
    "| head": reader_gone,
    "> /dev/full": print_full,
    "strange path": strange_name,
    "no HOME": bare_environment,
    "two at once": taken,
}


def note(name: str, folder: Path) -> Path:
    """Something where the command would write, or beside it."""
    path = folder / (COMMANDS[name][1] or "note.txt")
    path.write_bytes(BEFORE)
    return path


def check_kept(path: Path) -> None:
    """What was there is there still, and nothing half written beside it."""
    assert path.read_bytes() == BEFORE, f"{path.name} is lost"
    left = [file.name for file in path.parent.rglob("*.partial*")]
    assert not left, f"left behind: {left}"


def refused(found: Ended, why: str, code: int = 0) -> Ended:
    """A command that says in one line why it did not do its work."""
    assert found.code == code if code else found.code not in (0, 99), found
    assert len(found.said) == 1 and re.search(why, found.said[0]), found
    return found


def main() -> int:
    """Run every command in every situation, print a table, and say whether all was well."""
    names = sys.argv[1:] or list(COMMANDS)
    tqdm.monitor_interval = 0  # its thread may hold a lock at the moment of a fork
    wrong: list[str] = []
    counts = {"ran": 0, "well": 0}
    for name in names:
        with tempfile.TemporaryDirectory() as folder:
            warm = run_here(name, Path(folder))
        assert warm == 0, f"{name} ends with {warm}"
        for situation, test in SITUATIONS.items():
            folder_path = Path(tempfile.mkdtemp())
            counts["ran"] += 1
            try:
                test(name, folder_path)
                counts["well"] += 1
            except AssertionError as error:
                wrong.append(f"{name}, {situation}: {str(error)[:600]}")
                print(wrong[-1], flush=True)
            shutil.rmtree(folder_path, ignore_errors=True)
    print(f"{counts['well']} of {counts['ran']} as they should be")
    return 1 if wrong else 0


def run_here(name: str, folder: Path) -> int:
    """Run a command in this process, so that those to come find all loaded and compiled."""
    words, file = COMMANDS[name]
    return command_line([*words, name.split()[-1], str(folder / file if file else folder)])


if __name__ == "__main__":
    sys.exit(main())
