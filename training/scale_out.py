"""Episodes of agents flown in parallel, by processes of this machine or over a Ray cluster.

Workers fly chunks of seeds and return the episodes; only the calling process keeps them. Except for
the times of decisions, the results do not depend on the workers.
"""

from __future__ import annotations

import functools
import json
import multiprocessing
import os
import re
import signal
import socket
import threading
import traceback
from collections import deque
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass, replace
from multiprocessing.connection import Connection
from typing import Any, NamedTuple

from tqdm import tqdm

from swarm_envs import __version__
from swarm_envs.agents import Agent
from swarm_envs.agents.evaluation import AgentFailed, Episode, evaluate_agent, source_digest
from swarm_envs.agents.protocol import AT_ONCE
from swarm_envs.agents.registry import load_agent
from swarm_envs.arguments import Count, typed
from swarm_envs.envs.parallel import SwarmParallelEnv
from swarm_envs.training.scoreboard.tasks import make_scored

__all__ = ["Flight", "ScaleOptions", "WorkerDied", "fly_flights", "run_jobs"]

RETRIES = 3  # How often Ray restarts a chunk whose worker or node died
_FEW = 4  # Episodes in a chunk of an agent that flies one episode at a time
_REACHED_S = 10.0  # How long an address may take to answer; Ray itself would try for minutes
_ONE_THREAD = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
_ADDRESS = re.compile(r"(ray://)?(?P<host>[^\s/:]+):(?P<port>\d{1,5})")

Job = tuple[Any, Any]  # A key, and the argument of the function
Jobs = deque[Job]


class WorkerDied(RuntimeError):
    """A worker died while it did a job, and again when the job was repeated."""


@functools.partial(typed, owner="--")
@dataclass(frozen=True, kw_only=True)
class ScaleOptions:
    """Options for parallel evaluation; the results are the same."""

    workers: Count = 1
    """number of local processes"""
    ray: str | None = None
    """run on a Ray cluster: `auto` for the running one, `local` for a new one on this machine (with
    --workers processors, if more than 1), or an address, such as 10.0.0.1:6379"""

    def __post_init__(self) -> None:
        """Check what the annotations cannot say."""
        if self.ray not in (None, "local", "auto") and not _ADDRESS.fullmatch(self.ray):
            raise ValueError(
                f"--ray is {self.ray!r}, but must be 'auto', 'local', or host:port such as "
                "10.0.0.1:6379 or ray://10.0.0.1:10001"
            )
        if self.ray not in (None, "local") and self.workers > 1:
            raise ValueError(
                f"--workers is {self.workers}, but with --ray {self.ray} the cluster says how many "
                "there are; leave it out"
            )

    @property
    def alone(self) -> bool:
        """Return whether this process does everything."""
        return self.ray is None and self.workers == 1


@dataclass(frozen=True, kw_only=True)
class Flight:
    """An agent on a task with the seeds to be flown: all that any machine needs to fly them."""

    agent: str
    """Name, as of `swarm_envs.agents.load`."""
    digest: str
    """Of its source: what `source_digest` gives."""
    task: str
    """Versioned name of the environment."""
    setting: Mapping[str, Any]
    """Options of the environment, ready for JSON; those that the agent requires are added."""
    seeds: Sequence[int]
    """Of the episodes."""
    timed: int = 0
    """So many of the first seeds are flown one at a time, so that decisions are timed."""
    batched: bool = False
    """True if the agent flies many episodes at once."""
    refusals: bool = False
    """True if an episode that the agent refuses counts as one; see `fly_seed`."""
    version: str = __version__

    def chunks(self) -> Iterator[tuple[int, Flight]]:
        """Yield parts of the flight, each after the position of its first seed."""
        size = AT_ONCE if self.batched else _FEW
        for k in range(0, len(self.seeds), size):
            yield k, replace(self, seeds=self.seeds[k : k + size], timed=max(0, self.timed - k))


class Flown(NamedTuple):
    """The episodes of a chunk; fewer than its seeds if the agent failed, and then why."""

    episodes: list[Episode]
    error: str = ""
    trace: str = ""  # Where the agent failed, as Python prints it


