"""The k-d tree finds what scipy's finds, however the points come."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial import cKDTree

from swarm_envs.baselines.neural_swarm.planner.kd_tree import (
    clear_points,
    empty_kd_tree,
    insert_point,
    nearest_index,
)

COUNT = 1500


def points_of(kind: str, dimensions: int, rng: np.random.Generator) -> np.ndarray:
    if kind == "uniform":
        return rng.uniform(-1.0, 1.0, (COUNT, dimensions))
    if kind == "sorted":
        return np.sort(rng.uniform(-1.0, 1.0, (COUNT, dimensions)), axis=0)
    if kind == "walk":  # as a search tree grows: each point near an older one
        return np.cumsum(rng.normal(0.0, 0.05, (COUNT, dimensions)), axis=0)
    few = rng.integers(0, 2, (COUNT, dimensions)).astype(np.float64)
    return few  # "equal": many points at the same places


@pytest.mark.parametrize("kind", ["uniform", "sorted", "walk", "equal"])
@pytest.mark.parametrize("dimensions", [2, 8])
def test_it_finds_what_scipy_finds(kind, dimensions):
    rng = np.random.default_rng(1)
    points, tree = points_of(kind, dimensions, rng), empty_kd_tree(COUNT, dimensions)
    queries = points[rng.integers(0, COUNT, 100)] + rng.normal(0.0, 0.3, (100, dimensions))
    for k, point in enumerate(points):
        assert insert_point(tree, point) == k
        if k in (0, 14, 15, 16, 17, 200, COUNT - 1):
            found = points[[nearest_index(tree, query) for query in queries]]
            apart = np.linalg.norm(found - queries, axis=1)
            truth, _ = cKDTree(points[: k + 1]).query(queries)
            np.testing.assert_allclose(apart, truth, atol=1e-12)


def test_an_empty_tree_has_no_nearest_point():
    tree = empty_kd_tree(40, 3)
    assert nearest_index(tree, np.zeros(3)) == -1
    for _ in range(40):
        insert_point(tree, np.ones(3))
    clear_points(tree)
    assert nearest_index(tree, np.zeros(3)) == -1
    insert_point(tree, np.ones(3))
    assert nearest_index(tree, np.zeros(3)) == 0
