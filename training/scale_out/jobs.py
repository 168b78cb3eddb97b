"""Pieces of work that may be done anywhere and twice, and who does them on this machine.

A job is a function by name and arguments that JSON can say, and so is what it gives: it crosses
processes and machines without a pickle, and is the same wherever it was done. Only the
process that hands out jobs keeps results; workers that die take nothing with them.
"""

from __future__ import annotations

import importlib
import json
import os
import signal
import subprocess
import sys
import threading
import traceback
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Iterator, Mapping
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from contextlib import suppress
from dataclasses import dataclass
from queue import SimpleQueue
from typing import Any, Self, TextIO

from swarm_envs import __version__
from swarm_envs.arguments import typed
from swarm_envs.errors import check_integer

__all__ = ["Job", "Serial"]

RETRIES = 3  # How often a job is restarted after the process or the machine that did it died
_ONE_THREAD = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


class WorkerDied(RuntimeError):
    """A worker died while it did a job, each time that it was tried. The message says how."""


@typed
@dataclass(frozen=True)
class Job:
    """A piece of work. Done twice it must give the same, or find that it was done."""

    function: str
    """`"module:function"`, imported where the work is done"""
    arguments: Mapping[str, Any]
    """of the function, by name, ready for JSON"""
    label: str = ""
    """what the driver knows it by; not sent"""

    def request(self) -> str:
        """The job as a line of JSON, which `answer` takes.

        Raises:
            TypeError: an argument is not ready for JSON.
            ValueError: an argument is NaN or infinite.
        """
        asked = {"function": self.function, "arguments": self.arguments, "version": __version__}
        return json.dumps(asked, allow_nan=False)


@dataclass(frozen=True)
class Outcome:
    """What became of a job."""

    job: Job  # What was to be done
    result: Any = None  # What the function gave, if there is no error
    error: str | None = None  # Why there is no result
    trace: str = ""
    """Where the function failed, as Python prints it; empty if it was not the function, or was an
    OSError."""


def answer(request: str) -> str:
    """Do a job, wherever this is, and give its answer as a line of JSON.

    An exception of the function is part of the answer; raised, each retry would raise it again.
    """
    try:
        asked = json.loads(request)
        if asked["version"] != __version__:
            raise RuntimeError(
                f"a worker has swarm-envs {__version__}, but was asked by {asked['version']}; "
                "install the same version everywhere"
            )
        module, _, name = asked["function"].partition(":")
        result = getattr(importlib.import_module(module), name)(**asked["arguments"])
        return json.dumps({"result": result}, allow_nan=False)
    except (Exception, SystemExit) as error:
        why = f"{type(error).__name__}: {error}"
        # An OSError is the fault of the disk or the network, not of the code.
        trace = "" if isinstance(error, OSError) else traceback.format_exc()
        return json.dumps({"error": why, "trace": trace})


