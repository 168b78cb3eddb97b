"""Jobs for the tests of workers: each takes a moment, or goes wrong in its own way."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Callable
from pathlib import Path


def square(value: float) -> float:
    """Return a result that must come back to the last bit."""
    return value * value / 3.0


def dies(folder: Path) -> float:
    """Leave a note, and be killed the first time."""
    note(folder, "dies")
    if len([*folder.iterdir()]) == 1:
        os.kill(os.getpid(), signal.SIGKILL)
    return 1.0


def waits(folder: Path) -> str:
    """Leave a note, and return once there is a file `gate` beside the folder."""
    note(folder, "waits")
    wait_for((folder.parent / "gate").exists)
    return "waited"


def small_job(job: tuple[str, float | Path]) -> float | str:
    """Call the function of this module that a job names."""
    name, argument = job
    return globals()[name](argument)


def note(folder: Path, name: str) -> None:
    """Leave a file that names this process."""
    (folder / f"{name}-{time.time_ns()}-{os.getpid()}").touch()


def wait_for(condition: Callable[[], object]) -> None:
    """Wait until a condition holds, for ten minutes at most."""
    deadline = time.monotonic() + 600
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.01)


def alive(file: Path) -> bool:
    """Return whether the process that left a note lives still."""
    status = Path("/proc") / file.name.rpartition("-")[2] / "stat"
    try:
        return status.read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False
