"""Stage 2: what sequential convex programming makes of a guess, on the nonlinear model."""

from __future__ import annotations

import time

import numpy as np
import pytest

from swarm_envs.baselines.neural_swarm.planner import PlanningProblem
from swarm_envs.baselines.neural_swarm.planner.convex_program import PenaltyWeights
from swarm_envs.baselines.neural_swarm.planner.problem import Plane
from swarm_envs.baselines.neural_swarm.planner.scp import RefinementOptions, merit_terms, refine
from swarm_envs.baselines.neural_swarm.planner.trajectories import (
    Trajectories,
    closest_approach,
    straight_lines,
    trajectories_through,
)
from swarm_envs.baselines.neural_swarm.planner.verify import check_plan
from swarm_envs.interactions import load
from swarm_envs.vehicles import parse_team

ROW = np.array([[0.0, -1.0, 1.2], [0.0, 1.0, 1.2], [0.0, 0.0, 1.2]])


def swap(model: str = "learned", plane: Plane = "yz") -> PlanningProblem:
    return PlanningProblem(ROW, ROW[[1, 2, 0]], parse_team("SSL"), load(model), plane=plane)


def bent(problem: PlanningProblem) -> Trajectories:
    return straight_lines(problem, bend=[[0.0, 0.0, 0.3], [0.0, 0.0, -0.2], [0.0, 0.0, -0.1]])


def merit(problem: PlanningProblem, motions: Trajectories) -> float:
    bounds = problem.bounds.force_bounds(problem.team)
    return merit_terms(problem, motions, bounds).team(PenaltyWeights())


@pytest.mark.parametrize("plane", ["yz", "xyz"])
@pytest.mark.parametrize("model", ["learned", "none"])
def test_a_colliding_guess_becomes_a_plan_that_keeps_everything(model: str, plane: Plane) -> None:
    problem = swap(model, plane)
    guess = straight_lines(problem)
    assert check_plan(problem, guess).distance_ratio < 1.0
    free = (
        plane == "xyz" and model == "none"
    )  # the force is symmetric: a straight guess is a saddle
    refined = refine(problem, guess if free else bent(problem), np.random.default_rng(0))
    assert refined.converged
    check = check_plan(problem, refined.trajectories)
    assert check.shortcomings() == ()
    assert check.defect < 1e-9
    aside = refined.trajectories.states[..., 0] - ROW[:, 0]
    assert plane == "xyz" or np.abs(aside).max() == 0.0


def test_the_merit_never_rises_and_is_the_measured_one() -> None:
    problem, options = swap(), RefinementOptions(max_tightenings=0)
    refined = refine(problem, bent(problem), np.random.default_rng(1), options)
    merits = [record.merit for record in refined.history]
    assert (np.diff(merits) <= 0.0).all()
    assert merits[-1] == merit(problem, refined.trajectories)
    for record in refined.history:
        assert record.taken == (record.gained > 0.0)


def test_one_robot_alone_finds_the_known_optimum() -> None:
    """The least sum of ||u||^2 from rest to rest in time T over a way d is 12 d^2 / (T^3 dt)."""
    problem = PlanningProblem(
        ROW[:1], ROW[1:2], parse_team("S"), load("none"), dt=0.05, max_duration=4.0, plane="yz"
    )
    guess = straight_lines(problem, bend=[[0.0, 0.0, 0.3]])
    refined = refine(problem, guess, np.random.default_rng(0))
    assert refined.converged
    assert refined.trajectories.energy == pytest.approx(12 * 2.0**2 / (4.0**3 * 0.05), rel=2e-3)


def test_the_aware_plan_keeps_force_bounds_that_the_unaware_one_breaks() -> None:
    aware, unaware = swap("learned"), swap("none")
    guess = straight_lines(aware, bend=[[0.0, 0.0, -0.3], [0.0, 0.0, 0.0], [0.0, 0.0, 0.0]])
    blind = refine(unaware, guess, np.random.default_rng(0)).trajectories
    met = check_plan(aware, trajectories_through(aware, blind.states))
    assert met.force_ratio > 1.5
    refined = refine(aware, guess, np.random.default_rng(0))
    assert check_plan(aware, refined.trajectories).force_ratio < 1.05


def test_a_deadline_and_a_limit_leave_the_best_so_far_and_say_so() -> None:
    problem = swap()
    late = refine(problem, bent(problem), np.random.default_rng(0), deadline=time.monotonic() - 1)
    assert (late.converged, late.out_of_time, late.history) == (False, True, ())
    assert late.trajectories.states.tobytes() == bent(problem).states.tobytes()
    short = refine(
        problem, bent(problem), np.random.default_rng(0), RefinementOptions(max_sweeps=1)
    )
    assert not short.converged
    assert len(short.history) == 3
    assert "1 sweeps" in short.reason
    assert merit(problem, short.trajectories) < merit(problem, bent(problem))


def test_closest_approach_between_knots() -> None:
    """Two points pass at 3 cm in the middle of a step; a held acceleration bends the way."""
    states = np.array([[-0.5, 0.03, 0.0, 10.0, 0.0, 0.0], [0.5, 0.03, 0.0, 10.0, 0.0, 0.0]])
    near = closest_approach(states, 0.1)
    assert near.distance == pytest.approx(0.03)
    assert near.fraction == pytest.approx(0.5)
    thrown = np.array([[0.0, 0.5, 0.0, 0.0, -3.0, 0.0], [0.0, 0.5, 0.0, 0.0, 3.0, 0.0]])
    near = closest_approach(thrown, 0.5)  # up and back: the vertex is 3^2 / (2 * 12) m away
    assert near.distance == pytest.approx(0.5 - 0.375, abs=1e-9)
