"""Jobs in other processes of this machine, without Ray."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress

from swarm_envs.errors import check_integer
from swarm_envs.training.scale_out.jobs import RETRIES, WorkerDied, Workers

_ONE_THREAD = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


class _Process:
    """A process that answers requests, line by line, until its standard input ends."""

    def __init__(self) -> None:
        paths = os.pathsep.join(path or os.getcwd() for path in sys.path)  # noqa: PTH109
        self._process = subprocess.Popen(
            [sys.executable, "-m", "swarm_envs.training.scale_out.worker"],
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

    def kill(self) -> None:
        """End the process whatever it does; who waits for its answer is told."""
        self._process.kill()

    def end(self) -> None:
        """Kill the process if it lives, and free what it held."""
        self._process.kill()
        self._process.wait()
        for stream in (self._process.stdin, self._process.stdout):
            assert stream is not None
            with suppress(OSError):  # what was not yet written to it has nobody to read it
                stream.close()


class LocalWorkers(Workers):
    """So many processes, each on one thread. One that dies is replaced, and its job begun anew.

    They end with this process, even if it is killed.

    Args:
        count: of processes.
        retries: how often a job is begun anew after the process that did it has died.

    Raises:
        ValueError: the count is below one, or the retries negative.
    """

    def __init__(self, count: int, retries: int = RETRIES) -> None:
        self._count = check_integer("workers", count, 1)
        self._retries = check_integer("retries", retries, 0)
        self._threads = ThreadPoolExecutor(self._count)
        self._own = threading.local()  # the process of each thread
        self._processes: set[_Process] = set()
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
            for process in self._processes:
                process.kill()
        self._threads.shutdown(cancel_futures=True)
        for process in self._processes:
            process.end()
        self._processes.clear()

    def _ask(self, request: str) -> str:
        why = ""
        for _ in range(1 + self._retries):
            process = self._process()
            try:
                return process.ask(request)
            except WorkerDied as death:
                why = str(death)
                with self._lock:
                    self._processes.discard(process)
                    self._own.process = None
        raise WorkerDied(f"the process that did it died, {1 + self._retries} times: {why}")

    def _process(self) -> _Process:
        """This thread's process, begun if it has none."""
        with self._lock:
            if self._closed:
                raise WorkerDied("the workers were closed")
            process: _Process | None = getattr(self._own, "process", None)
            if process is None:
                process = self._own.process = _Process()
                self._processes.add(process)
            return process


def _cause(code: int) -> str:
    """An exit code in words."""
    if code >= 0:
        return f"it ended with exit code {code}"
    name = signal.Signals(-code).name
    hint = "; is memory short?" if -code == signal.SIGKILL else ""
    return f"killed by {name}{hint}"
