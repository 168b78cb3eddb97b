"""Perfect matchings: heights, or rows, from which one shuffle suffices (Sec. II-B).

A table has K columns of D items, and each item belongs into a target column. Columns and target
columns are the two sides of a D-regular bipartite multigraph whose edges are the items. D perfect
matchings (Hall) assign the items to D levels so that each level has one item of every column and
one for every target column. RTH3D uses any; RTH3D-LBA uses matchings with small shifts from the
items' present levels.

The paper finds one matching at a time, each by a linear bottleneck assignment, so that the last
ones have little choice. Here levels are halved instead: the lower half of the levels keeps its
items, except for as few exchanges as make both halves regular, found by a flow in which only items
within a threshold of the middle may change sides. Each half is again a smaller table. No item is
then shifted by more than the largest threshold that was needed.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from swarm_envs.baselines.rth3d.grid import Array
from swarm_envs.baselines.rth3d.path_lengths import Ints
from swarm_envs.compiled import equation, kernel


@equation
def _is_flexible(level: int, middle: int, low: bool, reach: int) -> bool:
    """Return True if an item may change sides, by at most `reach` levels beyond the middle."""
    return level < 0 or (middle - level if low else level - middle + 1) <= reach


@kernel
def _levels(
    aims: Array,
    shift: Array,
    low: Array,
    by_aim: Array,
    at: Array,
    begin: int,
    size: int,
    middle: int,
    reach: int,
    excess: Array,
    depth: Array,
    queue: Array,
) -> int:
    """Label nodes by their distance from overfull aims; return that of an aim with room, or -1.

    Nodes 0 .. K - 1 are aims (target columns), K .. 2 K - 1 columns. An item that changes sides is
    an edge from one to the other: from its aim if it is low, from its column if it is not.
    """
    count, width = by_aim.shape
    tail, found = 0, -1
    for k in range(2 * count):
        depth[k] = -1
    for k in range(count):
        if excess[k] > 0:
            depth[k] = 0
            queue[tail] = k
            tail += 1
    head = 0
    while head < tail:
        node = queue[head]
        head += 1
        if depth[node] == found:
            break
        for k in range(begin, begin + size):
            item = by_aim[node, k] if node < count else at[node - count, k]
            if low[item] != (node < count):
                continue
            following = count + item // width if node < count else aims[item]
            if depth[following] >= 0:
                continue
            if not _is_flexible(shift[item], middle, low[item], reach):
                continue
            depth[following] = depth[node] + 1
            queue[tail] = following
            tail += 1
            if following < count and excess[following] < 0 and found < 0:
                found = depth[following]
    return found


@kernel
def _exchange(
    aims: Array,
    shift: Array,
    low: Array,
    by_aim: Array,
    at: Array,
    begin: int,
    size: int,
    middle: int,
    reach: int,
    excess: Array,
    depth: Array,
    path: Array,
    arcs: Array,
    last: int,
) -> int:
    """Move items along shortest paths from overfull aims to those with room; return the number."""
    count, width = by_aim.shape
    done = 0
    for k in range(2 * count):
        arcs[k] = begin - 1
    for source in range(count):
        while excess[source] > 0 and depth[source] == 0:
            top = 0
            path[0] = source
            while top >= 0:
                node = path[top]
                if depth[node] == last and node < count and excess[node] < 0:
                    break
                arcs[node] += 1
                if depth[node] >= last or arcs[node] >= begin + size:
                    depth[node] = -2
                    top -= 1
                    continue
                item = by_aim[node, arcs[node]] if node < count else at[node - count, arcs[node]]
                if low[item] != (node < count):
                    continue
                following = count + item // width if node < count else aims[item]
                if depth[following] != depth[node] + 1:
                    continue
                if _is_flexible(shift[item], middle, low[item], reach):
                    top += 1
                    path[top] = following
            if top < 0:
                break
            for k in range(top):
                node = path[k]
                item = by_aim[node, arcs[node]] if node < count else at[node - count, arcs[node]]
                low[item] = not low[item]
            excess[source] -= 1
            excess[path[top]] += 1
            done += 1
    return done


@kernel
def _halve(
    aims: Array,
    shift: Array,
    low: Array,
    by_aim: Array,
    at: Array,
    begin: int,
    size: int,
    bounded: bool,
    work: Array,
) -> None:
    """Split the levels [begin, begin + size) of a table: sort low items of `at`, `by_aim` first."""
    count = at.shape[0]
    half = size // 2
    middle = begin + half
    excess, depth, queue, path, arcs = work[0], work[1], work[2], work[3], work[4]
    room = excess[:count]
    for a in range(count):
        room[a] = -half
    for c in range(count):
        for k in range(begin, begin + size):
            low[at[c, k]] = k < middle
            if k < middle:
                room[aims[at[c, k]]] += 1
    left = 0
    for a in range(count):
        left += max(room[a], 0)
    reach = 1 if bounded else 2**30
    while left > 0:
        last = _levels(aims, shift, low, by_aim, at, begin, size, middle, reach, room, depth, queue)
        if last < 0:
            reach += 1
            continue
        sent = _exchange(
            aims, shift, low, by_aim, at, begin, size, middle, reach, room, depth, path, arcs, last
        )
        left -= sent
        if sent * 10 < left:
            reach += 1
    for c in range(count):
        _low_first(at[c], low, begin, size, queue)
        _low_first(by_aim[c], low, begin, size, queue)


@kernel
def _low_first(items: Array, low: Array, begin: int, size: int, buffer: Array) -> None:
    """Move the low items before the others, stably."""
    kept, end = 0, begin
    for k in range(begin, begin + size):
        if low[items[k]]:
            items[end] = items[k]
            end += 1
        else:
            buffer[kept] = items[k]
            kept += 1
    for k in range(kept):
        items[end + k] = buffer[k]


@kernel
def split_tables(aims: Array, shift: Array, bounded: bool, levels: Array) -> None:
    """Assign the items of several tables to levels; see `assign_levels`."""
    tables, count, size = aims.shape
    at = np.empty((count, size), dtype=np.int32)
    by_aim = np.empty((count, size), dtype=np.int32)
    filled = np.empty(count, dtype=np.int32)
    low = np.empty(count * size, dtype=np.bool_)
    work = np.empty((5, 2 * count + size), dtype=np.int32)
    pending = np.empty((2 * size + 2, 2), dtype=np.int32)
    for g in range(tables):
        flat_aims, flat_shift = aims[g].reshape(-1), shift[g].reshape(-1)
        filled[:] = 0
        for item in range(count * size):
            at[item // size, item % size] = item
            a = flat_aims[item]
            by_aim[a, filled[a]] = item
            filled[a] += 1
        pending[0, 0], pending[0, 1] = 0, size
        top = 1
        while top > 0:
            top -= 1
            begin, length = pending[top, 0], pending[top, 1]
            if length < 2:
                continue
            _halve(flat_aims, flat_shift, low, by_aim, at, begin, length, bounded, work)
            half = length // 2
            pending[top, 0], pending[top, 1] = begin, half
            pending[top + 1, 0], pending[top + 1, 1] = begin + half, length - half
            top += 2
        for c in range(count):
            for k in range(size):
                levels[g, c, at[c, k] % size] = k


def assign_levels(
    aims: npt.NDArray[np.integer], real: npt.NDArray[np.bool_], bounded: bool
) -> Ints:
    """Return levels (G, K, D) of all items, so that each level of a table is a perfect matching.

    `aims` (G, K, D) is the target column of each item of G tables, each column D times; item d of a
    column is in level d at first. Items that are not `real` may be shifted by any distance;
    `bounded` keeps the largest shift of the others small (RTH3D-LBA).
    """
    levels = np.empty(aims.shape, dtype=np.int32)
    present = np.broadcast_to(np.arange(aims.shape[2], dtype=np.int32), aims.shape)
    shift = np.where(real, present, np.int32(-1)).astype(np.int32)
    split_tables(np.ascontiguousarray(aims, dtype=np.int32), shift, bounded, levels)
    return levels
