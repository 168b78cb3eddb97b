"""The convex subproblem of one robot, eq. (17), as arrays: forces and distances linearised.

Everything is taken around the prior motions of all robots. What differs from the printed program,
and why:

- the force enters the acceleration divided by the mass, and follows the state through its
  derivative instead of being a state of its own: f_k = fbar_k + A_k (x_k - xbar_k);
- a held acceleration moves a robot by p' = p + dt (v + v') / 2, which (14) rounds to p + dt v;
- the half-space of a pair points from the neighbour to the robot, and is taken at the closest
  approach of each step, not only at knots, so that nobody passes through anybody between knots;
- forces are bounded half way between knots too, since they peak there as often as not; the
  neighbour's force is bounded absolutely as well, as (6) demands;
- the effort of the neighbours, part of the sum of (6), is linearised: a robot that pushes another
  down makes that one pay. `effort_by_state` is its slope.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from swarm_envs.baselines.neural_swarm.planner.force_jacobian import force_jacobian
from swarm_envs.baselines.neural_swarm.planner.problem import PlanningProblem
from swarm_envs.baselines.neural_swarm.planner.trajectories import (
    BOUNDED_FRACTIONS,
    Trajectories,
    closest_approach,
    position_within,
    states_within,
    vertical_forces,
)
from swarm_envs.state import FloatArray
from swarm_envs.vehicles import GRAM_FORCE

_TINY = 1e-9  # m; shorter offsets have no direction


@dataclass(frozen=True, eq=False)
class ConvexSubproblem:
    """One robot's problem around a prior: T steps, D axes of motion, M neighbours. SI units."""

    dt: float
    """Time between knots, s."""
    mass: float
    """Mass of the robot, kg."""
    prior: FloatArray
    """(T + 1, 2 D) prior states xbar: positions, velocities."""
    prior_control: FloatArray
    """(T, D) prior controls ubar, m/s^2."""
    goal: FloatArray
    """(2 D) state to end in."""
    lower: FloatArray
    """(2 D) lower end of the states allowed."""
    upper: FloatArray
    """(2 D) upper end of the states allowed."""
    control_bound: float
    """Largest |u| along each axis, m/s^2."""
    force: FloatArray
    """(T, D) force on the robot at the knot that begins each step, N."""
    force_by_state: FloatArray
    """(T, D, 2 D) A_k: its derivative by the state there."""
    effort_by_state: FloatArray
    """(T, 2 D) derivative of the neighbours' effort, the sum of ||u||^2, by the robot's state."""
    shares: FloatArray
    """(S,) moments of each step at which forces are bounded, in parts of it."""
    bounded: FloatArray
    """(S, T, 2 D) prior states of the robot at these moments."""
    bounded_force: FloatArray
    """(S, T) vertical force on the robot then, N."""
    bounded_by_state: FloatArray
    """(S, T, 2 D) its derivative by the robot's state then."""
    force_bound: float
    """f_a,max: largest vertical force on the robot, N."""
    neighbor_force: FloatArray
    """(S, T, M) vertical forces on the neighbours then, N."""
    neighbor_by_state: FloatArray
    """(S, T, M, 2 D) C_k: their derivatives by the robot's state then."""
    neighbor_bound: FloatArray
    """(M) f_a,max of each neighbour, N."""
    force_change: float
    """b_fa: largest change of a neighbour's force, N."""
    normal: FloatArray
    """(T, M, D) unit vectors from neighbour to robot at the closest approach of each step."""
    fraction: FloatArray
    """(T, M) share of the step at which it occurs."""
    level: FloatArray
    """(T, M) least value of <normal, p(fraction)>, m."""
    trust_state: FloatArray
    """(2 D) b_x: largest |x - xbar|."""
    trust_control: float
    """b_u: largest |u - ubar|, m/s^2."""


def convexify(
    problem: PlanningProblem,
    prior: Trajectories,
    robot: int,
    trust_state: tuple[float, float],
    trust_control: float,
    force_bounds: FloatArray,
) -> ConvexSubproblem:
    """Linearise one robot's problem around the prior motions of all, which fit their forces.

    `trust_state` is the largest change of a position, m, and of a velocity, m/s, `trust_control`
    that of a control, m/s^2, `force_bounds` (N,) the largest vertical force on each robot, N.
    """
    axes, bounds, steps = list(problem.axes), problem.bounds, prior.steps
    columns, dims = axes + [3 + axis for axis in axes], len(axes)
    others = [j for j in range(len(problem.team)) if j != robot]
    within = states_within(prior, BOUNDED_FRACTIONS)
    felt = vertical_forces(problem, within)
    states = np.concatenate([prior.states[:-1], within.reshape(-1, *within.shape[2:])])
    jacobian = force_jacobian(problem.model, problem.team, states, robot)[..., columns]
    by_state = jacobian[steps:, :, 2].reshape(*felt.shape, 2 * dims)
    share = -2.0 / problem.masses[others] * prior.controls[:, others, 2]
    normal, fraction, level = _half_spaces(problem, prior, robot, others)
    speed = np.full(dims, bounds.speed)
    return ConvexSubproblem(
        dt=prior.dt,
        mass=float(problem.masses[robot]),
        prior=prior.states[:, robot][:, columns],
        prior_control=prior.controls[:, robot][:, axes],
        goal=np.concatenate([problem.goals[robot][axes], np.zeros(dims)]),
        lower=np.concatenate([np.array(bounds.lower)[axes], -speed]),
        upper=np.concatenate([np.array(bounds.upper)[axes], speed]),
        control_bound=bounds.acceleration,
        force=prior.forces[:-1, robot][:, axes],
        force_by_state=jacobian[:steps, robot][:, axes],
        effort_by_state=np.einsum("km,kmb->kb", share, jacobian[:steps, others, 2]),
        shares=BOUNDED_FRACTIONS,
        bounded=within[:, :, robot][..., columns],
        bounded_force=felt[:, :, robot],
        bounded_by_state=by_state[:, :, robot],
        force_bound=float(force_bounds[robot]),
        neighbor_force=felt[:, :, others],
        neighbor_by_state=by_state[:, :, others],
        neighbor_bound=force_bounds[others],
        force_change=bounds.force_change_g * GRAM_FORCE,
        normal=normal,
        fraction=fraction,
        level=level,
        trust_state=np.repeat(trust_state, dims),
        trust_control=trust_control,
    )


def _half_spaces(
    problem: PlanningProblem, prior: Trajectories, robot: int, others: list[int]
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Normals (T, M, D), fractions (T, M) and levels (T, M) that keep a robot from the others."""
    axes = list(problem.axes)
    offset = prior.states[:, [robot]] - prior.states[:, others]
    near = closest_approach(offset, prior.dt)
    direction = near.offset[..., axes]
    length = np.linalg.norm(direction, axis=-1, keepdims=True)
    upward = np.eye(len(axes))[-1]
    normal = np.where(length > _TINY, direction / np.maximum(length, _TINY), upward)
    there = position_within(prior.states[:, others], near.fraction, prior.dt)
    apart = problem.bounds.clearances(problem.team)[robot, others]
    return normal, near.fraction, apart + (normal * there[..., axes]).sum(axis=-1)
