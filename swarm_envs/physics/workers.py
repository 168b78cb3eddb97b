"""Threads that share the environments of a batch."""

from __future__ import annotations

import itertools
import os
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor

import numpy as np

Call = Callable[[int, int, int], object]
"""A function of the first environment, one past the last, and the number of the thread."""
_PARTS_PER_THREAD = 4  # More than one, since the cores of some threads may be busy


class Workers:
    """Threads that share the parts of a batch.

    A single thread works on parts too, whose data stays in the cache from one kernel to the next.
    `threads` includes the calling thread. A part has at most `largest` environments, and at least
    the `together` that a kernel processes at once, unless these are too few for all threads.
    """

    def __init__(
        self, num_envs: int, threads: int, together: int = 1, largest: int = 1_000_000
    ) -> None:
        self.threads = min(threads, num_envs)
        shared = min(_PARTS_PER_THREAD * self.threads, num_envs // together)
        count = max(self.threads, shared if self.threads > 1 else 1, -(-num_envs // largest))
        self.parts = parts(num_envs, count)
        """The parts, as (first, last + 1)."""
        self._pool = self._new_pool()

    def _new_pool(self) -> ThreadPoolExecutor | None:
        self._process = os.getpid()
        return ThreadPoolExecutor(self.threads - 1) if self.threads > 1 else None

    def close(self) -> None:
        """End the threads. May be called more than once."""
        if self._pool is not None:
            self._pool.shutdown(wait=os.getpid() == self._process)

    def share(self, call: Call) -> None:
        """Call `call(first, last + 1, thread)` for all parts."""
        if self._pool is None:
            for first, last in self.parts:
                call(first, last, 0)
            return
        if os.getpid() != self._process:  # a forked process has no threads
            self._pool = self._new_pool()
        assert self._pool is not None
        left = iter(self.parts)  # each part goes to one thread
        waiting = [self._pool.submit(_work, call, left, k) for k in range(1, self.threads)]
        _work(call, left, 0)
        for future in waiting:
            future.result()


def _work(call: Call, left: Iterator[tuple[int, int]], thread: int) -> None:
    for first, last in left:
        call(first, last, thread)


def parts(num_envs: int, count: int) -> list[tuple[int, int]]:
    """Return `count` contiguous ranges (first, last + 1) of environments of nearly equal size."""
    edges = np.linspace(0, num_envs, count + 1).round().astype(int).tolist()
    return list(itertools.pairwise(edges))
