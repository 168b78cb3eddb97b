"""One robot's convex program, against the same program written down again for cvxpy."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest

from swarm_envs.baselines.neural_swarm.planner import PlanningProblem
from swarm_envs.baselines.neural_swarm.planner.convex_program import (
    ConvexSubproblem,
    PenaltyWeights,
    RobotProgram,
    SolverSettings,
    convexify,
)
from swarm_envs.baselines.neural_swarm.planner.problem import Plane
from swarm_envs.baselines.neural_swarm.planner.scp import with_velocity
from swarm_envs.baselines.neural_swarm.planner.trajectories import (
    Trajectories,
    states_within,
    straight_lines,
    trajectories_through,
    vertical_forces,
)
from swarm_envs.interactions import load
from swarm_envs.vehicles import parse_team

EXACT = SolverSettings(tolerance=1e-8, max_iterations=100_000)
STARTS = np.array([[0.0, -0.8, 1.0], [0.0, 0.0, 1.3], [0.0, 0.8, 1.0]])
GOALS = STARTS[[1, 2, 0]]
BENDS = {
    "apart": [[0.0, 0.1, 0.3], [0.0, 0.0, 0.2], [0.0, 0.1, -0.4]],
    "too near": [[0.0, 0.0, 0.0], [0.0, 0.1, 0.1], [0.0, 0.0, -0.15]],
}


def problem_of(plane: Plane, model: str = "learned", steps: int = 30) -> PlanningProblem:
    shift = np.array([[0.2, 0.0, 0.0], [-0.1, 0.0, 0.0], [0.0, 0.0, 0.0]])
    starts, goals = (STARTS, GOALS) if plane == "yz" else (STARTS + shift, GOALS - shift)
    return PlanningProblem(
        starts, goals, parse_team("SSL"), load(model), dt=0.1, max_duration=0.1 * steps, plane=plane
    )


def program_of(problem: PlanningProblem, prior: Trajectories) -> RobotProgram:
    dims, others = len(problem.axes), len(problem.team) - 1
    return RobotProgram(prior.steps, dims, others, settings=EXACT)


def around(problem: PlanningProblem, prior: Trajectories, robot: int) -> ConvexSubproblem:
    limits = problem.bounds.force_bounds(problem.team)
    return convexify(problem, prior, robot, (0.3, 1.0), 5.0, limits)


def oracle(c: ConvexSubproblem, weights: PenaltyWeights) -> tuple[np.ndarray, np.ndarray, float]:
    """States, controls and objective of eq. (17) with its misprints mended, by cvxpy."""
    cp = pytest.importorskip("cvxpy")
    steps, dims = c.prior_control.shape
    p, v = cp.Variable((steps + 1, dims)), cp.Variable((steps + 1, dims))
    u, delta = cp.Variable((steps, dims)), cp.Variable(nonneg=True)
    x = cp.hstack([p, v])
    rules = [x[0] == c.prior[0], cp.abs(x - c.prior)[1:] <= np.tile(c.trust_state, (steps, 1))]
    rules += [cp.abs(u - c.prior_control) <= c.trust_control, cp.abs(u) <= c.control_bound]
    change = x - c.prior

    def changed(by_state: np.ndarray) -> Any:
        return cp.sum(cp.multiply(by_state, change[: len(by_state)]), axis=1)

    force = cp.vstack([c.force[:, a] + changed(c.force_by_state[:, a]) for a in range(dims)]).T
    rules.append(v[1:] == v[:-1] + c.dt * (u + force / c.mass))
    rules.append(p[1:] == p[:-1] + 0.5 * c.dt * (v[1:] + v[:-1]))

    def within(fraction: np.ndarray) -> tuple[Any, Any]:
        share = np.tile(fraction[:, None], dims)
        held = (v[1:] - v[:-1]) / c.dt
        way = cp.multiply(c.dt * share, v[:-1]) + cp.multiply(0.5 * (c.dt * share) ** 2, held)
        return p[:-1] + way, v[:-1] + cp.multiply(c.dt * share, held)

    moments = [np.full(steps, share) for share in c.shares]
    at = [cp.hstack(within(m)) - c.bounded[s] for s, m in enumerate(moments)]

    def pushed(by_state: np.ndarray, s: int) -> Any:
        return cp.sum(cp.multiply(by_state[s], at[s]), axis=1)

    for s in range(len(at)):
        felt = c.bounded_force[s] + pushed(c.bounded_by_state, s)
        rules.append(cp.abs(felt) <= c.force_bound * (1 + delta))
    rules.append(x[1:] <= np.tile(c.upper, (steps, 1)) + delta)
    rules.append(x[1:] >= np.tile(c.lower, (steps, 1)) - delta)
    effort, soft = cp.sum(changed(c.effort_by_state)), 0.0
    for j in range(c.normal.shape[1]):
        pushes = [pushed(c.neighbor_by_state[:, :, j], s) for s in range(len(at))]
        rules += [cp.abs(push) <= c.force_change for push in pushes]
        ratios = [
            (c.neighbor_force[s, :, j] + push) / c.neighbor_bound[j]
            for s, push in enumerate(pushes)
        ]
        for side in (1, -1):
            soft += cp.sum(cp.pos(cp.maximum(*(side * ratio for ratio in ratios)) - 1))
        there, _ = within(c.fraction[:, j])
        across = cp.sum(cp.multiply(c.normal[:, j], there), axis=1)
        soft += cp.sum(cp.pos(c.level[:, j] - across))
    missed = cp.norm(x[steps] - c.goal, "inf")
    value = cp.sum_squares(u) + weights.goal * missed + weights.state * delta
    task = cp.Problem(cp.Minimize(value + effort + weights.neighbor * soft), rules)
    task.solve(solver="CLARABEL")
    assert task.status == "optimal"
    return x.value, u.value, float(task.value)


@pytest.mark.parametrize("plane", ["yz", "xyz"])
@pytest.mark.parametrize("bend", BENDS)
def test_the_solution_is_that_of_cvxpy(plane: Plane, bend: str) -> None:
    problem = problem_of(plane)
    prior = straight_lines(problem, bend=BENDS[bend])
    for robot in range(3):
        check_against_oracle(problem, prior, around(problem, prior, robot))


def check_against_oracle(problem: PlanningProblem, prior: Trajectories, c: ConvexSubproblem):
    solution = program_of(problem, prior).solve(c)
    states, controls, objective = oracle(c, PenaltyWeights())
    assert solution.status == "solved"
    np.testing.assert_allclose(solution.states, states, atol=1e-4)
    np.testing.assert_allclose(solution.controls, controls, atol=1e-4)
    assert solution.objective == pytest.approx(objective, rel=1e-5)


def test_what_cannot_be_kept_is_missed_at_the_price_of_its_slack() -> None:
    problem = problem_of("yz")
    still = np.repeat(straight_lines(problem).states[:1], 31, axis=0)
    prior = trajectories_through(problem, still)
    convex = around(problem, prior, 2)  # the goal lies outside the trust region
    check_against_oracle(problem, prior, convex)
    tight = dataclasses.replace(convex, upper=convex.prior[0] - 0.1)
    check_against_oracle(problem, prior, tight)


def test_a_program_used_again_solves_the_new_problem() -> None:
    problem = problem_of("yz")
    program = program_of(problem, straight_lines(problem))
    for bend in BENDS.values():
        prior = straight_lines(problem, bend=bend)
        convex = around(problem, prior, 2)
        used, fresh = program.solve(convex), program_of(problem, prior).solve(convex)
        np.testing.assert_allclose(used.states, fresh.states, atol=1e-5)


@pytest.mark.parametrize("robot", [0, 2])
def test_what_is_linearised_is_right_to_first_order(robot: int) -> None:
    """Halving a change quarters what the linearised forces, distances and effort miss."""
    problem = problem_of("xyz", "wake")
    prior = straight_lines(problem, bend=BENDS["apart"])
    c, others = around(problem, prior, robot), [j for j in range(3) if j != robot]
    rng = np.random.default_rng(robot)
    change = np.cumsum(rng.standard_normal((31, 3)), axis=0) * 2e-4
    change[0] = 0.0
    missed = []
    for size in (1.0, 0.5):
        new = with_velocity(problem, prior, robot, prior.velocity[:, robot] + size * change)
        d = (new.states - prior.states)[:, robot]
        own = (new.forces - prior.forces)[:-1, robot]
        own -= np.einsum("kab,kb->ka", c.force_by_state, d[:-1])
        before, after = (vertical_forces(problem, states_within(m, c.shares)) for m in (prior, new))
        np.testing.assert_allclose(before[..., others], c.neighbor_force, atol=1e-12)
        np.testing.assert_allclose(before[..., robot], c.bounded_force, atol=1e-12)
        within = states_within(new, c.shares)[:, :, robot] - c.bounded
        theirs = (after - before)[..., others]
        theirs -= np.einsum("skmb,skb->skm", c.neighbor_by_state, within)
        effort = (new.controls**2 - prior.controls**2)[:, others].sum()
        effort -= (c.effort_by_state * d[:-1]).sum()
        missed.append([np.abs(own).sum(), np.abs(theirs).sum(), abs(effort)])
    assert (np.array(missed[1]) < 0.3 * np.array(missed[0]) + 1e-12).all()
