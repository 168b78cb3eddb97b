"""Commands with somewhere bad to write to: `python -m tests.robustness.outputs`.

Each command of `tests.robustness.kills` is run in each of the situations below, in a folder where
something lies already. It must end as the situation asks: with another exit code than 0 and one
line that says why, what was there before as it was and nothing half written beside it; or with its
work done. Disks that are full or read-only are real ones, in memory; to mount them takes root.
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
from functools import partial
from pathlib import Path
from types import FrameType
from typing import NamedTuple

from tqdm import tqdm

from swarm_envs.cli import main as command_line
from tests.robustness.kills import COMMANDS, Run, differences

PATIENCE_S = 600  # A command that takes longer hangs
FILES = {"export": "learned.h", "fly": "flight.npz", "show": "show.skyc"}
"""Files that a command replaces, whoever wrote them."""
NOTE, BEFORE = "note.txt", b"what was there before"
BARS = re.compile(r"%\||\?|it/s|kernels, once|pybullet build|phase|episode/s|^\s*$")
"""Lines of progress."""


class Ended(NamedTuple):
    """How a command ended."""

    code: int
    said: list[str]  # Lines of its standard error that are no progress


class Trial(NamedTuple):
    """A command, and what it does where nothing is amiss."""

    job: Run
    file: str  # What it replaces; "" for nothing
    whole: Path  # What it writes
    took_s: float  # How long it takes

    def run(
        self,
        out: Path,
        prepare: Callable[[], object] = lambda: None,
        after: Callable[[int], object] = lambda child: None,
    ) -> Ended:
        """Run it in a process of its own, which has everything loaded already."""
        with tempfile.TemporaryFile() as error:
            ready, tell = os.pipe()
            child = os.fork()
            if child == 0:
                _become(self.job, out, prepare, error.fileno(), tell)
            os.close(tell)
            os.read(ready, 1)
            os.close(ready)
            after(child)
            status = _wait(child)
            error.seek(0)
            text = error.read().decode(errors="replace").replace("\r", "\n")
        said = [line for line in text.splitlines() if not BARS.search(line)]
        return Ended(os.waitstatus_to_exitcode(status), said)

    def prepare(self, out: Path) -> Path:
        """Put something where it will write."""
        out.mkdir(parents=True, exist_ok=True)
        for name in filter(None, (NOTE, self.file)):
            (out / name).write_bytes(BEFORE)
        return out

    def check_kept(self, out: Path) -> None:
        """What was there is there still, and nothing half written beside it."""
        for name in filter(None, (NOTE, self.file)):
            assert (out / name).read_bytes() == BEFORE, f"{name} is lost"
        check_whole(out)

    def check_done(self, out: Path, found: Ended) -> None:
        """It has done its work."""
        assert found.code == 0, found
        different = [name for name in differences(self.whole, out) if name != NOTE]
        assert not different, f"differ: {different}"


def check_whole(out: Path) -> None:
    """Nothing half written lies there."""
    left = [file.name for file in out.rglob("*.partial*")]
    assert not left, f"left behind: {left}"


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


def _become(job: Run, out: Path, prepare: Callable[[], object], error: int, tell: int) -> None:
    """Be a command's process, and end as the interpreter does."""
    code = 99
    try:
        os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
        os.dup2(error, 2)
        prepare()
        os.close(tell)  # its reader goes on
        try:
            code = job(out)
        except SystemExit as end:
            code = end.code if isinstance(end.code, int) else 1
        sys.stdout.flush()
    except BaseException:
        os.write(2, traceback.format_exc().encode())
    os._exit(code)


def refused(found: Ended, why: str, code: int = 0) -> None:
    """A command says in one line why it did not do its work."""
    assert found.code == code if code else found.code not in (0, 99), found
    assert len(found.said) == 1 and re.search(why, found.said[0]), found


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


def full(trial: Trial, folder: Path) -> None:
    """The disk is full before anything can be written."""
    with disk(folder / "disk", 64) as small:
        out = trial.prepare(small / "run")
        with suppress(OSError):
            (small / "ballast").write_bytes(b"x" * 2**20)
        refused(trial.run(out), "No space left|cannot be written")
        trial.check_kept(out)


def read_only(trial: Trial, folder: Path) -> None:
    """The disk is read-only."""
    with disk(folder / "disk", 4096) as small:
        out = trial.prepare(small / "run")
        subprocess.run(["mount", "-o", "remount,ro", str(small)], check=True)
        refused(trial.run(out), "Read-only")
        trial.check_kept(out)


