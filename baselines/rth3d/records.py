"""How long each phase of planning takes, and how many steps it adds to the plan."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field


@dataclass(frozen=True)
class PhaseRecord:
    """A phase of planning."""

    name: str
    """Of the phase."""
    makespan: int
    """Steps that it takes in the plan as first written; of "compaction" and "pibt", those of the
    whole plan afterwards."""
    seconds: float
    """Wall time of planning it."""


@dataclass
class Clock:
    """Records phases, tells a watcher, and knows when time is up."""

    deadline: float = float("inf")
    """By `time.monotonic`."""
    watch: Callable[[str], None] | None = None
    """Told the name of each phase when it begins."""
    phases: list[PhaseRecord] = field(default_factory=list)
    """The phases so far."""

    @contextmanager
    def phase(self, name: str) -> Iterator[Callable[[int], None]]:
        """Time a phase; call what is given with the phase's makespan.

        Raises:
            PlanTimeout: time was up before the phase began.
        """
        self.check(name)
        with self.finish(name) as record:
            yield record

    @contextmanager
    def finish(self, name: str) -> Iterator[Callable[[int], None]]:
        """Time a phase that is done even when time is up, as what it finishes exists already."""
        if self.watch is not None:
            self.watch(name)
        makespan = 0

        def record(steps: int) -> None:
            nonlocal makespan
            makespan = steps

        begin = time.perf_counter()
        yield record
        self.phases.append(PhaseRecord(name, makespan, time.perf_counter() - begin))

    @property
    def remaining(self) -> float:
        """Seconds until time is up."""
        return self.deadline - time.monotonic()

    def check(self, what: str) -> None:
        """Refuse to begin something when time is up.

        Raises:
            PlanTimeout: it is.
        """
        if self.remaining <= 0:
            raise PlanTimeout(
                f"the time limit ended at {what!r}, and there is no valid plan yet; give more "
                "time, or method='pibt', which is faster and promises nothing"
            )


class PlanTimeout(TimeoutError):
    """The time limit ended before there was any valid plan."""
