"""Plans in which any robot may take any goal: a flow over time steps, in the fewest of them.

The flow is that of `balance`, with the goals as sinks (Yu, LaValle: "Multi-agent Path Planning and
Network Flow", WAFR 2012). That none of one step less takes everyone in is the proof that the
makespan is the least. Where a flow would be too large, goals are assigned, and a labelled method
plans.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from scipy.ndimage import label
from scipy.sparse import csr_array
from scipy.sparse.csgraph import maximum_bipartite_matching

from swarm_envs.baselines.rth3d.grid import (
    Coordinates,
    GridInstance,
    NoPlanExists,
    numbers,
)
from swarm_envs.baselines.rth3d.ways import Ints, Neighbors, ways_to, ways_to_any

_MOST_WAYS = 2**25  # lengths of ways that the bottleneck matching keeps: 0.13 GB


def unlabelled_bound(instance: GridInstance, table: Neighbors) -> int:
    """Steps that no plan can do without, with any assignment of goals.

    The largest of: the way to the nearest goal, or from the nearest start; what a plane across an
    axis lets through; and where the ways fit into memory, the longest way of the matching of starts
    and goals whose longest way is the shortest.
    """
    starts, goals = (numbers(p, instance.shape) for p in (instance.starts, instance.goals))
    best = max(_plane_bound(instance, axis) for axis in range(3))
    for these, those in ((starts, goals), (goals, starts)):
        best = max(best, int(ways_to_any(table, these)[those].max()))
    if len(starts) * len(table) <= _MOST_WAYS:
        best = max(best, bottleneck(ways_to(table, goals)[:, starts]))
    return best


def bottleneck(ways: Ints) -> int:
    """The least longest way of a perfect matching, from the length of every way (n, n)."""
    lengths = np.unique(ways)
    low, high = 0, len(lengths) - 1
    while low < high:
        middle = (low + high) // 2
        matched = maximum_bipartite_matching(csr_array(ways <= lengths[middle]))
        low, high = (low, middle) if matched.min() >= 0 else (middle + 1, high)
    return int(lengths[low])


def _plane_bound(instance: GridInstance, axis: int) -> int:
    """The largest bound of all planes across an axis.

    If on one side of a plane there are N more starts than goals, N robots at least have to go
    through its m open edges, one an edge and step. Of them, all but those that start nearer than a
    steps and those whose goals are nearer than b behind it take a + ceil(rest / m) + b.
    """
    best, free = 0, np.moveaxis(~instance.obstacles, axis, 0)
    side = free.shape[0]
    starts, goals = (
        np.bincount(p[:, axis], minlength=side) for p in (instance.starts, instance.goals)
    )
    for first, last, flipped in ((starts, goals, False), (starts[::-1], goals[::-1], True)):
        surplus = np.cumsum(first - last)
        for c in np.flatnonzero(surplus > 0):
            plane = side - 2 - c if flipped else c
            edges = int((free[plane] & free[plane + 1]).sum())
            before = np.concatenate([[0], np.cumsum(first[c::-1])[:-1]])
            behind = np.concatenate([[0], np.cumsum(last[c + 1 :])[:-1]])
            rest = surplus[c] - before[:, None] - behind
            steps = np.arange(len(before))[:, None] - (-rest // edges) + np.arange(len(behind))
            best = max(best, int(steps[rest > 0].max()))
    return best


def _parts(instance: GridInstance) -> tuple[Ints, Ints]:
    """The connected part of the grid that each start, and each goal, is in.

    Raises:
        NoPlanExists: a part has more starts than goals, or fewer.
    """
    names = label(~instance.obstacles)[0].ravel()
    first, last = (names[numbers(p, instance.shape)] for p in (instance.starts, instance.goals))
    have, want = (np.bincount(p, minlength=names.max() + 1) for p in (first, last))
    if not np.array_equal(have, want):
        part = int(np.argmax(have > want))
        where = instance.starts[int(np.argmax(first == part))].tolist()
        raise NoPlanExists(
            f"no plan exists: obstacles shut {have[part]} robots, one of them at {where}, into a "
            f"part of the grid with {want[part]} goals; move obstacles, starts or goals"
        )
    return first, last


def assign(instance: GridInstance) -> GridInstance:
    """The instance with goals in an order that makes ways short.

    Starts and goals are cut into as many slabs along x, these into columns along y, and these are
    sorted along z: who is at the same place in both orders goes together.

    Raises:
        NoPlanExists: a connected part of the grid has more starts than goals, or fewer.
    """
    orders = [
        _slab_order(points, part)
        for points, part in zip((instance.starts, instance.goals), _parts(instance), strict=True)
    ]
    goals = np.empty_like(instance.goals)
    goals[orders[0]] = instance.goals[orders[1]]
    return GridInstance(instance.shape, instance.starts, goals, instance.obstacles)


def _slab_order(points: Coordinates, part: Ints) -> npt.NDArray[np.int64]:
    group = part.astype(np.int64)
    cuts = max(1, round(len(points) ** (1 / 3)))
    for axis in range(3):
        order = np.lexsort((*points.T, points[:, axis], group))  # no ties: sets decide alone
        place = np.empty(len(points), dtype=np.int64)
        place[order] = np.arange(len(points))
        _, group_of, size = np.unique(group, return_inverse=True, return_counts=True)
        begin = np.concatenate([[0], np.cumsum(size)[:-1]])
        slab = (place - begin[group_of]) * cuts // size[group_of]
        group = group_of * cuts + slab
    return order
