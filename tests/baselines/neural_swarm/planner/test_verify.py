"""The check of plans, on motions worked out by hand."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from swarm_envs.baselines.neural_swarm.planner import PlanningBounds, PlanningProblem
from swarm_envs.baselines.neural_swarm.planner.trajectories import Trajectories
from swarm_envs.baselines.neural_swarm.planner.verify import PlanCheck, check_plan, roll_out
from swarm_envs.interactions import load
from swarm_envs.state import FloatArray
from swarm_envs.vehicles import GRAM_FORCE, LARGE, SMALL, Team, parse_team

START = np.array([[0.0, 0.0, 1.0]])
DT = 0.5


class Lift:
    """A vertical force of so many newtons for each metre along x and so many besides."""

    def __init__(self, slope: float = 0.0, constant: float = 0.0) -> None:
        self.slope, self.constant = slope, constant

    def type_indices(self, team: Team) -> list[int]:
        return [0] * len(team)

    def forces(self, position: FloatArray, velocity: FloatArray, team: Team) -> FloatArray:
        force = np.zeros_like(position)
        force[..., 2] = self.slope * position[..., 0] + self.constant
        return force


def alone(model: Any = None, **bounds: Any) -> PlanningProblem:
    """One small drone that is to come back to where it starts."""
    chosen = load("none") if model is None else model
    return PlanningProblem(START, START, parse_team("S"), chosen, PlanningBounds(**bounds), dt=DT)


def there_and_back(axis: int = 0, sign: float = 1.0, gain: float = 1.0) -> Trajectories:
    """Out by 0.5 m and back at +-2 m/s^2, over four steps: exact states, controls times `gain`."""
    states = np.zeros((5, 1, 6))
    states[:, :, :3] = START
    states[:, 0, axis] += sign * np.array([0.0, 0.25, 0.5, 0.25, 0.0])
    states[:, 0, 3 + axis] = sign * np.array([0.0, 1.0, 0.0, -1.0, 0.0])
    controls = np.zeros((4, 1, 3))
    controls[:, 0, axis] = sign * gain * np.array([2.0, -2.0, -2.0, 2.0])
    return Trajectories(states, controls, np.zeros((5, 1, 3)), DT)


def test_a_good_plan_has_no_shortcoming() -> None:
    check = check_plan(alone(), there_and_back())
    assert check.shortcomings() == ()
    assert (check.goal_error_m, check.goal_speed, check.force_ratio) == (0.0, 0.0, 0.0)
    assert check.box_excess == check.defect == 0.0
    assert check.clearance_ratio == check.distance_ratio == np.inf
    whole = there_and_back()
    out = Trajectories(whole.states[:3], whole.controls[:2], np.zeros((3, 1, 3)), DT)
    np.testing.assert_array_equal(roll_out(alone(), out), out.states)


def test_controls_too_weak_end_elsewhere() -> None:
    motions = there_and_back(gain=0.9)
    assert check_plan(alone(), motions).defect == pytest.approx(0.1)  # 0.9 m/s for 1 m/s
    stopped = replace(motions, controls=np.where(np.arange(4)[:, None, None] < 3, 1, 0) * 1.0)
    check = check_plan(alone(), stopped)  # 1 m/s^2 along x, y and z for three steps, then none
    assert check.goal_speed == pytest.approx(1.5 * np.sqrt(3))
    assert check.goal_error_m == pytest.approx(np.sqrt(3) * (0.5 * 1.5**2 + 1.5 * 0.5))


def test_a_force_accelerates_by_its_share_of_the_mass() -> None:
    push = Lift(constant=-0.02)
    motions = replace(there_and_back(), controls=np.zeros((4, 1, 3)))
    flown = roll_out(alone(push), motions)
    t = DT * np.arange(5)
    np.testing.assert_allclose(flown[:, 0, 2], 1.0 - 0.02 / SMALL.mass * t**2 / 2, rtol=1e-12)
    np.testing.assert_allclose(flown[:, 0, 5], -0.02 / SMALL.mass * t, rtol=1e-12)
    np.testing.assert_array_equal(flown[:, 0, [0, 1, 3, 4]], 0.0)


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_each_bound_is_measured_along_each_axis(axis: int, sign: float) -> None:
    motions = there_and_back(axis, sign)
    side = START[0, axis] + sign * 0.4
    corner = [[-1.0, -1.0, 0.2], [1.0, 1.0, 2.0]]
    corner[sign > 0][axis] = side
    lower, upper = tuple(corner[0]), tuple(corner[1])
    assert check_plan(alone(lower=lower, upper=upper), motions).box_excess == pytest.approx(0.1)
    assert check_plan(alone(speed=0.8), motions).box_excess == pytest.approx(0.2)
    assert check_plan(alone(acceleration=1.7), motions).box_excess == pytest.approx(0.3)


@pytest.mark.parametrize("slope", [0.05, -0.05])
def test_the_worst_force_may_lie_between_knots(slope: float) -> None:
    """From 1 m/s to -1 m/s within a step: the vertex is 0.125 m further than the knots."""
    states = np.zeros((3, 1, 6))
    states[:, :, :3] = START
    states[:, 0, 0] = [0.0, 0.6, 0.6]
    states[:, 0, 3] = [0.0, 1.0, -1.0]
    motions = Trajectories(states, np.zeros((2, 1, 3)), np.zeros((3, 1, 3)), DT)
    check = check_plan(alone(Lift(slope), force_g={"S": 2.0}), motions)
    worst = 0.05 * 0.725
    assert check.worst_force_g == {"S": pytest.approx(worst / GRAM_FORCE)}
    assert check.force_ratio == pytest.approx(worst / (2.0 * GRAM_FORCE))


def test_forces_are_told_apart_by_vehicle_and_judged_by_its_bound() -> None:
    starts = np.array([[-0.5, 0.0, 1.0], [0.3, 0.0, 1.0], [0.9, 0.0, 1.0]])
    still = np.zeros((2, 3, 6))
    still[..., :3] = starts
    model: Any = Lift(-0.04)
    problem = PlanningProblem(starts, starts, parse_team("SLS"), model, dt=DT)
    motions = Trajectories(still, np.zeros((1, 3, 3)), np.zeros((2, 3, 3)), DT)
    check = check_plan(problem, motions)
    grams = 0.04 / GRAM_FORCE
    assert check.worst_force_g == pytest.approx({"S": 0.9 * grams, "L": 0.3 * grams})
    assert check.force_ratio == pytest.approx(0.9 * grams / 5.0)
    assert check.clearance_ratio == pytest.approx(0.6 / (1.1 * (SMALL.radius + LARGE.radius)))
    assert check.distance_ratio == pytest.approx(0.6 / (SMALL.radius + LARGE.radius))


def test_drones_that_pass_between_knots_are_seen() -> None:
    starts = np.array([[-0.5, 0.0, 1.0], [0.5, 0.1, 1.0]])
    goals = starts * [[-1.0, 1.0, 1.0]]
    problem = PlanningProblem(starts, goals, parse_team("SS"), load("none"), dt=DT)
    states = np.zeros((2, 2, 6))
    states[0, :, :3], states[1, :, :3] = starts, goals
    states[:, 0, 3], states[:, 1, 3] = 2.0, -2.0
    motions = Trajectories(states, np.zeros((1, 2, 3)), np.zeros((2, 2, 3)), DT)
    assert check_plan(problem, motions).distance_ratio == pytest.approx(0.1 / (2 * SMALL.radius))


AT_THE_LIMIT = PlanCheck(
    goal_error_m=0.01,
    goal_speed=0.02,
    worst_force_g={},
    force_ratio=1.05,
    clearance_ratio=0.98,
    distance_ratio=1.0,
    box_excess=0.01,
    defect=1e-6,
)


@pytest.mark.parametrize(
    ("name", "factor", "words"),
    [
        ("goal_error_m", 1.01, "a goal is missed by 0.0101 m"),
        ("goal_speed", 1.01, "a robot still flies 0.0202 m/s"),
        ("force_ratio", 1.01, "a force is 1.06 times its bound"),
        ("clearance_ratio", 0.99, "a pair comes to 0.97 of its clearance"),
        ("box_excess", 1.01, "exceeded by 0.0101"),
        ("defect", 1.01, "flown forward it differs by 1.01e-06"),
    ],
)
def test_one_shortcoming_is_named_alone(name: str, factor: float, words: str) -> None:
    assert AT_THE_LIMIT.shortcomings() == ()
    worse = replace(AT_THE_LIMIT, **{name: factor * getattr(AT_THE_LIMIT, name)})
    (found,) = worse.shortcomings()
    assert words in found