def fly_flights(
    flights: Sequence[Flight], scale: ScaleOptions, keep: Callable[[int, list[Episode]], None]
) -> dict[int, Flown]:
    """Fly every seed of every flight, the first flights first.

    A flight in which the agent fails is given up, and the others go on. The failure is that of the
    first failing seed, as if the seeds had been flown in order.

    Args:
        flights: to be flown.
        scale: the workers.
        keep: called with the index of a flight and new episodes of it.

    Returns:
        By index of the flight, why it failed.

    Raises:
        ConnectionError: there is no such cluster.
        ImportError: a cluster is asked for, and Ray is not installed.
    """
    jobs: Jobs = deque(
        ((k, first), chunk) for k, flight in enumerate(flights) for first, chunk in flight.chunks()
    )
    failed: dict[int, tuple[int, Flown]] = {}
    with closing(run_jobs(fly_chunk, jobs, scale)) as results:
        for (k, first), result in results:
            if isinstance(result, WorkerDied):
                where = f"in the episodes of seeds {flights[k].seeds[first]} and on"
                result = Flown([], f"{where}: WorkerDied: {result}")
            if result.episodes:
                keep(k, result.episodes)
            place = first + len(result.episodes)
            if result.error and (k not in failed or place < failed[k][0]):
                failed[k] = place, result
                for job in [job for job in jobs if job[0][0] == k and job[0][1] > place]:
                    jobs.remove(job)
    return {k: flown for k, (_, flown) in failed.items()}


def fly_chunk(chunk: Flight) -> Flown:
    """Fly the seeds of a chunk in this process, in order."""
    episodes: list[Episode] = []
    try:
        if chunk.version != __version__:
            raise ValueError(
                f"a worker has swarm-envs {__version__}, but was asked by {chunk.version}; install "
                "the same version everywhere"
            )
        setting = json.dumps(dict(chunk.setting))
        agent, env = _prepare(chunk.agent, chunk.digest, chunk.task, setting)
        episodes.extend(
            evaluate_agent(env, agent, chunk.seeds, timed=chunk.timed, refusals=chunk.refusals)
        )
    except (Exception, SystemExit) as error:
        _prepare.cache_clear()
        said = str(error) if isinstance(error, AgentFailed) else f"{type(error).__name__}: {error}"
        trace = "".join(traceback.format_exception(error.__cause__ or error))
        return Flown(episodes, said, trace)
    return Flown(episodes)


@functools.lru_cache(maxsize=1)  # the next chunk is most often of the same flight
def _prepare(name: str, digest: str, task: str, setting: str) -> tuple[Agent, SwarmParallelEnv]:
    """Load an agent, and make its environment from options in JSON."""
    agent = load_agent(name)
    if source_digest(agent) != digest:
        raise ValueError(
            f"agent {name!r} is another here than where the command was given: all machines need "
            "the same packages, and the same files at the same paths"
        )
    return agent, make_scored(task, {**json.loads(setting), **agent.requires})


def run_jobs(
    function: Callable[[Any], Any], jobs: Jobs, scale: ScaleOptions
) -> Generator[tuple[Any, Any], None, None]:
    """Call a function for the jobs of a queue, and yield key and result as they come.

    Where a worker died each time, the result is a `WorkerDied`. Jobs may be removed from the queue
    between results.

    Args:
        function: of a module, so that workers can import it; called twice, it gives the same.
        jobs: from the left.
        scale: the workers.
    """
    if scale.ray is not None:
        return _by_ray(function, jobs, scale.ray, scale.workers if scale.workers > 1 else None)
    return _here(function, jobs) if scale.alone else _by_processes(function, jobs, scale.workers)


def _here(function: Callable[[Any], Any], jobs: Jobs) -> Generator[tuple[Any, Any], None, None]:
    while jobs:
        key, argument = jobs.popleft()
        yield key, function(argument)


def _by_processes(
    function: Callable[[Any], Any], jobs: Jobs, count: int
) -> Generator[tuple[Any, Any], None, None]:
    """Use a pool. When a process of it dies, what was under way is repeated, each job alone."""
    with _one_thread():
        while jobs:
            suspects = yield from _until_one_dies(function, jobs, count)
            for key, argument in suspects:
                yield key, _alone(function, argument)


