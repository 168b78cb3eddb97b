"""Trajectories of a team on a common time grid, and the one rule by which states follow controls.

Between knots the acceleration a = u + f_a / m is held, u the control and f_a the force at the knot
before (eq. 13 and 14). A held acceleration moves a point exactly by

    p' = p + v dt + a dt^2 / 2,    v' = v + a dt,

which (14) rounds to p' = p + v dt: the paths here are those that a double integrator flies.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from swarm_envs.arguments import typed
from swarm_envs.baselines.neural_swarm.planner.problem import PlanningProblem
from swarm_envs.interactions import InteractionModel
from swarm_envs.state import FloatArray
from swarm_envs.vehicles import Team


@typed
@dataclass(frozen=True, eq=False)
class Trajectories:
    """Motions of N robots over T steps. World frame, SI units."""

    states: FloatArray
    """(T + 1, N, 6) position p (m) and velocity v (m/s) at the knots."""
    controls: FloatArray
    """(T, N, 3) control u held from knot to knot, m/s^2."""
    forces: FloatArray
    """(T + 1, N, 3) force f_a that the model predicts at the knots, all robots flying, N."""
    dt: float
    """Time between knots, s."""

    @property
    def position(self) -> FloatArray:
        """(T + 1, N, 3) positions, m."""
        return self.states[..., :3]

    @property
    def velocity(self) -> FloatArray:
        """(T + 1, N, 3) velocities, m/s."""
        return self.states[..., 3:]

    @property
    def steps(self) -> int:
        """Number of steps T."""
        return len(self.controls)

    @property
    def duration(self) -> float:
        """Time from the first knot to the last, t_f, s."""
        return self.steps * self.dt

    @property
    def times(self) -> FloatArray:
        """(T + 1,) times of the knots, s."""
        return np.arange(self.steps + 1, dtype=np.float64) * self.dt

    @property
    def cost(self) -> float:
        """The objective of eq. (6), sum over robots and knots of ||u|| dt, m/s."""
        return float(np.linalg.norm(self.controls, axis=2).sum() * self.dt)

    @property
    def energy(self) -> float:
        """The objective of eq. (17), sum over robots and knots of ||u||^2, m^2/s^4."""
        return float((self.controls**2).sum())


def transition(dt: float) -> tuple[FloatArray, FloatArray]:
    """Matrices (6, 6) and (6, 3) by which the next state follows: x' = A x + B a.

    Args:
        dt: length of the step, s.

    Returns:
        A and B, a being the whole acceleration u + f_a / m held over the step.
    """
    identity = np.eye(3)
    a = np.block([[identity, dt * identity], [np.zeros((3, 3)), identity]])
    return a, np.vstack([0.5 * dt * dt * identity, dt * identity])


def predict_forces(model: InteractionModel, team: Team, states: FloatArray) -> FloatArray:
    """Forces f_a (K, N, 3) on every robot at K knots with states (K, N, 6), N."""
    return model.forces(states[..., :3], states[..., 3:], team)


def trajectories_through(problem: PlanningProblem, states: FloatArray) -> Trajectories:
    """The trajectories that pass through states (T + 1, N, 6), whatever the forces are.

    Each control is the one that gives the step's change of velocity against the force that the
    model predicts with all robots flying; positions must fit the velocities.
    """
    forces = predict_forces(problem.model, problem.team, states)
    acceleration = np.diff(states[..., 3:], axis=0) / problem.dt
    controls = acceleration - forces[:-1] / problem.masses[:, None]
    return Trajectories(states, controls, forces, problem.dt)


def defects(problem: PlanningProblem, trajectories: Trajectories) -> FloatArray:
    """By how much each step (T, N, 6) misses what its control and force lead to, m and m/s."""
    states = trajectories.states
    acceleration = trajectories.controls + trajectories.forces[:-1] / problem.masses[:, None]
    a, b = transition(trajectories.dt)
    return states[1:] - states[:-1] @ a.T - acceleration @ b.T
