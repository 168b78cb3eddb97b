"""Verification of a plan, whose controls are simulated with the nonlinear model."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from swarm_envs.baselines.neural_swarm.planner import trajectories as paths
from swarm_envs.baselines.neural_swarm.planner.problem import PlanningProblem
from swarm_envs.state import FloatArray
from swarm_envs.vehicles import GRAM_FORCE


@dataclass(frozen=True)
class PlanCheck:
    """The result of simulating a plan's controls with the planner's model of the forces."""

    goal_error_m: float  # Largest distance of a robot from its goal at the end, m
    goal_speed: float  # Largest speed of a robot at the end, m/s
    worst_force_g: dict[str, float]
    """Largest vertical force |f_a,z| by vehicle token, at knots and between, grams."""
    force_ratio: float  # Largest vertical force over its bound
    clearance_ratio: float
    """Smallest distance of a pair over its required clearance; should be 1 or more."""
    distance_ratio: float
    """Smallest distance of a pair over the sum of the radii; below 1 they collide."""
    box_excess: float  # Largest excess over the box, m, the speed, m/s, or the control bound, m/s^2
    defect: float  # Largest difference between the plan and its simulation, m and m/s

    def shortcomings(self) -> tuple[str, ...]:
        """Return the requirements that the plan does not meet, as phrases."""
        kept = {
            f"a goal is missed by {self.goal_error_m:.3g} m": self.goal_error_m <= 0.01,
            f"a robot still flies {self.goal_speed:.3g} m/s": self.goal_speed <= 0.02,
            f"a force is {self.force_ratio:.3g} times its bound": self.force_ratio <= 1.05,
            f"a pair comes to {self.clearance_ratio:.3g} of its clearance": (
                self.clearance_ratio >= 0.98
            ),
            f"box, speed or control are exceeded by {self.box_excess:.3g}": self.box_excess <= 0.01,
            f"flown forward it differs by {self.defect:.3g}": self.defect <= 1e-6,
        }
        return tuple(words for words, good in kept.items() if not good)


def roll_out(problem: PlanningProblem, motions: paths.Trajectories) -> FloatArray:
    """Return states (T + 1, N, 6) under the controls from the starts, by A x + B (u + f_a / m)."""
    dt, identity = motions.dt, np.eye(3)
    a = np.block([[identity, dt * identity], [np.zeros((3, 3)), identity]])
    b = np.vstack([0.5 * dt * dt * identity, dt * identity])
    states = np.empty_like(motions.states)
    states[0] = motions.states[0]
    for k, control in enumerate(motions.controls):
        (force,) = paths.predict_forces(problem.model, problem.team, states[k, None])
        acceleration = control + force / problem.masses[:, None]
        states[k + 1] = states[k] @ a.T + acceleration @ b.T
    return states


def check_plan(problem: PlanningProblem, motions: paths.Trajectories) -> PlanCheck:
    """Simulate a plan's controls with the nonlinear model, and evaluate all requirements."""
    flown = roll_out(problem, motions)
    within = paths.states_within(motions, paths.CHECKED_FRACTIONS)
    force = np.abs(paths.vertical_forces(problem, within)).max(axis=(0, 1))
    ratio = force / problem.bounds.force_bounds(problem.team)
    tokens = [vehicle.token for vehicle in problem.team]
    worst = {
        token: max(float(f) for f, t in zip(force, tokens) if t == token) / GRAM_FORCE
        for token in dict.fromkeys(tokens)
    }
    bounds, distance = problem.bounds, paths.pairwise_approach(motions).distance.min(axis=0)
    keep, pairs = bounds.clearances(problem.team), ~np.eye(len(problem.team), dtype=np.bool_)
    clearance = float((distance[pairs] / keep[pairs]).min(initial=np.inf))  # Infinite if alone
    excesses = (
        motions.position - np.array(bounds.upper),
        np.array(bounds.lower) - motions.position,
        np.abs(motions.velocity) - bounds.speed,
        np.abs(motions.controls) - bounds.acceleration,
    )
    return PlanCheck(
        goal_error_m=float(np.linalg.norm(flown[-1, :, :3] - problem.goals, axis=1).max()),
        goal_speed=float(np.linalg.norm(flown[-1, :, 3:], axis=1).max()),
        worst_force_g=worst,
        force_ratio=float(ratio.max()),
        clearance_ratio=clearance,
        distance_ratio=clearance * problem.bounds.clearance_factor,
        box_excess=max(0.0, *(float(excess.max()) for excess in excesses)),
        defect=float(np.abs(flown - motions.states).max()),
    )
