"""A k-d tree that grows point by point, compiled: the nearest neighbour in a search tree.

Leaves hold a bucket of points; a full one is split in the middle of its longest side. Every node
keeps the box around its points, by which a query skips whatever is too far.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from swarm_envs.compiled import kernel, part
from swarm_envs.state import FloatArray, IntArray

BUCKET = 16
"""Points in a full leaf."""
_LEAF = -1
_STACK = 256  # no path down is as long: each split halves a bucket


class KdTree(NamedTuple):
    """Points in D dimensions; the arrays are the storage, written in place."""

    points: FloatArray
    """(capacity, D) the points in the order of their insertion."""
    lower: FloatArray
    """(nodes, D) lower corner of the box around a node's points."""
    upper: FloatArray
    """(nodes, D) its upper corner."""
    axis: IntArray
    """(nodes,) along which axis a node is split; -1 in a leaf."""
    middle: FloatArray
    """(nodes,) where it is split."""
    child: IntArray
    """(nodes, 2) the nodes below it."""
    bucket: IntArray
    """(nodes, BUCKET) the points of a leaf."""
    filled: IntArray
    """(nodes,) how many these are."""
    used: IntArray
    """(2,) points and nodes in use."""
    stack: IntArray
    """Working memory of a query."""


def empty_kd_tree(capacity: int, dimensions: int) -> KdTree:
    """An empty tree with room for `capacity` points in D dimensions."""
    nodes = 2 * (2 * capacity // BUCKET + 1) + 1
    tree = KdTree(
        points=np.zeros((capacity, dimensions)),
        lower=np.zeros((nodes, dimensions)),
        upper=np.zeros((nodes, dimensions)),
        axis=np.zeros(nodes, np.int64),
        middle=np.zeros(nodes),
        child=np.zeros((nodes, 2), np.int64),
        bucket=np.zeros((nodes, BUCKET), np.int64),
        filled=np.zeros(nodes, np.int64),
        used=np.zeros(2, np.int64),
        stack=np.zeros(_STACK, np.int64),
    )
    clear_points(tree)
    return tree


@kernel
def clear_points(tree: KdTree) -> None:
    """Forget all points."""
    tree.used[0], tree.used[1] = 0, 1
    _begin_leaf(tree, 0)


@kernel
def insert_point(tree: KdTree, point: FloatArray) -> int:
    """Add a point (D,) and return its index; the tree must not be full."""
    index = tree.used[0]
    tree.used[0] = index + 1
    for d in range(point.shape[0]):
        tree.points[index, d] = point[d]
    node = 0
    _widen(tree, node, point)
    while tree.axis[node] != _LEAF:
        node = tree.child[node, int(point[tree.axis[node]] >= tree.middle[node])]
        _widen(tree, node, point)
    tree.bucket[node, tree.filled[node]] = index
    tree.filled[node] += 1
    if tree.filled[node] == BUCKET:
        _split(tree, node)
    return index


@kernel
def nearest_index(tree: KdTree, query: FloatArray) -> int:
    """Index of the point nearest to a query (D,); -1 if there is none."""
    best, found, height = np.inf, -1, 1
    tree.stack[0] = 0
    while height > 0:
        height -= 1
        node = tree.stack[height]
        if _box_distance(tree, node, query) >= best:
            continue
        axis = tree.axis[node]
        if axis != _LEAF:
            near = int(query[axis] >= tree.middle[node])
            tree.stack[height] = tree.child[node, 1 - near]
            tree.stack[height + 1] = tree.child[node, near]
            height += 2
            continue
        for k in range(tree.filled[node]):
            distance = 0.0
            for d in range(query.shape[0]):
                distance += (tree.points[tree.bucket[node, k], d] - query[d]) ** 2
            if distance < best:
                best, found = distance, tree.bucket[node, k]
    return found


@part
def _begin_leaf(tree: KdTree, node: int) -> None:
    tree.axis[node], tree.filled[node] = _LEAF, 0
    for d in range(tree.points.shape[1]):
        tree.lower[node, d], tree.upper[node, d] = np.inf, -np.inf


@part
def _widen(tree: KdTree, node: int, point: FloatArray) -> None:
    for d in range(point.shape[0]):
        tree.lower[node, d] = min(tree.lower[node, d], point[d])
        tree.upper[node, d] = max(tree.upper[node, d], point[d])


@part
def _box_distance(tree: KdTree, node: int, query: FloatArray) -> float:
    """Squared distance of a query from the box around a node's points."""
    total = 0.0
    for d in range(query.shape[0]):
        out = max(tree.lower[node, d] - query[d], 0.0, query[d] - tree.upper[node, d])
        total += out * out
    return total


@part
def _split(tree: KdTree, node: int) -> None:
    """Turn a full leaf into two half full ones; points that are all equal are shared out."""
    axis = 0
    for d in range(1, tree.points.shape[1]):
        side = tree.upper[node, d] - tree.lower[node, d]
        if side > tree.upper[node, axis] - tree.lower[node, axis]:
            axis = d
    bucket = tree.bucket[node]
    for a in range(1, BUCKET):  # insertion sort along the axis
        moving, b = bucket[a], a
        while b > 0 and tree.points[bucket[b - 1], axis] > tree.points[moving, axis]:
            bucket[b] = bucket[b - 1]
            b -= 1
        bucket[b] = moving
    for side in range(2):
        leaf = tree.used[1]
        tree.used[1] = leaf + 1
        _begin_leaf(tree, leaf)
        for k in range(BUCKET // 2):
            index = bucket[side * (BUCKET // 2) + k]
            tree.bucket[leaf, k] = index
            _widen(tree, leaf, tree.points[index])
        tree.filled[leaf] = BUCKET // 2
        tree.child[node, side] = leaf
    tree.axis[node] = axis
    tree.middle[node] = tree.points[bucket[BUCKET // 2], axis]
