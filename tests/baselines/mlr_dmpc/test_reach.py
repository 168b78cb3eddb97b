"""Rows left out: no plan can come where they would bind, and no optimum changes."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from swarm_envs.baselines.mlr_dmpc.avoidance_planes import out_of_reach, reachable_boxes
from swarm_envs.baselines.mlr_dmpc.condensed_qp import condensed
from swarm_envs.baselines.mlr_dmpc.mlr_dmpc_config import MlrDmpcConfig
from swarm_envs.baselines.mlr_dmpc.row_generation import Program, solve_by_rows
from swarm_envs.baselines.mlr_dmpc.trajectory_qp import program
from tests.helpers.mlr_rounds import situation

WIDE = MlrDmpcConfig(box=((-5.0, -5.0, 0.3), (5.0, 5.0, 3.0)))
CONFIGS = [WIDE, MlrDmpcConfig(), replace(WIDE, input_sampling_s=0.1, collision_sampling_s=0.05)]


def fresh(rows: Any) -> Any:
    """The same rows with none out of reach."""
    return rows._replace(
        done=np.zeros_like(rows.done),
        soft_done=rows.soft_scales > 1e4,
        bounds_done=np.zeros_like(rows.bounds_done),
    )


def extreme(problem: Program, rng: np.random.Generator) -> np.ndarray:
    """Variables of a plan at the edge of what the bounds allow, in a random direction."""
    alone = fresh(problem.rows)
    alone.done[:], alone.soft_done[:] = True, True
    slope = rng.normal(size=problem.slope.shape) * rng.choice([1.0, 100.0, 1e3], size=(1, 3))
    found = solve_by_rows(replace(problem, rows=alone, slope=slope))
    assert not found.failure
    return found.z


@pytest.mark.parametrize("config", CONFIGS)
def test_no_plan_leaves_the_reach_or_breaks_a_row_left_out(config):
    rng = np.random.default_rng(3)
    for seed in range(3):
        problem = program(*situation(seed, 3 * seed + 1, 20, config, 4), config)
        rows = problem.rows
        low, high = reachable_boxes(problem.state, rows.lower, rows.upper, config)
        left_out = out_of_reach(low, high, rows.normals, rows.offsets)
        assert left_out.any() and not left_out.all()
        for _ in range(8):
            positions = rows.base + rows.by_variables @ extreme(problem, rng)
            assert (positions >= low).all() and (positions <= high).all()
            slack = np.einsum("rsi,si->rs", rows.normals, positions) - rows.offsets
            assert slack[left_out].min() >= 0.0


@settings(max_examples=15, deadline=None)
@given(seed=st.integers(0, 10**6), rounds=st.integers(0, 12))
def test_rows_left_out_change_no_optimum(seed, rounds):
    problem = program(*situation(seed, rounds, 20, WIDE, 4), WIDE)
    assert problem.rows.done.any()
    whole = replace(problem, rows=fresh(problem.rows))
    found, expected = solve_by_rows(problem), solve_by_rows(whole)
    assert not found.failure and not expected.failure
    assert np.allclose(found.z, expected.z, atol=1e-6)


def test_the_reach_is_not_vast():
    """From rest, three seconds at two metres a second allow less than five metres."""
    fixed = condensed(WIDE)
    state = np.array([[0.0, 0.0, 1.0], [0.0] * 3, [0.0] * 3])
    low, high = reachable_boxes(state, fixed.lower, fixed.upper, WIDE)
    assert (high - low)[:, 0].max() < 10.0
    assert np.all(np.diff(high[:20, 0]) >= 0.0)
    assert high[0, 0] == pytest.approx(5.0 * WIDE.collision_sampling_s**3 / 6, abs=2e-6)
