"""Problems, one robot's convex program beside cvxpy, and what many of them make of a guess."""

from __future__ import annotations

import dataclasses
import time
from typing import Any

import numpy as np
import pytest

from swarm_envs.baselines.neural_swarm.planner import PlanningBounds, PlanningProblem, scp
from swarm_envs.baselines.neural_swarm.planner.convex_program import (
    ConvexSubproblem,
    PenaltyWeights,
    RobotProgram,
    SolverSettings,
    convexify,
)
from swarm_envs.baselines.neural_swarm.planner.problem import Plane, shortest_time
from swarm_envs.baselines.neural_swarm.planner.scp import merit_terms, refine, with_velocity
from swarm_envs.baselines.neural_swarm.planner.trajectories import (
    Trajectories,
    closest_approach,
    states_within,
    straight_lines,
    trajectories_through,
    vertical_forces,
)
from swarm_envs.baselines.neural_swarm.planner.verify import check_plan
from swarm_envs.interactions import InteractionModel, load
from swarm_envs.interactions.field import WAKE, empty_field
from swarm_envs.vehicles import parse_team

EXACT = SolverSettings(tolerance=1e-8, max_iterations=100_000)
STARTS = np.array([[0.0, -0.8, 1.0], [0.0, 0.0, 1.3], [0.0, 0.8, 1.0]])
GOALS = STARTS[[1, 2, 0]]
BENDS = {
    "apart": [[0.0, 0.1, 0.3], [0.0, 0.0, 0.2], [0.0, 0.1, -0.4]],
    "too near": [[0.0, 0.0, 0.0], [0.0, 0.1, 0.1], [0.0, 0.0, -0.15]],
}


def problem_of(plane: Plane, model: str = "learned") -> PlanningProblem:
    shift = np.array([[0.2, 0.0, 0.0], [-0.1, 0.0, 0.0], [0.0, 0.0, 0.0]])
    starts, goals = (STARTS, GOALS) if plane == "yz" else (STARTS + shift, GOALS - shift)
    options: dict[str, Any] = {"dt": 0.1, "max_duration": 3.0, "plane": plane}
    return PlanningProblem(starts, goals, parse_team("SSL"), load(model), **options)


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
    # The force is symmetric: a straight guess is a saddle.
    free = plane == "xyz" and model == "none"
    refined = refine(problem, guess if free else bent(problem), np.random.default_rng(0))
    assert refined.converged
    check = check_plan(problem, refined.trajectories)
    assert check.shortcomings() == ()
    assert check.defect < 1e-9
    aside = refined.trajectories.states[..., 0] - ROW[:, 0]
    assert plane == "xyz" or np.abs(aside).max() == 0.0


def test_the_merit_never_rises_and_is_the_measured_one(monkeypatch) -> None:
    monkeypatch.setattr(scp, "MAX_TIGHTENINGS", 0)
    problem = swap()
    refined = refine(problem, bent(problem), np.random.default_rng(1))
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


def test_a_deadline_and_a_limit_leave_the_best_so_far_and_say_so(monkeypatch) -> None:
    problem = swap()
    late = refine(problem, bent(problem), np.random.default_rng(0), deadline=time.monotonic() - 1)
    assert (late.converged, late.out_of_time, late.history) == (False, True, ())
    assert late.trajectories.states.tobytes() == bent(problem).states.tobytes()
    monkeypatch.setattr(scp, "MAX_SWEEPS", 1)
    short = refine(problem, bent(problem), np.random.default_rng(0))
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


LEARNED, FREE = load("learned"), load("none")
SMALL_ONLY = InteractionModel("small only", ("S",), empty_field(1)._replace(kind=WAKE))
ROW_OF_THREE = [[0.0, -1.0, 1.0], [0.0, 0.0, 1.0], [0.0, 1.0, 1.0]]
CROSSED = [[0.0, 1.0, 1.0], [0.0, 0.0, 1.5], [0.0, -1.0, 1.0]]
LOW: dict[str, Any] = {"starts": [[0, 0, 0.1]], "goals": [[0, 0, 1]], "team": "L"}
LOW["bounds"] = PlanningBounds(lower=(-2, -2, 0.05), force_g={"L": 0.05})
BELOW: dict[str, Any] = {"starts": [[0, 0, 1.5], [0, 0, 1.0]], "goals": [[0, -1, 1], [0, 1, 1]]}
BELOW["team"] = "SS"


def problem(**changes: Any) -> PlanningProblem:
    options: dict[str, Any] = {"starts": ROW_OF_THREE, "goals": CROSSED, "team": "SSL"}
    return PlanningProblem(**(options | {"model": FREE, "plane": "yz"} | changes))


def moved(places, drone, place):
    return [place if i == drone else p for i, p in enumerate(places)]


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"starts": moved(ROW_OF_THREE, 0, [0, -2.5, 1])}, r"start of drone 0 .* outside the box"),
        ({"goals": moved(CROSSED, 1, [0, 1, 1.1])}, r"goals of drones 0 and 1 .* 0\.132 m apart"),
        ({"goals": moved(CROSSED, 1, [0.1, 0, 1.5])}, r"plane='yz' keeps x"),
        ({"max_duration": 1.0}, r"drone 0 cannot reach .* at least 1\.31 s"),
        ({"dt": 0.7, "max_duration": 1.39}, r"1 steps of 0\.7 s"),
        ({"team": "SX"}, "unknown vehicle token 'X'"),
        ({"team": "SS"}, r"starts has shape \(3, 3\)"),
        ({"starts": moved(ROW_OF_THREE, 0, [0, np.nan, 1])}, "nan at index"),
        ({"bounds": PlanningBounds(force_g={"S": 5.0})}, "unknown vehicle token 'L'"),
        ({"model": SMALL_ONLY}, r"unknown interaction type 'L'.*'small only'"),
        # Near the ground the learned model lifts a lone drone.
        (LOW | {"model": LEARNED}, r"drone 0 \(L\) hovering alone at its start .* raise"),
        (BELOW | {"model": LEARNED}, r"drone 1 \(S\) hovering with the others at its start"),
    ],
)
def test_refused(changes, message):
    with pytest.raises(ValueError, match=message):
        problem(**changes)


def test_stacked_starts_are_accepted_without_wakes():
    problem(**BELOW)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"force_g": {"S": 0.0}}, r"force_g\['S'\] is 0.0"),
        ({"clearance_factor": 0.9}, "clearance_factor is 0.9, but must be at least 1"),
        ({"lower": (0, 0, 3)}, "upper must be larger"),
    ],
)
def test_bounds_refused(changes, message):
    with pytest.raises(ValueError, match=message):
        PlanningBounds(**changes)


def test_the_shortest_time_is_that_of_bang_bang():
    """Accelerate at a over half the way d: t = 2 sqrt(d / a), until the speed is at its limit."""
    assert shortest_time(0.5, 2.0, 5.0) == pytest.approx(2 * np.sqrt(0.1))
    assert shortest_time(2.0, 2.0, 5.0) == pytest.approx(2.0 / 2.0 + 2.0 / 5.0)
    assert shortest_time(0.8, 2.0, 5.0) == pytest.approx(0.8)  # where both agree
