"""What the safety filter solves, against other solvers, and its barrier, against flights."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import linprog

from swarm_envs.agents.barrier import velocity_barrier
from swarm_envs.agents.nearest import TOLERANCE, least_broken, nearest_point, new_workspace
from swarm_envs.baselines.mlr_dmpc.solvers import solver
from swarm_envs.state import FloatArray

BOX = np.concatenate([np.eye(3), -np.eye(3)])


def program(
    rng: np.random.Generator, rows: int, tight: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """A target, and rows of which the first six are a box."""
    normals = rng.normal(size=(rows, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    bound = np.concatenate([np.full(6, -5.0), rng.normal(tight, 2.0, rows)])
    return rng.normal(0.0, 4.0, 3), np.concatenate([BOX, normals]), bound


@pytest.mark.parametrize("name", ["daqp", "osqp"])
def test_the_nearest_point_is_that_of_other_solvers(name):
    rng, solve, work, out = np.random.default_rng(0), solver(name), new_workspace(20), np.zeros(3)
    found = 0
    for k in range(200):
        target, rows, bound = program(rng, k % 10, -2.0)
        theirs = solve(-target, rows, bound, np.zeros(len(rows), dtype=np.bool_))
        assert nearest_point(target, rows, bound, len(rows), work, out) == theirs.solved
        if theirs.solved:
            assert out == pytest.approx(theirs.y, abs=1e-4 if name == "osqp" else 1e-6)
            found += 1
    assert 100 < found < 200  # some can be satisfied, some cannot


def test_what_cannot_be_satisfied_is_broken_the_least():
    rng, work, out = np.random.default_rng(1), new_workspace(20), np.zeros(3)
    broken = 0
    for k in range(200):
        target, rows, bound = program(rng, 2 + k % 8, 1.0)
        worst = least_broken(target, rows, bound, 6, len(rows), work, out)
        slack = np.concatenate([np.zeros(6), np.ones(len(rows) - 6)])
        least = linprog(  # the smallest s with rows @ x + s >= bound, the box kept
            [0, 0, 0, 1],
            A_ub=-np.column_stack([rows, slack]),
            b_ub=-bound,
            bounds=[(None, None)] * 3 + [(0, None)],
        )
        assert worst == pytest.approx(least.fun, abs=1e-6)
        assert (rows @ out >= bound - worst * slack - 2 * TOLERANCE).all()
        broken += worst > 0
    assert 20 < broken < 200


def test_equal_and_opposite_rows_and_a_target_that_is_fine():
    work, out = new_workspace(8), np.zeros(3)
    rows = np.array([[1.0, 0, 0], [-1.0, 0, 0], [1.0, 0, 0], [0, 0, -1.0]])
    bound = np.array([1.0, -1.0, 1.0, -2.0])
    assert nearest_point(np.array([3.0, 4.0, 5.0]), rows, bound, 4, work, out)
    assert out == pytest.approx([1.0, 4.0, 2.0])
    assert nearest_point(np.array([1.0, 4.0, 2.0]), rows, bound, 4, work, out)
    assert out.tolist() == [1.0, 4.0, 2.0]
    bound[1] = -0.5  # x >= 1 and x <= 0.5
    assert not nearest_point(np.zeros(3), rows, bound, 4, work, out)


def closest(x: FloatArray, v: FloatArray, horizon: float) -> float:
    """Smallest distance within the horizon, on a fine grid of times."""
    times = np.linspace(0.0, horizon, 4001)
    return float(np.linalg.norm(x - times[:, None] * v, axis=1).min())


def test_the_barrier_is_the_distance_to_velocities_that_collide():
    rng, reach, horizon = np.random.default_rng(2), 0.22, 0.8
    inside = 0
    for _ in range(200):
        x = rng.normal(size=3)
        x *= rng.uniform(0.25, 1.5) / np.linalg.norm(x)
        v = rng.normal(0.0, 0.5, 3) + 2.0 * x
        *n, h = velocity_barrier(tuple(x), tuple(v), reach, horizon)
        normal = np.array(n)
        assert np.linalg.norm(normal) == pytest.approx(1.0)
        assert (closest(x, v, horizon) < reach - 1e-4) <= (h < 1e-3)
        assert (closest(x, v, horizon) > reach + 1e-4) <= (h > -1e-3)
        on_edge = v - h * normal  # the nearest velocity that just misses, or just touches
        assert closest(x, on_edge, horizon) == pytest.approx(reach, abs=2e-4)
        for _ in range(20):  # and no nearer one is on the other side
            turn = rng.normal(size=3)
            other = v + 0.95 * abs(h) * turn / np.linalg.norm(turn)
            assert (closest(x, other, horizon) < reach) == (h < 0)
        inside += h < 0
    assert 30 < inside < 170
