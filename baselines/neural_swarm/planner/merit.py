"""What a plan is worth, measured on the nonlinear model: the merit by which steps are accepted."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from swarm_envs.baselines.neural_swarm.planner.approach import closest_approach
from swarm_envs.baselines.neural_swarm.planner.peaks import BOUNDED, excess_of_forces
from swarm_envs.baselines.neural_swarm.planner.problem import PlanningProblem
from swarm_envs.baselines.neural_swarm.planner.solution import Weights
from swarm_envs.baselines.neural_swarm.planner.trajectories import Trajectories
from swarm_envs.state import FloatArray


@dataclass(frozen=True, eq=False)
class Shortfalls:
    """The effort of a team, and by how much its motions miss goals and bounds."""

    effort: FloatArray
    """(N,) sum of ||u||^2, m^2/s^4."""
    goal: FloatArray
    """(N,) largest component by which the goal state is missed, m or m/s."""
    state: FloatArray
    """(N,) largest excess over the box, m or m/s, or over the own force bound, 1."""
    apart: FloatArray
    """(N, N) clearance that each pair lacks, summed over steps, m."""
    force: FloatArray
    """(N,) excess of each step's peak over the force bound, in its units, summed over steps."""
    control: FloatArray
    """(N,) excess over the control bound, summed over knots and axes, m/s^2."""

    def team(self, weights: Weights) -> float:
        """The merit of all: what the whole refinement decreases."""
        pairs = self.apart.sum() / 2.0
        soft = pairs + self.force.sum() + self.control.sum()
        hard = weights.goal * self.goal.sum() + weights.state * self.state.sum()
        return float(self.effort.sum() + hard + weights.neighbor * soft)

    def robot(self, i: int, weights: Weights) -> float:
        """The part of the merit that robot i's program sees."""
        others = self.apart[i].sum() + self.force.sum() - self.force[i]
        hard = weights.goal * self.goal[i] + weights.state * self.state[i]
        return float(self.effort[i] + hard + weights.neighbor * others)


def measure(
    problem: PlanningProblem, motions: Trajectories, force_bounds: FloatArray | None = None
) -> Shortfalls:
    """Measure motions that fit their controls and forces (`trajectories_through`).

    Args:
        problem: what is planned.
        motions: of all robots.
        force_bounds: (N,) largest vertical force on each, N; None for those of the problem.
    """
    bounds, axes = problem.bounds, list(problem.axes)
    position, velocity = motions.position[1:][..., axes], motions.velocity[1:][..., axes]
    controls = motions.controls[..., axes]
    low, high = np.array(bounds.lower)[axes], np.array(bounds.upper)[axes]
    outside = np.maximum(position - high, low - position).max(axis=(0, 2))
    fast = np.abs(velocity).max(axis=(0, 2)) - bounds.speed
    strong = excess_of_forces(problem, motions, BOUNDED, force_bounds).max(axis=0)
    apart = missing_clearance(problem, motions).sum(axis=0)
    end = np.concatenate([position[-1] - problem.goals[:, axes], velocity[-1]], axis=-1)
    return Shortfalls(
        effort=(controls**2).sum(axis=(0, 2)),
        goal=np.abs(end).max(axis=-1),
        state=np.maximum(np.maximum(outside, fast), strong.max(axis=0)).clip(min=0.0),
        apart=apart,
        force=strong.clip(min=0.0).sum(axis=0),
        control=(np.abs(controls) - bounds.acceleration).clip(min=0.0).sum(axis=(0, 2)),
    )


def missing_clearance(problem: PlanningProblem, motions: Trajectories) -> FloatArray:
    """Clearance (T, N, N) that each pair lacks at its closest approach in each step, m."""
    offset = motions.states[:, :, None] - motions.states[:, None]
    distance = closest_approach(offset, motions.dt).distance
    return np.asarray((problem.bounds.clearances(problem.team) - distance).clip(min=0.0))
