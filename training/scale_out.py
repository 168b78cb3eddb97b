"""Parallel jobs in processes of this machine or on a Ray cluster."""

from __future__ import annotations

import multiprocessing
import os
import re
import signal
import socket
import threading
from collections.abc import Callable, Generator, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import islice
from typing import Any

from tqdm import tqdm

from swarm_envs.errors import check_integer

__all__ = ["ScaleOptions", "WorkerDied", "run_jobs"]

RETRIES = 3  # Number of restarts by Ray of a job whose worker or node died
_REACHED_S = 10.0  # Time limit for an address to answer; Ray itself would try for minutes
_ONE_THREAD = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
_ADDRESS = re.compile(r"(ray://)?(?P<host>[^\s/:]+):(?P<port>\d{1,5})")

Job = tuple[Any, Any]  # A key, and the argument of the function
Results = Generator[tuple[Any, Any], None, None]  # Keys and results of jobs


class WorkerDied(RuntimeError):
    """A worker died during a job, and again when the job was repeated."""


@dataclass(frozen=True, kw_only=True)
class ScaleOptions:
    """Options of parallel evaluation, which do not change the results."""

    workers: int = 1
    """Number of local processes."""
    ray: str | None = None
    """Run on a Ray cluster: `auto` is the running cluster, `local` starts one on this machine (with
    --workers processors if that is more than 1), and an address is such as 10.0.0.1:6379."""

    def __post_init__(self) -> None:
        """Raise ValueError for an invalid address, or for workers of an existing cluster."""
        check_integer("--workers", self.workers, at_least=1)
        if self.ray not in (None, "local", "auto") and not _ADDRESS.fullmatch(self.ray):
            raise ValueError(
                f"--ray is {self.ray!r}, but must be 'auto', 'local', or host:port such as "
                "10.0.0.1:6379 or ray://10.0.0.1:10001"
            )
        if self.ray not in (None, "local") and self.workers > 1:
            raise ValueError(
                f"--workers is {self.workers}, but the cluster --ray {self.ray} determines the "
                "number of workers; leave it out"
            )


def run_jobs(function: Callable[[Any], Any], jobs: Iterable[Job], scale: ScaleOptions) -> Results:
    """Call a function for jobs, and yield keys and results in order of completion.

    If a worker died twice, the result is a `WorkerDied`. Jobs are taken lazily, only as many as are
    running, so that later jobs may depend on earlier results. Closing the iterator ends the
    workers.

    Args:
        function: a deterministic function of a module, so that workers can import it.
        jobs: unique keys, and arguments.
        scale: the workers.

    Raises:
        ConnectionError: there is no such cluster.
        ImportError: a cluster is requested, and Ray is not installed.
    """
    if scale.ray is not None:
        return _by_ray(function, iter(jobs), scale)
    if scale.workers == 1:
        return ((key, function(argument)) for key, argument in jobs)
    return _by_processes(function, iter(jobs), scale.workers)


def _by_processes(function: Callable[[Any], Any], jobs: Iterator[Job], count: int) -> Results:
    """Use a pool. If a process dies, each job that was running is repeated separately."""
    while suspects := (yield from _until_one_dies(function, jobs, count)):
        for job in suspects:
            if (yield from _until_one_dies(function, iter([job]), 1)):
                yield job[0], WorkerDied("the worker process died twice; the memory may be full")


def _until_one_dies(
    function: Callable[[Any], Any], jobs: Iterator[Job], count: int
) -> Generator[tuple[Any, Any], None, list[Job]]:
    """Do jobs until there are none or a process dies; return the jobs that were running."""
    running: dict[Any, Any] = {}
    futures: dict[Future[Any], Any] = {}
    with _processes(count) as pool:
        try:
            while True:
                for key, argument in islice(jobs, count - len(futures)):
                    running[key] = argument
                    futures[pool.submit(function, argument)] = key
                if not futures:
                    return []
                for future in wait(futures, return_when=FIRST_COMPLETED).done:
                    result, key = future.result(), futures.pop(future)
                    del running[key]
                    yield key, result
        except BrokenProcessPool:
            return [*running.items()]


@contextmanager
def _processes(count: int) -> Iterator[ProcessPoolExecutor]:
    """Provide a pool whose processes end after an exception, or if this process is killed."""
    others = multiprocessing.active_children()
    spawn = multiprocessing.get_context("spawn")
    with _one_thread(), ProcessPoolExecutor(count, spawn, _start_process) as pool:
        try:
            yield pool
        except BaseException:
            for process in multiprocessing.active_children():
                if process not in others:
                    process.terminate()
            raise


def _start_process() -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the driver handles Ctrl-C
    tqdm.set_lock(threading.RLock())  # the default semaphore would outlive the process
    threading.Thread(target=_end_with_driver, daemon=True).start()


def _end_with_driver() -> None:
    driver = multiprocessing.parent_process()
    assert driver is not None
    driver.join()
    os._exit(0)


@contextmanager
def _one_thread() -> Iterator[None]:
    """Limit linear algebra to one thread in processes that are started here."""
    before = os.environ.copy()
    os.environ.update(dict.fromkeys(_ONE_THREAD, "1"))
    try:
        yield
    finally:
        for name in _ONE_THREAD:
            del os.environ[name]
            if name in before:
                os.environ[name] = before[name]


def _by_ray(function: Callable[[Any], Any], jobs: Iterator[Job], scale: ScaleOptions) -> Results:
    """Use the processors of a cluster; Ray restarts the jobs of workers and nodes that die."""
    with _cluster(scale) as ray:
        remote = ray.remote(num_cpus=1, max_retries=RETRIES)(function)
        running: dict[Any, Any] = {}
        while True:
            room = max(1, 2 * int(ray.cluster_resources().get("CPU", 1)))  # one queued per running
            for key, argument in islice(jobs, max(0, room - len(running))):
                running[remote.remote(argument)] = key
            if not running:
                return
            (done, *_), _ = ray.wait([*running])
            try:
                result = ray.get(done)
            except ray.exceptions.RayError as error:
                result = WorkerDied(f"{type(error).__name__}: {error}")
            yield running.pop(done), result


@contextmanager
def _cluster(scale: ScaleOptions) -> Iterator[Any]:
    """Provide a connection to Ray; leaving the context ends its jobs."""
    try:
        import ray
    except ImportError as error:
        raise ImportError(
            "a cluster needs Ray; install it by: pip install 'swarm-envs[ray]', or use --workers "
            "for processes of this machine without Ray"
        ) from error
    given: dict[str, Any] = {"log_to_driver": False, "logging_level": "WARNING"}
    if scale.ray == "local":
        cpus = scale.workers if scale.workers > 1 else None
        given |= {"num_cpus": cpus, "include_dashboard": False}
    try:
        if named := _ADDRESS.fullmatch(scale.ray or ""):
            place = named["host"], int(named["port"])
            socket.create_connection(place, timeout=_REACHED_S).close()
        connection = ray.init(address=scale.ray, **given)
    except OSError as error:
        raise ConnectionError(
            f"no Ray cluster was found at {scale.ray!r} ({error}); start one by `ray start "
            "--head`, name its address, or use 'local' for one on this machine alone"
        ) from error
    with connection:
        yield ray
