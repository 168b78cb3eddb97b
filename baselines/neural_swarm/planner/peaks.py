"""Forces within steps: their peaks lie between knots as often as not."""

from __future__ import annotations

import numpy as np

from swarm_envs.baselines.neural_swarm.planner.approach import state_within
from swarm_envs.baselines.neural_swarm.planner.problem import PlanningProblem
from swarm_envs.baselines.neural_swarm.planner.trajectories import Trajectories, predict_forces
from swarm_envs.state import FloatArray

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