class WorkerPool(ABC):
    """Who does jobs. A context: on leaving it, however, what is not done is given up."""

    @property
    @abstractmethod
    def size(self) -> int:
        """How many jobs may be under way at once."""

    @abstractmethod
    def submit(self, request: str) -> Future[str]:
        """Begin a job; the future has its answer, or raises if no worker outlived it."""

    @abstractmethod
    def close(self) -> None:
        """Give up what is under way, at once."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def run(self, jobs: deque[Job]) -> Iterator[Outcome]:
        """Do jobs from the left of a queue until it is empty; give outcomes as they come.

        The queue may be changed between outcomes: what is added is done too, what is removed is
        not. A job that fails stops no other.
        """
        running: dict[Future[str], Job] = {}
        while jobs or running:
            while jobs and len(running) < self.size:
                job = jobs.popleft()
                running[self.submit(job.request())] = job
            for future in wait(running, return_when=FIRST_COMPLETED).done:
                job = running.pop(future)
                try:
                    outcome = Outcome(job, **json.loads(future.result()))
                except Exception as error:  # no worker outlived the job
                    outcome = Outcome(job, error=f"{type(error).__name__}: {error}")
                yield outcome


class Serial(WorkerPool):
    """This process, one job after the other: what all others must equal."""

    size = 1
    """Jobs that are done at a time."""

    def submit(self, request: str) -> Future[str]:
        """Do the job."""
        future: Future[str] = Future()
        future.set_result(answer(request))
        return future

    def close(self) -> None:
        """Nothing is under way."""


class _Process:
    """A process that answers requests, line by line, until its standard input ends."""

    def __init__(self) -> None:
        paths = os.pathsep.join(path or os.getcwd() for path in sys.path)  # noqa: PTH109
        self._process = subprocess.Popen(
            [sys.executable, "-c", f"from {__name__} import serve; serve()"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            env={**os.environ, **dict.fromkeys(_ONE_THREAD, "1"), "PYTHONPATH": paths},
            encoding="ascii",
            start_new_session=True,  # Ctrl-C is the driver's alone
        )

    def ask(self, request: str) -> str:
        """Give the answer to a request.

        Raises:
            WorkerDied: there is none, as the process has ended.
        """
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        line = ""
        with suppress(OSError):
            self._process.stdin.write(request + "\n")
            self._process.stdin.flush()
            line = self._process.stdout.readline()
        if not line.endswith("\n"):
            self.end()
            raise WorkerDied(_cause(self._process.returncode))
        return line

    @property
    def ended(self) -> bool:
        return self._process.returncode is not None

    def kill(self) -> None:
        """End the process whatever it does: no answer comes."""
        self._process.kill()

    def end(self) -> None:
        """Kill the process if it lives, and free what it held."""
        self._process.kill()
        self._process.wait()
        for stream in (self._process.stdin, self._process.stdout):
            assert stream is not None
            with suppress(OSError):  # what was not yet written to it has nobody to read it
                stream.close()


class LocalWorkers(WorkerPool):
    """So many processes, each on one thread. One that dies is replaced, and its job restarted.

    They end with this process, even if it is killed.

    Args:
        count: of processes.

    Raises:
        ValueError: the count is below one.
    """

    def __init__(self, count: int) -> None:
        self._count = check_integer("workers", count, 1)
        self._threads = ThreadPoolExecutor(self._count)
        self._processes: dict[int, _Process] = {}  # by the thread that waits for its answers
        self._lock = threading.Lock()
        self._closed = False

    @property
    def size(self) -> int:
        """The number of processes."""
        return self._count

    def submit(self, request: str) -> Future[str]:
        """Give the job to the next process that is idle."""
        return self._threads.submit(self._ask, request)

    def close(self) -> None:
        """Kill the processes."""
        with self._lock:
            self._closed = True
            for process in self._processes.values():
                process.kill()
        self._threads.shutdown(cancel_futures=True)
        for process in self._processes.values():
            process.end()
        self._processes.clear()

    def _ask(self, request: str) -> str:
        why = ""
        for _ in range(1 + RETRIES):
            try:
                return self._process().ask(request)
            except WorkerDied as death:
                why = str(death)
        raise WorkerDied(f"the process that did it died, {1 + RETRIES} times: {why}")

    def _process(self) -> _Process:
        """This thread's process, begun if it has none that lives."""
        with self._lock:
            if self._closed:
                raise WorkerDied("the workers were closed")
            process = self._processes.get(threading.get_ident())
            if process is None or process.ended:
                process = self._processes[threading.get_ident()] = _Process()
            return process


def _cause(code: int) -> str:
    if code >= 0:
        return f"it ended with exit code {code}"
    name = signal.Signals(-code).name
    hint = "; is memory short?" if -code == signal.SIGKILL else ""
    return f"killed by {name}{hint}"


def serve() -> None:
    """Answer requests, a line each, until the standard input ends: what a worker's process runs.

    It ends with the process that began it, in the middle of a job too. What jobs print goes to the
    standard error.
    """
    requests, answers = _take_streams()
    lines: SimpleQueue[str] = SimpleQueue()
    threading.Thread(target=_listen, args=(requests, lines), daemon=True).start()
    while True:
        answers.write(answer(lines.get()) + "\n")
        answers.flush()


def _take_streams() -> tuple[TextIO, TextIO]:
    """Keep standard input and output for jobs' lines; others find nothing there, or the error."""
    requests = os.fdopen(os.dup(0), encoding="ascii")
    answers = os.fdopen(os.dup(1), "w", encoding="ascii")
    nothing = os.open(os.devnull, os.O_RDONLY)
    os.dup2(nothing, 0)
    os.close(nothing)
    os.dup2(2, 1)
    return requests, answers


def _listen(requests: TextIO, lines: SimpleQueue[str]) -> None:
    for line in requests:
        lines.put(line)
    sys.stderr.flush()
    os._exit(0)  # the parent is gone, and nobody wants what is being done
