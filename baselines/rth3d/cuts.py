"""Lower bounds: the time to cross a plane, and the steps aside to pass each other.

No two robots use an edge in the same step, in either direction, as swaps are not allowed. Of N
robots that are at least a steps from a plane with m open edges, and whose goals are at least b
steps behind it, the first can cross after a steps, the last has crossed after ceil(N / m) more, and
then has b steps to go.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from swarm_envs.baselines.rth3d.path_lengths import STAY, Ints, Neighbors, path_lengths_to_any
from swarm_envs.compiled import kernel
from swarm_envs.state import BoolArray


def cut_bound(
    starts: Ints, goals: Ints, obstacles: BoolArray, longest: int, table: Neighbors | None
) -> int:
    """Return the largest lower bound of planes across an axis, at least `longest`.

    Args:
        starts: The start vertices (n, 3).
        goals: The goal vertices (n, 3), all reachable.
        obstacles: The obstacles (m1, m2, m3).
        longest: The longest of the robots' shortest paths.
        table: The neighbors, to search the paths to planes; None for straight paths.
    """
    best = longest
    for axis in range(3):
        first, last = starts[:, axis], goals[:, axis]
        low, high = np.minimum(first, last), np.maximum(first, last)
        side = obstacles.shape[axis]
        crossing = np.cumsum(np.bincount(low, minlength=side) - np.bincount(high, minlength=side))
        free = np.moveaxis(~obstacles, axis, 0)
        for c in np.flatnonzero(crossing):
            opening = free[c] & free[c + 1]
            steps = -(-int(crossing[c]) // int(opening.sum()))
            if steps + longest - 1 <= best or (table is None and steps + side - 2 <= best):
                continue  # The steps before and behind the plane are fewer than the whole path
            robots = (low <= c) & (c < high)
            before, behind = (
                _from_plane(p[robots], axis, int(c), opening, obstacles.shape, table)
                for p in (starts, goals)
            )
            best = max(best, _staggered(before, behind, int(opening.sum())))
    return best


def _from_plane(
    points: Ints,
    axis: int,
    c: int,
    opening: BoolArray,
    shape: tuple[int, ...],
    table: Neighbors | None,
) -> Ints:
    """Return the steps (k,) from points (k, 3) to the plane between `c` and `c + 1`."""
    left = points[:, axis] <= c
    if table is None:
        return np.where(left, c - points[:, axis], points[:, axis] - c - 1).astype(np.int32)
    vertex = np.moveaxis(table[:, STAY].reshape(shape), axis, 0)
    here = np.ravel_multi_index(tuple(points.T), shape)
    sides = [path_lengths_to_any(table, vertex[k][opening])[here] for k in (c, c + 1)]
    return np.where(left, *sides).astype(np.int32)


def _staggered(before: Ints, behind: Ints, edges: int) -> int:
    """Return the largest bound over all pairs of distances in front of and behind the plane."""
    a, row = np.unique(before, return_inverse=True)
    b, column = np.unique(behind, return_inverse=True)
    count = np.zeros((len(a), len(b)), dtype=np.int64)
    np.add.at(count, (row, column), 1)
    farther = count[::-1, ::-1].cumsum(axis=0).cumsum(axis=1)[::-1, ::-1]
    bound = a[:, None] + -(-farther // edges) + b
    return int(bound[farther > 0].max())


@kernel
def _passing(lines: npt.NDArray[np.int64], first: Ints, last: Ints) -> int:
    """Return `passing_bound` of robots in the order of their lines, from `first` to `last`."""
    best = 0
    for i in range(len(lines)):
        j = i + 1
        while j < len(lines) and lines[j] == lines[i]:
            if (first[i] - first[j]) * (last[i] - last[j]) < 0:
                best = max(best, 2 + min(abs(last[i] - first[i]), abs(last[j] - first[j])))
            j += 1
    return best


def passing_bound(starts: Ints, goals: Ints) -> int:
    """Return the least steps for robots to pass each other within a line along an axis.

    Of two robots whose starts and goals are in one line, in opposite orders, one has to leave the
    line and come back, which takes two steps more than its distance.
    """
    best = 0
    for axis in range(3):
        others = [k for k in range(3) if k != axis]
        stays = (starts[:, others] == goals[:, others]).all(axis=1)
        kept, to = starts[stays], goals[stays]
        lines = kept[:, others[0]].astype(np.int64) << 32 | kept[:, others[1]]
        order = np.argsort(lines, kind="stable")
        best = max(best, _passing(lines[order], kept[order, axis], to[order, axis]))
    return best
