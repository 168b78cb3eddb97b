"""The grid as PIBT reads it: coordinates, obstacles, lengths of ways around them."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import dijkstra

from swarm_envs.baselines.rth3d.grid import GridInstance, numbers
from swarm_envs.state import BoolArray

_Ints = npt.NDArray[np.int32]
_MOST_WAYS = 200_000_000
"""Lengths that are kept at most, four bytes each."""
_FAR = 1 << 20
"""Stands for no way."""


class Terrain(NamedTuple):
    """The grid as kernels read it."""

    at: _Ints
    """(V, 3) coordinates of each vertex."""
    sides: _Ints
    """(3,) the shape."""
    strides: _Ints
    """(3,) differences of the numbers of neighbours along each axis."""
    walls: BoolArray
    """(V,) whether an obstacle stands there; of shape (0,) if there is none."""
    ways: _Ints
    """(n, V) length of the shortest way to each robot's goal; (0, 0) where a formula says it."""
    along_x: _Ints
    """(m1, m2) obstacles at smaller or equal x in the same row."""
    along_y: _Ints
    """(m1, m2) obstacles at smaller or equal y in the same column."""


def ways_to_goals(instance: GridInstance) -> npt.NDArray[np.int32]:
    """(n, V) length of the shortest way from each vertex to each goal, by breadth-first search.

    Raises:
        ValueError: it would not fit into memory, or no way leads from a start to its goal.
    """
    count, free = len(instance.goals), ~instance.obstacles
    if count * free.size > _MOST_WAYS:
        raise ValueError(
            f"obstacles off the pattern need the ways of {count} robots on {free.size} vertices, "
            f"but at most {_MOST_WAYS} numbers are kept; take fewer robots or a smaller grid"
        )
    vertex = np.arange(free.size).reshape(instance.shape)
    edges = []
    for axis in range(3):
        low, high = np.moveaxis(vertex, axis, 0)[:-1], np.moveaxis(vertex, axis, 0)[1:]
        open_ = np.moveaxis(free, axis, 0)[:-1] & np.moveaxis(free, axis, 0)[1:]
        edges.append(np.stack([low[open_], high[open_]]))
    first, second = np.concatenate(edges, axis=1)
    graph = csr_matrix((np.ones(len(first)), (first, second)), shape=(free.size,) * 2)
    goals = numbers(instance.goals, instance.shape)
    ways = dijkstra(graph, directed=False, indices=goals, unweighted=True)
    starts = numbers(instance.starts, instance.shape)
    closed = np.flatnonzero(np.isinf(ways[np.arange(count), starts]))
    if len(closed):
        i = int(closed[0])
        raise ValueError(
            f"robot {i} cannot get from {instance.starts[i].tolist()} to "
            f"{instance.goals[i].tolist()}: obstacles are between; move them, or one of the two"
        )
    return np.asarray(np.where(np.isinf(ways), _FAR, ways), dtype=np.int32)
