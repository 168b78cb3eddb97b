"""`plan_swarm` and the plan that it returns: in files, over time, and refused."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest

from swarm_envs.baselines.neural_swarm import SwarmPlan, plan_swarm
from swarm_envs.baselines.neural_swarm.planner import PlanningProblem, Trajectories
from swarm_envs.baselines.neural_swarm.planner.trajectories import straight_lines
from swarm_envs.interactions import load
from swarm_envs.vehicles import parse_team

PAIR = np.array([[0.0, -0.6, 1.0], [0.0, 0.6, 1.0]])


def pair_guess() -> Trajectories:
    problem = PlanningProblem(PAIR, PAIR[::-1], parse_team("SL"), max_duration=3.0)
    return straight_lines(problem, bend=[[0.0, 0.0, 0.2], [0.0, 0.0, -0.2]])


def make(**options: object) -> SwarmPlan:
    given = {"plane": "yz", "max_duration": 3.0, "initial": pair_guess()} | options
    return plan_swarm(PAIR, PAIR[::-1], "SL", "learned", **given)  # type: ignore[arg-type]


@pytest.fixture(scope="module")
def plan() -> SwarmPlan:
    return make()


def test_a_swap_is_planned(plan: SwarmPlan) -> None:
    assert plan.converged
    assert plan.status == "converged"
    flown = plan.trajectories
    assert flown.states.shape == (31, 2, 6)
    assert flown.controls.shape == (30, 2, 3)
    np.testing.assert_allclose(flown.position[-1], PAIR[::-1], atol=1e-4)
    assert plan.check.force_ratio <= 1.05
    assert plan.check.distance_ratio >= 1.0
    assert plan.trajectories.energy < plan.initial.energy
    assert plan.model_fingerprint == load("learned").fingerprint


def test_without_a_model_the_planner_is_the_same_but_unaware() -> None:
    lost = plan_swarm(PAIR, PAIR[::-1], "SL", None, plane="yz", max_duration=3.0, seed=3)
    named = plan_swarm(PAIR, PAIR[::-1], "SL", "none", plane="yz", max_duration=3.0, seed=3)
    assert lost.model_name == "none"
    assert np.abs(lost.trajectories.forces).max() == 0.0
    assert lost.initial.states.tobytes() == named.initial.states.tobytes()
    assert lost.trajectories.states.tobytes() == named.trajectories.states.tobytes()


def test_files_give_back_what_was_saved(plan: SwarmPlan, tmp_path) -> None:
    plan.save(tmp_path / "plan.npz")
    read = SwarmPlan.load(tmp_path / "plan.npz")
    for owner in ("trajectories", "initial"):
        for part in ("states", "controls", "forces"):
            mine, theirs = (getattr(getattr(p, owner), part) for p in (plan, read))
            assert mine.tobytes() == theirs.tobytes()
    kept = ("team", "bounds", "check", "history", "status", "reason", "seed", "costs", "plane")
    for name in (*kept, "model_name", "model_fingerprint"):
        assert getattr(read, name) == getattr(plan, name)


def with_dt(about: Any, dt: float) -> Any:
    return np.array(json.dumps(json.loads(str(about)) | {"dt": dt}))


@pytest.mark.parametrize(
    ("damage", "said"),
    [
        (lambda c: c.update(trajectories_controls=c["initial_controls"][1:]), "states has shape"),
        (lambda c: c.pop("initial_forces"), "initial_forces"),
        (lambda c: c.update(about=np.array('{"version": 99}')), "version 99"),
        (lambda c: c.update(about=with_dt(c["about"], 0.0)), "dt is 0.0, but must be"),
    ],
)
def test_a_damaged_file_is_refused_by_name(plan: SwarmPlan, tmp_path, damage, said: str) -> None:
    path = tmp_path / "plan.npz"
    plan.save(path)
    with np.load(path) as file:
        content = dict(file)
    damage(content)
    np.savez(path, **content)
    with pytest.raises(ValueError, match=said) as error:
        SwarmPlan.load(path)
    assert "plan.npz" in str(error.value)


def test_other_files_are_refused(plan: SwarmPlan, tmp_path) -> None:
    path = tmp_path / "plan.npz"
    with pytest.raises(FileNotFoundError):
        SwarmPlan.load(path)
    plan.save(path)
    whole = path.read_bytes()
    for length in (0, 3000):
        path.write_bytes(whole[:length])
        with pytest.raises(ValueError, match=r"plan\.\w+' is no plan, or damaged"):
            SwarmPlan.load(path)
    with pytest.raises(ValueError, match=r"suffix '\.pkl'"):
        plan.save(tmp_path / "plan.pkl")


def test_a_lone_robots_plan_survives_a_file(tmp_path) -> None:
    lone = plan_swarm(PAIR[:1], PAIR[1:], "S", "none", plane="yz", max_duration=3.0)
    lone.save(tmp_path / "plan.npz")
    read = SwarmPlan.load(tmp_path / "plan.npz")
    assert read.check == lone.check
    assert read.check.clearance_ratio == np.inf


def test_the_reference_meets_the_knots_and_is_its_own_derivative(plan: SwarmPlan) -> None:
    knots = plan.trajectories
    for k in (0, 7, 30):
        met = plan.reference(knots.times[k])
        np.testing.assert_allclose(met.position, knots.position[k], atol=1e-12)
        np.testing.assert_allclose(met.velocity, knots.velocity[k], atol=1e-4)
    h = 1e-6
    for time in (0.123, 1.55, 2.99):
        parts = [plan.reference(time + s * h) for s in (-1, 0, 1)]
        for order in range(3):
            slope = (parts[2][order] - parts[0][order]) / (2 * h)
            np.testing.assert_allclose(parts[1][order + 1], slope, atol=1e-4)
    at_knot = [plan.reference(knots.times[9] + s * 1e-9).acceleration for s in (-1, 1)]
    np.testing.assert_allclose(at_knot[0], at_knot[1], atol=1e-6)
    for time in (-1.0, 3.0, 10.0):
        rest = plan.reference(time)
        assert all((part == 0.0).all() for part in rest[1:])
    np.testing.assert_allclose(plan.reference(10.0).position, PAIR[::-1], atol=1e-4)


def test_out_of_time_is_the_best_so_far_and_says_so() -> None:
    plan = make(time_limit=1e-6)
    assert plan.status == "time limit" and "time limit" in plan.reason
    assert not plan.converged


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"time_limit": 0.0}, "time_limit is 0"),
        ({"dt": 0.05}, "initial.dt is 0.1 s, but dt is 0.05"),
        ({"max_duration": 2.0}, "initial has 30 steps"),
    ],
)
def test_bad_input_is_refused_before_planning(change: dict[str, object], said: str) -> None:
    with pytest.raises(ValueError, match=said):
        make(**change)


def test_a_guess_from_elsewhere_is_refused() -> None:
    guess = pair_guess()
    away = Trajectories(guess.states + 0.1, guess.controls, guess.forces, guess.dt)
    with pytest.raises(ValueError, match="away from rest at the starts"):
        make(initial=away)
    with pytest.raises(ValueError, match="unknown interaction model"):
        plan_swarm(PAIR, PAIR[::-1], "SL", "learnt")
