"""Trajectories of a team on a common time grid, and the one rule by which states follow controls.

Between knots the acceleration a = u + f_a / m is held, u the control and f_a the force at the knot
before (eq. 13 and 14). A held acceleration moves a point exactly by

    p' = p + v dt + a dt^2 / 2,    v' = v + a dt,

which (14) rounds to p' = p + v dt: the paths here are those that a double integrator flies.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

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


_PIECES = 4
"""Straight pieces for a step's parabola: a quarter of 0.1 s at 5 m/s^2 bends by 0.4 mm."""


class Approach(NamedTuple):
    """The closest approach of pairs within each of T steps."""

    distance: FloatArray
    """(T, ...) smallest distance within the step, m."""
    offset: FloatArray
    """(T, ..., 3) offset there, m."""
    fraction: FloatArray
    """(T, ...) share of the step at which it occurs, in [0, 1]."""


def step_weights(fraction: FloatArray, dt: float) -> tuple[FloatArray, FloatArray]:
    """Weights of the velocities at a step's two ends in the position within it.

    With the acceleration held, p(tau) = p + a v + b v', where v and v' are the velocities at the
    ends, and a and b what is returned, s.

    Args:
        fraction: (...) share tau of the step, in [0, 1].
        dt: length of the step, s.
    """
    half = 0.5 * fraction**2
    return dt * (fraction - half), dt * half


def position_within(states: FloatArray, fraction: FloatArray, dt: float) -> FloatArray:
    """Positions (..., T, ..., 3) within each of T steps, m.

    Args:
        states: (T + 1, ..., 6) states at the knots.
        fraction: share of each step, that broadcasts against (T, ...).
        dt: time between knots, s.
    """
    first, second = step_weights(fraction[..., None], dt)
    start, end = states[:-1], states[1:]
    return np.asarray(start[..., :3] + first * start[..., 3:] + second * end[..., 3:])


def state_within(states: FloatArray, fraction: FloatArray, dt: float) -> FloatArray:
    """States (..., T, ..., 6) within each of T steps: as `position_within`, with velocities."""
    start, change = states[:-1, ..., 3:], np.diff(states[..., 3:], axis=0)
    position = position_within(states, fraction, dt)
    velocity = np.broadcast_to(start + fraction[..., None] * change, position.shape)
    return np.concatenate([position, velocity], axis=-1)


def closest_approach(states: FloatArray, dt: float) -> Approach:
    """The closest approach to the origin in every step of relative motions.

    Args:
        states: (T + 1, ..., 6) relative positions (m) and velocities (m/s) at the knots.
        dt: time between knots, s.
    """
    corner = np.linspace(0.0, 1.0, _PIECES + 1).reshape(-1, *(1,) * (states.ndim - 1))
    points = position_within(states, corner, dt)
    way = np.diff(points, axis=0)
    square = (way**2).sum(axis=-1)
    along = -(points[:-1] * way).sum(axis=-1) / np.where(square > 0.0, square, 1.0)
    share = np.clip(along, 0.0, 1.0)
    nearest = points[:-1] + share[..., None] * way
    best = np.linalg.norm(nearest, axis=-1).argmin(axis=0)[None]
    fraction = (best[0] + np.take_along_axis(share, best, axis=0)[0]) / _PIECES
    offset = position_within(states, fraction, dt)
    return Approach(np.linalg.norm(offset, axis=-1), offset, fraction)


BOUNDED = np.array([0.5, 1.0])
"""Moments of each step, in parts of it, at which programs bound forces; the start is at rest."""
CHECKED = np.array([0.25, 0.5, 0.75, 1.0])
"""Moments at which a plan is judged."""


def states_at(motions: Trajectories, shares: FloatArray) -> FloatArray:
    """States (S, T, N, 6) of all robots at S moments of each step, given in parts of it."""
    fraction = np.broadcast_to(shares[:, None, None], (len(shares), motions.steps, 1))
    return state_within(motions.states, fraction, motions.dt)


def forces_at(problem: PlanningProblem, states: FloatArray) -> FloatArray:
    """Vertical forces (S, T, N) on all robots in states (S, T, N, 6), N."""
    flat = states.reshape(-1, *states.shape[2:])
    return predict_forces(problem.model, problem.team, flat)[..., 2].reshape(states.shape[:-1])


def excess_of_forces(
    problem: PlanningProblem,
    motions: Trajectories,
    shares: FloatArray,
    bounds: FloatArray | None = None,
) -> FloatArray:
    """Vertical force over its bound, less 1, at S moments of each step: (S, T, N).

    Args:
        problem: what is planned.
        motions: of all robots.
        shares: (S,) the moments, in parts of a step.
        bounds: (N,) largest vertical force on each, N; None for those of the problem.
    """
    limits = problem.bounds.force_bounds(problem.team) if bounds is None else bounds
    forces = forces_at(problem, states_at(motions, shares))
    return np.asarray(np.abs(forces) / limits - 1.0)
