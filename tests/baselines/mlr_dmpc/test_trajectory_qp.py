"""A trajectory, its optimum against cvxpy; and swarms of them without message loss."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import cvxpy as cp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from swarm_envs.baselines.mlr_dmpc.avoidance_planes import SPARE_M, Neighbors
from swarm_envs.baselines.mlr_dmpc.condensed_qp import condensed
from swarm_envs.baselines.mlr_dmpc.formations import circle_swap
from swarm_envs.baselines.mlr_dmpc.mlr_dmpc_config import MlrDmpcConfig
from swarm_envs.baselines.mlr_dmpc.row_generation import Program, solve_by_rows
from swarm_envs.baselines.mlr_dmpc.swarm import MlrDmpcSwarm, SwarmRound
from swarm_envs.baselines.mlr_dmpc.trajectory import Identity, Trajectory, hover, sampled_positions
from swarm_envs.baselines.mlr_dmpc.trajectory_qp import ACCEPTED, broken, plan_trajectory, program
from tests.helpers.mlr_rounds import (
    Situation,
    arrival_time,
    keep_clear,
    neighbors_of,
    scattered,
    settled,
    situation,
    situation_of,
)

CONFIG = MlrDmpcConfig(planes="fixed")


def posed(case: Situation, config: MlrDmpcConfig = CONFIG) -> Program:
    own, start, neighbors, target = case
    return program(own, start, neighbors, target, config)


def crossing() -> Situation:
    swarm = MlrDmpcSwarm(*circle_swap(8, 0.8, 1.0), compute_units=2)
    for _ in range(9):
        swarm.run_round()
    return situation_of(swarm)


CASES = [*(situation(seed, rounds, 8, CONFIG) for seed, rounds in ((0, 4), (1, 9), (2, 15)))]
CASES.append(crossing())


def by_cvxpy(problem: Program) -> tuple[np.ndarray, float]:
    """The same program with every row and every margin, soft ones as variables."""
    rows = problem.rows
    z = cp.Variable(problem.slope.shape)
    position = rows.base + rows.by_variables @ z
    bounded = rows.bounded_base + rows.bounded_by_variables @ z
    constraints: list[Any] = [bounded >= rows.lower, bounded <= rows.upper]
    for s in range(len(rows.base)):
        constraints.append(rows.normals[:, s] @ position[s] >= rows.offsets[:, s])
    weights = np.where(rows.soft_scales > 1e4, 0.0, rows.soft_scales**-2)
    short = cp.Variable(len(weights))
    constraints += [rows.normals[:, -1] @ position[-1] + short >= rows.soft_offsets, short >= 0]
    cost = cp.sum_squares(z) / 2 + cp.sum(cp.multiply(problem.slope, z))
    cost += cp.sum(cp.multiply(weights, cp.square(short))) / 2
    best = cp.Problem(cp.Minimize(cost), constraints).solve(solver=cp.CLARABEL)
    return np.asarray(z.value), float(best)


@pytest.mark.parametrize("case", CASES)
def test_the_optimum_is_that_of_the_whole_program(case):
    expected, _ = by_cvxpy(posed(case))
    found = solve_by_rows(posed(case))
    assert not found.failure
    assert np.allclose(found.z, expected, atol=2e-4)


def assert_holds(plan: Trajectory, case: Situation, config: MlrDmpcConfig) -> None:
    """Every constraint by the letter of eq. (13)-(15), without our rows."""
    own, start, neighbors, _ = case
    since = config.round_s * (start - own.identity.start_round)
    times = np.arange(1.0, config.num_samples + 1.0) * config.collision_sampling_s
    old, new = own.positions(since + times), plan.positions(times)
    scale = np.array(config.scaling)
    for other, concurrent in zip(neighbors.positions, neighbors.concurrent, strict=True):
        gap = np.linalg.norm((new - other) / scale, axis=1)
        normal = (old - other) / scale
        length = np.linalg.norm(normal, axis=1)
        if not concurrent:
            assert (gap >= config.sampled_distance_m - 1e-6).all()
        elif config.turn_rad == 0.0:
            along = np.sum(normal * (new - (old + other) / 2) / scale, axis=1) / length
            assert (along >= config.sampled_distance_m / 2 - 5e-7).all()
    p, v, a = np.moveaxis(plan.states(np.arange(1.0, 16.0) * config.state_sampling_s), 1, 0)
    lower, upper = np.array(config.box)
    assert (p >= lower - 2e-6).all() and (p <= upper + 2e-6).all()
    assert np.abs(v).max() <= config.speed_limit + 2e-6
    assert np.abs(a).max() <= config.acceleration_limit + 2e-6
    assert np.abs(plan.jerk).max() <= config.jerk_limit + 2e-6
    assert np.array_equal(plan.state, plan.state.astype(np.float32))
    at_start = own.states(np.array([since]))[0]
    assert np.allclose(plan.state, at_start, atol=1e-6)
    end = plan.states(np.array([len(plan.jerk) * plan.input_sampling_s - 1e-7]))[0]
    assert np.allclose(end[1:], 0.0, atol=5e-6) and not plan.jerk[-1].any()


@settings(max_examples=25, deadline=None)
@given(
    seed=st.integers(0, 10**6),
    rounds=st.integers(0, 20),
    n=st.integers(2, 10),
    turn=st.sampled_from([0.0, MlrDmpcConfig.turn_rad]),
)
def test_accepted_plans_satisfy_everything(seed, rounds, n, turn):
    config = replace(CONFIG, turn_rad=turn)
    case = situation(seed, rounds, n, config)
    own, start, neighbors, target = case
    planned = plan_trajectory(own, start, 1, neighbors, target, config)
    assert planned.shifted_slack >= -1e-6
    assert planned.accepted, planned.reason
    assert planned.trajectory.identity == Identity(start, 1)
    assert_holds(planned.trajectory, case, config)


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 10**6), turn=st.sampled_from([0.0, MlrDmpcConfig.turn_rad, 1.0]))
def test_two_that_are_planned_at_once_keep_their_distance(seed, turn):
    """Corollary 1: each satisfies its half of one plane."""
    config = MlrDmpcConfig(turn_rad=turn)
    rng = np.random.default_rng(seed)
    starts, targets = scattered(4, config, rng, 0.26), scattered(4, config, rng)
    swarm = MlrDmpcSwarm(starts, targets, config=config, compute_units=4, seed=seed)
    for _ in range(6):
        free, start = settled(swarm), swarm.round + 1
        at = []
        for i in free:
            others, own = neighbors_of(swarm, i, free), swarm.may_fly[i][0]
            plan = plan_trajectory(own, start, 0, others, swarm.targets[i], swarm.config)
            at.append(sampled_positions(plan.trajectory, start, config))
        for k, one in enumerate(at):
            for other in at[:k]:
                gap = np.linalg.norm((one - other) * config.inverse_scaling, axis=1)
                assert gap.min() >= config.sampled_distance_m - 1e-6
        swarm.run_round()


def test_what_cannot_be_solved_leaves_what_is_flown():
    own = hover(np.array([0.0, 0.0, 1.0]), 15, 0.2)
    at = np.tile([0.1, 0.0, 1.0], (1, CONFIG.num_samples, 1))
    at = np.concatenate([at, at * [-1.0, 1.0, 1.0]])
    near = Neighbors(at, np.array([1, 2]), np.array([False, False]))
    planned = plan_trajectory(own, 1, 0, near, np.array([1.0, 0.0, 1.0]), CONFIG)
    assert planned.shifted_slack == pytest.approx(0.1 - CONFIG.sampled_distance_m, abs=5e-6)
    after = planned.trajectory.positions(condensed(CONFIG).collision_times)
    assert (np.abs(after[:, 0]) <= 1e-6).all(), "between the two, neither may come nearer"


@pytest.mark.parametrize("gap", [-2e-6, -5e-8, 4e-7, 9e-7, 3e-6])
def test_a_drone_that_touches_another_at_rest_still_goes_its_way(gap):
    """Roundings may have used up the margin of a row; its optimum was refused for ever then."""
    config = MlrDmpcConfig()
    other = np.array([0.0, config.sampled_distance_m + SPARE_M + gap, 1.0])
    path = np.tile(other, (1, config.num_samples, 1))
    near = Neighbors(path, np.array([1]), np.array([False]))
    own = hover(np.array([0.0, 0.0, 1.0]), 15, 0.2)
    planned = plan_trajectory(own, 1, 0, near, np.array([1.0, 0.4, 1.0]), config)
    assert planned.accepted, planned.reason
    assert planned.trajectory.positions(np.array([3.0]))[0, 0] > 0.5


def test_what_a_plan_breaks_is_named():
    case = CASES[0]
    problem, fixed = posed(case), condensed(CONFIG)
    good = plan_trajectory(*case[:2], 0, *case[2:], CONFIG).trajectory

    def with_jerk(change: np.ndarray) -> str:
        jerk = good.jerk + change
        jerk[-1] = 0.0
        return broken(Trajectory(good.identity, good.state, jerk, 0.2), problem, fixed)

    assert with_jerk(np.zeros((15, 3))) == ACCEPTED
    kick = np.zeros((15, 3))
    kick[3, 0] = 1e-4
    assert "rest" in with_jerk(kick)
    assert "bound" in with_jerk(2.0 * fixed.jerks.free[:, :1] * [[0.0, 0.0, 1.0]])
    assert with_jerk(np.full((15, 3), np.nan)) != ACCEPTED


@pytest.mark.parametrize("offset", [0.0, 1e-3, -1e-3, 0.04, -0.04])
def test_two_head_on_pass_each_other_on_the_right(offset):
    """Also if they begin a little to the left of each other."""
    side = offset / 2
    starts = np.array([[-1.2, side, 1.0], [1.2, -side, 1.0]])
    swarm = MlrDmpcSwarm(starts, starts * [-1.0, 1.0, 1.0], compute_units=1)
    aside = []

    def watch(now: MlrDmpcSwarm, _: SwarmRound) -> None:
        first, second = now.reference(np.zeros(1))[:, 0, 0]
        aside.append((abs(first[0] - second[0]), first[1] - second[1]))

    assert arrival_time(swarm, 15.0, watch) < 15.0
    assert min(aside)[1] < -0.1, "the one that flies towards +x passes at smaller y"


@pytest.mark.slow
@pytest.mark.parametrize(("units", "limit"), [(1, 10.5), (2, 9.5), (3, 9.5)])
def test_sixteen_change_places_on_a_circle(units, limit):
    swarm = MlrDmpcSwarm(*circle_swap(16, 1.5, 1.0), compute_units=units)
    assert arrival_time(swarm, limit + 1.0, keep_clear) <= limit


@pytest.mark.slow
def test_none_of_200_random_swarms_ends_in_a_deadlock():
    late = []
    for seed in range(200):
        rng = np.random.default_rng(seed)
        n = int(rng.integers(4, 17))
        swarm = MlrDmpcSwarm(scattered(n, CONFIG, rng), scattered(n, CONFIG, rng), seed=seed)
        if not arrival_time(swarm, 60.0, keep_clear) <= 60.0:
            late.append(seed)
    assert not late
