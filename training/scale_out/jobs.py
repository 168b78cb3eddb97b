"""Pieces of work that may be done anywhere and twice, and the loop that gets them done.

A job is a function by name and arguments that JSON can say, and so is what it gives: it crosses
processes and machines without a pickle of ours, and is the same wherever it was done. Whoever runs
jobs keeps their results alone, in one process; workers that die take nothing with them.
"""

from __future__ import annotations

import importlib
import json
import traceback
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Iterator, Mapping
from concurrent.futures import FIRST_COMPLETED, Future, wait
from dataclasses import dataclass
from types import TracebackType
from typing import Any, Self

from swarm_envs import __version__
from swarm_envs.arguments import typed

RETRIES = 3
"""How often a job is begun anew after the process or the machine that did it died."""


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

    job: Job
    """What was to be done."""
    result: Any = None
    """What the function gave, if there is no error."""
    error: str | None = None
    """Why there is no result."""
    trace: str = ""
    """Where the function failed, as Python prints it; empty if it was not the function."""


def answer(request: str) -> str:
    """Do a job, wherever this is, and give its answer as a line of JSON.

    What the function raises is told, not raised: it would be raised again by every retry.
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
        return json.dumps({"error": why, "trace": traceback.format_exc()})


class Workers(ABC):
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

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def run(self, jobs: deque[Job]) -> Iterator[Outcome]:
        """Do jobs from the left of a queue until it is empty; give outcomes as they come.

        The queue may be changed between outcomes: what is added is done too, what is removed is
        not. A job that fails stops no other.

        Args:
            jobs: emptied.
        """
        flying: dict[Future[str], Job] = {}
        while jobs or flying:
            while jobs and len(flying) < self.size:
                job = jobs.popleft()
                flying[self.submit(job.request())] = job
            for future in wait(flying, return_when=FIRST_COMPLETED).done:
                yield _outcome(flying.pop(future), future)


class Serial(Workers):
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


def _outcome(job: Job, future: Future[str]) -> Outcome:
    try:
        said = json.loads(future.result())
    except Exception as error:
        return Outcome(job, error=f"{type(error).__name__}: {error}")
    return Outcome(job, said.get("result"), said.get("error"), said.get("trace", ""))
