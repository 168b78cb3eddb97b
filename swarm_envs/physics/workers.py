"""Threads that share the environments of a batch."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np

_PARTS_PER_THREAD = 4
"""So that a thread whose core is busy with something else leaves more to the others."""


class Workers:
    """Threads that work on environments, each on the next part of them that is left.

    One thread takes them in parts too: what a part needs stays in the cache from one kernel to the
    next.

    Args:
        num_envs: E.
        threads: how many, with the one that asks; never more than environments.
        together: environments that a kernel looks at together, which no part has fewer of unless
            there are too few for all threads.
        largest: environments in a part, at most.
    """

    def __init__(
        self, num_envs: int, threads: int, together: int = 1, largest: int = 1_000_000
    ) -> None:
        self.threads = min(threads, num_envs)
        shared = min(_PARTS_PER_THREAD * self.threads, num_envs // together)
        count = max(self.threads, shared if self.threads > 1 else 1, -(-num_envs // largest))
        self._parts = parts(num_envs, count)
        self._pool = ThreadPoolExecutor(self.threads - 1) if self.threads > 1 else None

    def close(self) -> None:
        """Let the threads end. May be called more than once."""
        if self._pool is not None:
            self._pool.shutdown()

    def share(
        self, call: Callable[..., None], given: tuple[Any, ...], own: Sequence[tuple[Any, ...]]
    ) -> None:
        """Call `call(first, last + 1, *given, *own[thread])` until every environment had its turn.

        Args:
            call: a kernel, or a function that calls some; kernels let other threads run.
            given: what all threads take.
            own: what each thread takes alone.
        """
        if self._pool is None:
            _work(call, iter(self._parts), (*given, *own[0]))
            return
        left = iter(self._parts)  # of which Python hands each part to one thread only
        waiting = [self._pool.submit(_work, call, left, (*given, *mine)) for mine in own[1:]]
        _work(call, left, (*given, *own[0]))
        for future in waiting:
            future.result()


def _work(
    call: Callable[..., None], left: Iterator[tuple[int, int]], arguments: tuple[Any, ...]
) -> None:
    for first, last in left:
        call(first, last, *arguments)


def parts(num_envs: int, count: int) -> list[tuple[int, int]]:
    """So many contiguous ranges (first, last + 1) of environments, as equal as can be."""
    edges = np.linspace(0, num_envs, count + 1).round().astype(int).tolist()
    return list(itertools.pairwise(edges))
