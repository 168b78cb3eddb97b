"""Jobs for the tests of workers: each is done in a moment, or goes wrong in a way of its own."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any


def square(value: float) -> dict[str, float]:
    """A result that floats of JSON must carry to the last bit."""
    print("agents may print")
    return {"value": value, "square": value * value / 3.0}


def fails(value: float) -> None:
    """As a job that cannot be done."""
    raise ValueError(f"nobody squares {value}")


def leaves() -> None:
    """As an agent that calls exit()."""
    raise SystemExit("bye")


def not_json() -> Any:
    """As a job that gives what JSON cannot say."""
    return float("nan")


def dies(folder: str, times: int) -> int:
    """Killed the first `times` times; says how often it was begun."""
    tries = Path(folder)
    number = len(list(tries.iterdir())) + 1
    (tries / f"{number}").touch()
    if number <= times:
        os.kill(os.getpid(), signal.SIGKILL)
    return number


def slow(folder: str, name: str, seconds: float) -> str:
    """Leaves a note of each time that it was begun, and takes its time."""
    (Path(folder) / f"{name}-{time.time_ns()}-{os.getpid()}").touch()
    time.sleep(seconds)
    return name


def waits(folder: str, name: str, gate: str) -> str:
    """Leaves such a note, and is done once there is a file `gate`."""
    slow(folder, name, 0.0)
    wait_for(Path(gate).exists)
    return name


def wait_for(condition: Callable[[], object]) -> None:
    """Wait until it holds, for ten minutes at most."""
    deadline = time.monotonic() + 600
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.01)


def alive(note: Path) -> bool:
    """Whether the process that left a note lives still."""
    status = Path("/proc") / note.name.rpartition("-")[2] / "stat"
    try:
        return status.read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False