def signalled(number: int, trial: Trial, folder: Path) -> None:
    """Ctrl-C, or SIGTERM, in the midst of its work: the same command then does the rest."""
    out = trial.prepare(folder / "run")

    def press(child: int) -> None:
        time.sleep(0.3 * trial.took_s)
        os.kill(child, number)

    def prepare() -> None:
        signal.signal(signal.SIGINT, _interrupt)
        signal.signal(signal.SIGTERM, _interrupt)

    found = trial.run(out, prepare, press)
    if found.code != 0:  # else it was done by then
        refused(found, "interrupted|terminated", code=130)
        assert (out / NOTE).read_bytes() == BEFORE
        check_whole(out)
        found = trial.run(out)
    trial.check_done(out, found)


def _interrupt(number: int, frame: FrameType | None) -> None:
    """Interrupt the command; before it begins, and after it has ended, there is nothing to do."""
    while frame is not None:
        if frame.f_code is command_line.__code__:
            raise KeyboardInterrupt
        frame = frame.f_back


def deleted(trial: Trial, folder: Path) -> None:
    """Its folder is removed in the midst of its work: the same command then does it anew."""
    out = trial.prepare(folder / "run")

    def remove(child: int) -> None:
        time.sleep(0.3 * trial.took_s)
        shutil.rmtree(out, ignore_errors=True)

    found = trial.run(out, after=remove)
    if found.code:
        why = "No such file|no weights file at|does not see"
        assert found.said and all(re.search(why, line) for line in found.said), found
    if not out.exists() or set(differences(trial.whole, out)) - {NOTE}:
        found = trial.run(out)
    trial.check_done(out, found)


def reader_gone(trial: Trial, folder: Path) -> None:
    """Who read what it prints is gone, as with `| head`."""
    read, write = os.pipe()
    os.close(read)
    found = trial.run(folder / "run", lambda: os.dup2(write, 1))
    os.close(write)
    refused(found, "Broken pipe")


def print_full(trial: Trial, folder: Path) -> None:
    """What it prints goes to a full disk."""
    found = trial.run(folder / "run", lambda: os.dup2(os.open("/dev/full", os.O_WRONLY), 1))
    refused(found, "No space left")


def strange_name(trial: Trial, folder: Path) -> None:
    """Spaces, letters of all kinds and a line break in the path."""
    found = trial.run(folder / "a b\n Ω\U0001f681'\"; $HOME %s" / "run")
    assert found.code == 0, found


def bare_environment(trial: Trial, folder: Path) -> None:
    """No HOME, a TMPDIR that is not there, and a terminal that nobody knows."""
    given = {"TMPDIR": str(folder / "none"), "TERM": "nobody", "COLUMNS": "0", "LANG": "C"}

    def prepare() -> None:
        os.environ.clear()
        os.environ.update(given)
        tempfile.tempdir = None

    trial.check_done(folder / "run", trial.run(folder / "run", prepare))


def taken(trial: Trial, folder: Path) -> None:
    """Another process writes into the folder; a single file is replaced, whoever comes last."""
    out = trial.prepare(folder / "run")
    with (out / ".lock").open("a+") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        found = trial.run(out)
    if found.code:
        refused(found, "writes into")
        trial.check_kept(out)


SITUATIONS: dict[str, Callable[[Trial, Path], None]] = {
    "disk full": full,
    "read-only": read_only,
    "Ctrl-C": partial(signalled, signal.SIGINT),
    "SIGTERM": partial(signalled, signal.SIGTERM),
    "folder deleted": deleted,
    "| head": reader_gone,
    "> /dev/full": print_full,
    "strange path": strange_name,
    "no HOME": bare_environment,
    "two at once": taken,
}


def trial_of(name: str, folder: Path) -> Trial:
    """Run a command in this process, so that those to come find all loaded, and in another."""
    job, file, whole = COMMANDS[name], FILES.get(name, ""), folder / "whole" / "run"
    assert job(folder / "warm" / "run") == 0
    begun = time.monotonic()
    found = Trial(job, file, whole, 0.0).run(whole)
    assert found.code == 0, found
    return Trial(job, file, whole, time.monotonic() - begun)


def main() -> int:
    """Run every command in every situation, print what is wrong, and count what is well."""
    names = sys.argv[1:] or list(COMMANDS)
    tqdm.monitor_interval = 0  # its thread may hold a lock at the moment of a fork
    ran = wrong = 0
    for name in names:
        with tempfile.TemporaryDirectory() as kept:
            trial = trial_of(name, Path(kept))
            for situation, test in SITUATIONS.items():
                ran += 1
                with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder:
                    try:
                        test(trial, Path(folder))
                    except AssertionError as error:
                        wrong += 1
                        print(f"{name}, {situation}: {str(error)[:600]}", flush=True)
    print(f"{ran - wrong} of {ran} as they should be")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