def _until_one_dies(
    function: Callable[[Any], Any], jobs: Jobs, count: int
) -> Generator[tuple[Any, Any], None, list[Job]]:
    """Do jobs until the queue is empty or a process dies; return the jobs that were under way."""
    running: dict[Future[Any], Job] = {}
    with _processes(count) as pool:
        try:
            while jobs or running:
                while jobs and len(running) < count:
                    running[pool.submit(function, jobs[0][1])] = jobs[0]
                    jobs.popleft()
                for future in wait(running, return_when=FIRST_COMPLETED).done:
                    result = future.result()
                    yield running.pop(future)[0], result
        except BrokenProcessPool:
            return [*running.values()]
    return []


def _alone(function: Callable[[Any], Any], argument: Any) -> Any:
    with _processes(1) as pool:
        try:
            return pool.submit(function, argument).result()
        except BrokenProcessPool:
            return WorkerDied("the process that flew them died twice; is memory short?")


@contextmanager
def _processes(count: int) -> Iterator[ProcessPoolExecutor]:
    """Provide a pool whose processes end at once after an exception, or if this one is killed."""
    context = multiprocessing.get_context("spawn")
    lifeline, held = context.Pipe(duplex=False)
    pool = ProcessPoolExecutor(count, context, _start_process, (lifeline,))
    try:
        yield pool
    except BaseException:
        held.close()
        raise
    finally:
        pool.shutdown(cancel_futures=True)
        held.close()
        lifeline.close()


def _start_process(lifeline: Connection) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the driver
    tqdm.set_lock(threading.RLock())  # its own semaphore would outlive the process
    threading.Thread(target=_end_with_driver, args=(lifeline,), daemon=True).start()


def _end_with_driver(lifeline: Connection) -> None:
    with suppress(EOFError, OSError):
        lifeline.recv()  # nothing is ever sent: the other end is closed
    os._exit(0)


@contextmanager
def _one_thread() -> Iterator[None]:
    """Let processes that are started here use one thread each for linear algebra."""
    before = {name: os.environ.get(name) for name in _ONE_THREAD}
    os.environ.update(dict.fromkeys(_ONE_THREAD, "1"))
    try:
        yield
    finally:
        for name, value in before.items():
            os.environ.pop(name)
            if value is not None:
                os.environ[name] = value


def _by_ray(
    function: Callable[[Any], Any], jobs: Jobs, address: str, cpus: int | None
) -> Generator[tuple[Any, Any], None, None]:
    """Use the processors of a cluster. Ray restarts the jobs of workers and nodes that die."""
    try:
        import ray
    except ImportError as error:
        raise ImportError(
            "a cluster needs Ray; install it by: pip install 'swarm-envs[ray]' (or share the work "
            "among processes of this machine by --workers, without Ray)"
        ) from error
    ours = not ray.is_initialized()
    if ours:
        _connect(ray, address, cpus)
    remote = ray.remote(num_cpus=1, max_retries=RETRIES)(function)
    running: dict[Any, Any] = {}
    try:
        while jobs or running:
            room = max(1, 2 * int(ray.cluster_resources().get("CPU", 1)))  # the next is on its way
            while jobs and len(running) < room:
                key, argument = jobs.popleft()
                running[remote.remote(argument)] = key
            (done, *_), _ = ray.wait([*running])
            key = running.pop(done)
            try:
                result = ray.get(done)
            except ray.exceptions.RayError as error:
                result = WorkerDied(f"{type(error).__name__}: {error}")
            yield key, result
    finally:
        for reference in running:
            ray.cancel(reference, force=True)
        if ours:
            ray.shutdown()


def _connect(ray: Any, address: str, cpus: int | None) -> None:
    given: dict[str, Any] = {"log_to_driver": False, "logging_level": "WARNING"}
    if address == "local":
        given |= {"num_cpus": cpus, "include_dashboard": False}
    try:
        if named := _ADDRESS.fullmatch(address):
            place = named["host"], int(named["port"])
            socket.create_connection(place, timeout=_REACHED_S).close()
        ray.init(address=address, **given)
    except OSError as error:
        raise ConnectionError(
            f"no Ray cluster was found at {address!r} ({error}); start one by `ray start --head`, "
            "name its address, or use 'local' for one on this machine alone"
        ) from error
