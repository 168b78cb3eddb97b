"""Neighbors on a grid, and the lengths of shortest paths among obstacles of any shape."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from swarm_envs.compiled import kernel
from swarm_envs.state import BoolArray

Ints = npt.NDArray[np.int32]  # Integers, such as vertices or lengths of paths
Neighbors = npt.NDArray[np.int32]
"""(V, 7) the neighbors of each vertex: x - 1, x + 1, y - 1, y + 1, z - 1, z + 1, and itself; -1 if
there is none."""

STAY = 6  # The direction of a wait, after those of the six edges
FAR = 1 << 29  # The length if there is no path; no grid has as many vertices


def neighbor_table(shape: tuple[int, int, int], obstacles: BoolArray) -> Neighbors:
    """Return the neighbors of every vertex, none across the border or into an obstacle."""
    vertex = np.arange(np.prod(shape), dtype=np.int32).reshape(shape)
    vertex = np.where(obstacles, np.int32(-1), vertex)
    wide = np.pad(vertex, 1, constant_values=-1)
    inner = slice(1, -1)
    found = np.empty((*shape, 7), dtype=np.int32)
    for axis in range(3):
        for end, shifted in enumerate((slice(0, -2), slice(2, None))):
            index = tuple(shifted if k == axis else inner for k in range(3))
            found[..., 2 * axis + end] = wide[index]
    found[..., STAY] = vertex
    return found.reshape(-1, 7)


@kernel
def _spread(table: Ints, goals: Ints, start: int, length: Ints, queue: Ints) -> None:
    """Search breadth-first from goals, all different, until the start is found (-1 for all)."""
    length[:] = FAR
    for k in range(goals.shape[0]):
        length[goals[k]] = 0
        queue[k] = goals[k]
    head, tail = 0, goals.shape[0]
    while head < tail:
        v = queue[head]
        head += 1
        if v == start:
            return
        for k in range(6):
            u = table[v, k]
            if u >= 0 and length[u] == FAR:
                length[u] = length[v] + 1
                queue[tail] = u
                tail += 1


@kernel
def _spread_all(table: Ints, goals: Ints, lengths: Ints, queue: Ints) -> None:
    for i in range(goals.shape[0]):
        _spread(table, goals[i : i + 1], -1, lengths[i], queue)


@kernel
def _measure(table: Ints, starts: Ints, goals: Ints, found: Ints, work: Ints) -> None:
    for i in range(goals.shape[0]):
        _spread(table, goals[i : i + 1], starts[i], work[0], work[1])
        found[i] = work[0, starts[i]]


def path_lengths_to(table: Neighbors, goals: Ints) -> Ints:
    """Return lengths (n, V) of shortest paths from each vertex to goals (n,), or `FAR`."""
    total = len(table)
    lengths = np.empty((len(goals), total), dtype=np.int32)
    _spread_all(table, goals, lengths, np.empty(total, dtype=np.int32))
    return lengths


def path_lengths_between(table: Neighbors, starts: Ints, goals: Ints) -> Ints:
    """Return lengths (n,) of shortest paths from starts (n,) to goals (n,), or `FAR`."""
    found = np.empty(len(goals), dtype=np.int32)
    _measure(table, starts, goals, found, np.empty((2, len(table)), dtype=np.int32))
    return found


def path_lengths_to_any(table: Neighbors, goals: Ints) -> Ints:
    """Return lengths (V,) of shortest paths from each vertex to the nearest of goals (k,)."""
    lengths, queue = np.empty((2, len(table)), dtype=np.int32)
    _spread(table, goals, -1, lengths, queue)
    return lengths
