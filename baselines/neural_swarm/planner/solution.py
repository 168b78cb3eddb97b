"""What a robot's convex program is told, and what its solver says."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from swarm_envs.state import FloatArray


@dataclass(frozen=True)
class Weights:
    """What missing a goal or a bound costs, beside the effort, the sum of ||u||^2."""

    goal: float = 1000.0
    """lambda_1: per largest component (m or m/s) by which the goal state is missed."""
    state: float = 300.0
    """lambda_2: per delta, the excess over the box (m, m/s) and over the own force bound (1)."""
    neighbor: float = 100.0
    """Per metre of each step's missing clearance, and per f_a,max of a neighbour's excess force in
    each step: these too are soft, so that every program has a solution."""


@dataclass(frozen=True)
class SolverSettings:
    """How exactly OSQP solves."""

    tolerance: float = 5e-4
    """Of the residuals, absolute and relative."""
    max_iterations: int = 1000
    """After which an inexact solution is taken, and said to be one."""
    rho: float = 30.0
    """OSQP's step, kept constant: OSQP adapts it by the clock, and results would vary."""


@dataclass(frozen=True)
class Solution:
    """What a program's solver returned."""

    velocity: FloatArray
    """(T + 1, D) new velocities, m/s; the motion follows from them."""
    states: FloatArray
    """(T + 1, 2 D) new states as the linearised dynamics see them."""
    controls: FloatArray
    """(T, D) new controls as the linearised dynamics see them, m/s^2."""
    goal_slack: float
    """Largest component by which the goal is missed, m or m/s."""
    state_slack: float
    """delta."""
    neighbor_slack: float
    """Sum of the missing clearances and excess forces."""
    objective: float
    """Value of the program's objective."""
    status: str
    """OSQP's word: `solved`, `maximum iterations reached`, `primal infeasible` ..."""
    iterations: int
    """OSQP's iterations."""
    solve_s: float
    """Seconds spent in updating and solving."""

    @property
    def usable(self) -> bool:
        """Whether there is a solution at all, exact or not."""
        return bool(np.isfinite(self.velocity).all()) and "infeasible" not in self.status
