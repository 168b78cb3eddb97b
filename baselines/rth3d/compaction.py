"""Compaction: every move as early as the order in which robots visit each vertex allows.

A plan fixes the order of visitors of every vertex. With that order, a robot may enter a vertex one
step after its last move, and not before the step in which the previous visitor leaves. The earliest
times are longest paths in the graph of these events. The original times satisfy the same
inequalities, so no move gets later, and the plan stays valid.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from swarm_envs.baselines.rth3d.grid import Array, Vertices
from swarm_envs.compiled import kernel

Paths = npt.NDArray[np.int32]  # (T + 1, n) each robot's vertex after each step, as a number


@kernel
def _resolve(
    i: int,
    aim: Array,
    holder: Array,
    arrived: Array,
    left: Array,
    chain: Array,
    time: Array,
) -> None:
    """Set the times of robot i and of those that it follows; a ring moves at once."""
    length = 0
    ring = False
    while True:
        chain[length] = i
        length += 1
        time[i] = -2
        leader = holder[aim[i]]
        if leader < 0 or time[leader] >= 0:
            break
        if time[leader] == -2:
            ring = True
            break
        i = leader
    if ring:
        latest = 0
        for k in range(length):
            latest = max(latest, arrived[chain[k]] + 1)
        for k in range(length):
            time[chain[k]] = latest
        return
    for k in range(length - 1, -1, -1):
        i = chain[k]
        leader = holder[aim[i]]
        free = time[leader] if leader >= 0 else left[aim[i]]
        time[i] = max(arrived[i] + 1, free)


@kernel
def advance(
    paths: Array,
    at: Array,
    holder: Array,
    arrived: Array,
    left: Array,
    aim: Array,
    time: Array,
    movers: Array,
    chain: Array,
) -> int:
    """Move all events of `paths` forward in time, in place; return the new makespan.

    `at` (n,) are the robots' vertices at the start, `holder` (V,) the vertices' robots or -1;
    `arrived` (n,) and `left` (V,) are zeros; the others (n,) are working memory. The new plan is in
    the first rows of `paths`.
    """
    steps, count = paths.shape
    makespan = 0
    for t in range(1, steps):
        moving = 0
        row = paths[t]
        for i in range(count):
            if row[i] != at[i]:
                movers[moving] = i
                moving += 1
                aim[i] = row[i]
                time[i] = -1
            row[i] = -1
        for k in range(moving):
            i = movers[k]
            if time[i] >= 0:
                continue
            leader = holder[aim[i]]
            if leader < 0:
                time[i] = max(arrived[i] + 1, left[aim[i]])
            elif time[leader] >= 0:
                time[i] = max(arrived[i] + 1, time[leader])
            else:  # A call with so many arrays takes longer than all of the above
                _resolve(i, aim, holder, arrived, left, chain, time)
        for k in range(moving):
            i = movers[k]
            left[at[i]] = time[i]
            holder[at[i]] = -1
        for k in range(moving):
            i = movers[k]
            arrived[i] = time[i]
            makespan = max(makespan, time[i])
            at[i] = aim[i]
            holder[at[i]] = i
            paths[time[i], i] = at[i]
    for t in range(1, makespan + 1):
        for i in range(count):
            if paths[t, i] < 0:
                paths[t, i] = paths[t - 1, i]
    return makespan


def compact(paths: Paths, total: int) -> Paths:
    """Return a plan (T + 1, n) shortened, with every vertex visited in the same order.

    `paths` is overwritten. `total` is the number of vertices of the grid.
    """
    count = paths.shape[1]
    at: Vertices = paths[0].copy()
    holder = np.full(total, -1, dtype=np.int32)
    holder[at] = np.arange(count, dtype=np.int32)
    arrived, left = np.zeros(count, dtype=np.int32), np.zeros(total, dtype=np.int32)
    work = (np.empty(count, dtype=np.int32) for _ in range(4))
    makespan = advance(paths, at, holder, arrived, left, *work)
    if paths.flags.owndata:  # A view would keep all of its memory
        paths.resize((makespan + 1, count), refcheck=False)
        return paths
    return paths[: makespan + 1]
