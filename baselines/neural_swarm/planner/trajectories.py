"""Trajectories of a team on a common time grid: dynamics, motion within steps, closest approaches.

Between knots the acceleration a = u + f_a / m is held, where u is the control and f_a the force at
the knot before (eq. 13 and 14). A point with a held acceleration moves exactly by

    p' = p + v dt + a dt^2 / 2,    v' = v + a dt,

which (14) approximates by p' = p + v dt. Here the exact motion is used.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from swarm_envs.baselines.neural_swarm.planner.problem import PlanningProblem
from swarm_envs.errors import check_array, check_number
from swarm_envs.interactions import InteractionModel
from swarm_envs.state import FloatArray
from swarm_envs.trajectories import rest_to_rest
from swarm_envs.vehicles import Team

__all__ = ["Trajectories"]


@dataclass(frozen=True, eq=False)
class Trajectories:
    """The motions of N robots over T steps. World frame, SI units."""

    states: FloatArray
    """The positions p (m) and velocities v (m/s) (T + 1, N, 6) at the knots."""
    controls: FloatArray
    """The controls u (T, N, 3), held from knot to knot, m/s^2."""
    forces: FloatArray
    """The predicted forces f_a (T + 1, N, 3) at the knots, with all robots flying, N."""
    dt: float
    """The time between knots, s."""

    def __post_init__(self) -> None:
        """Raise ValueError for an invalid `dt`."""
        check_number("dt", self.dt)

    @property
    def position(self) -> FloatArray:
        """The positions (T + 1, N, 3), m."""
        return self.states[..., :3]

    @property
    def velocity(self) -> FloatArray:
        """The velocities (T + 1, N, 3), m/s."""
        return self.states[..., 3:]

    @property
    def steps(self) -> int:
        """The number of steps T."""
        return len(self.controls)

    @property
    def duration(self) -> float:
        """The time from the first knot to the last, t_f, s."""
        return self.steps * self.dt

    @property
    def times(self) -> FloatArray:
        """The times (T + 1,) of the knots, s."""
        return np.arange(self.steps + 1, dtype=np.float64) * self.dt

    @property
    def cost(self) -> float:
        """The objective of eq. (6), sum over robots and knots of ||u|| dt, m/s."""
        return float(np.linalg.norm(self.controls, axis=2).sum() * self.dt)

    @property
    def energy(self) -> float:
        """The objective of eq. (17), sum over robots and knots of ||u||^2, m^2/s^4."""
        return float((self.controls**2).sum())


def predict_forces(model: InteractionModel, team: Team, states: FloatArray) -> FloatArray:
    """Return forces f_a (K, N, 3) on every robot at K knots with states (K, N, 6), N."""
    return model.forces(states[..., :3], states[..., 3:], team)


def trajectories_through(problem: PlanningProblem, states: FloatArray) -> Trajectories:
    """Return the trajectories through states (T + 1, N, 6) with consistent velocities.

    Each control produces the step's change of velocity against the model's force.
    """
    forces = predict_forces(problem.model, problem.team, states)
    acceleration = np.diff(states[..., 3:], axis=0) / problem.dt
    controls = acceleration - forces[:-1] / problem.masses[:, None]
    return Trajectories(states, controls, forces, problem.dt)


def integrate_velocity(start: FloatArray, velocity: FloatArray, dt: float) -> FloatArray:
    """Return positions (T + 1, ..., 3) from a start (..., 3), m, by velocities (T + 1, ..., 3)."""
    moved = np.cumsum(0.5 * dt * (velocity[1:] + velocity[:-1]), axis=0)
    return np.asarray(start + np.concatenate([np.zeros_like(moved[:1]), moved]))


def straight_lines(problem: PlanningProblem, bend: npt.ArrayLike | None = None) -> Trajectories:
    """Return simultaneous straight motions from starts to goals, bent by `bend` (N, 3), m."""
    count = problem.steps
    aside = np.zeros((len(problem.team), 3)) if bend is None else bend
    swerve = 4.0 * check_array("bend", aside, problem.starts.shape, "(N, 3), m")
    time = np.arange(count + 1) * problem.dt
    progress = rest_to_rest(np.zeros(3), np.ones(3), count * problem.dt, time)
    share, rate = progress.position[:, None], progress.velocity[:, None]
    change = problem.goals - problem.starts
    velocity = rate * (change + swerve * (1.0 - 2.0 * share))
    position = integrate_velocity(problem.starts, velocity, problem.dt)
    return trajectories_through(problem, np.concatenate([position, velocity], axis=-1))


# ---- Within steps, where distances are often least and forces largest

BOUNDED_FRACTIONS = np.array([0.5, 1.0])
"""Fractions of each step at which programs bound forces; the start of a motion is at rest."""
CHECKED_FRACTIONS = np.array([0.25, 0.5, 0.75, 1.0])
"""Fractions of each step at which a plan is checked."""
_CHORDS = 4  # Chords of a step's parabola, off by 0.4 mm for steps of 0.1 s at 5 m/s^2


class ClosestApproach(NamedTuple):
    """The closest approach of pairs within each of T steps, which eq. (17) keeps above r."""

    distance: FloatArray  # (T, ...) smallest distance within the step, m
    offset: FloatArray  # (T, ..., 3) offset there, m
    fraction: FloatArray  # (T, ...) fraction of the step at which it occurs, in [0, 1]


def step_weights(fraction: FloatArray, dt: float) -> tuple[FloatArray, FloatArray]:
    """Return weights a and b, s, of a step's first and last velocity in the position within it.

    With a held acceleration, p(tau) = p + a v + b v' at a fraction tau in [0, 1] of the step, where
    v and v' are the velocities at its ends.
    """
    half = 0.5 * fraction**2
    return dt * (fraction - half), dt * half


def position_within(states: FloatArray, fraction: FloatArray, dt: float) -> FloatArray:
    """Return positions, m, at fractions (T, ...) of the steps between states (T + 1, ..., 6)."""
    first, second = step_weights(fraction[..., None], dt)
    start, end = states[:-1], states[1:]
    return np.asarray(start[..., :3] + first * start[..., 3:] + second * end[..., 3:])


def states_within(motions: Trajectories, fractions: FloatArray) -> FloatArray:
    """Return states (S, T, N, 6) of all robots at S fractions of each step."""
    fraction = np.broadcast_to(fractions[:, None, None], (len(fractions), motions.steps, 1))
    position = position_within(motions.states, fraction, motions.dt)
    start, change = motions.velocity[:-1], np.diff(motions.velocity, axis=0)
    velocity = np.broadcast_to(start + fraction[..., None] * change, position.shape)
    return np.concatenate([position, velocity], axis=-1)


def vertical_forces(problem: PlanningProblem, states: FloatArray) -> FloatArray:
    """Return vertical forces (S, T, N) on all robots in states (S, T, N, 6), N."""
    flat = states.reshape(-1, *states.shape[2:])
    return predict_forces(problem.model, problem.team, flat)[..., 2].reshape(states.shape[:-1])


def closest_approach(states: FloatArray, dt: float) -> ClosestApproach:
    """Return each step's closest approach to the origin, of relative motions (T + 1, ..., 6)."""
    corner = np.linspace(0.0, 1.0, _CHORDS + 1).reshape(-1, *(1,) * (states.ndim - 1))
    points = position_within(states, corner, dt)
    chord = np.diff(points, axis=0)
    square = (chord**2).sum(axis=-1)
    along = -(points[:-1] * chord).sum(axis=-1) / np.where(square > 0.0, square, 1.0)
    share = np.clip(along, 0.0, 1.0)
    nearest = points[:-1] + share[..., None] * chord
    best = np.linalg.norm(nearest, axis=-1).argmin(axis=0)[None]
    fraction = (best[0] + np.take_along_axis(share, best, axis=0)[0]) / _CHORDS
    offset = position_within(states, fraction, dt)
    return ClosestApproach(np.linalg.norm(offset, axis=-1), offset, fraction)


def pairwise_approach(motions: Trajectories) -> ClosestApproach:
    """Return the closest approach (T, N, N) of every pair within each step."""
    return closest_approach(motions.states[:, :, None] - motions.states[:, None], motions.dt)
