"""One trajectory of one drone: eq. (13), solved, checked, or left at what is flown."""

from __future__ import annotations

import time
from typing import NamedTuple

import numpy as np

from swarm_envs.baselines.mlr_dmpc.condensed import Condensed, condensed
from swarm_envs.baselines.mlr_dmpc.config import MlrDmpcConfig
from swarm_envs.baselines.mlr_dmpc.generation import least_slack
from swarm_envs.baselines.mlr_dmpc.neighbors import HalfSpaces, Neighbors
from swarm_envs.baselines.mlr_dmpc.program import TOLERANCE, Program, optimum, program, sampled
from swarm_envs.baselines.mlr_dmpc.trajectory import Identity, Trajectory
from swarm_envs.state import FloatArray

ACCEPTED = "accepted"
"""The outcome of a plan that is sent and flown."""


class Planned(NamedTuple):
    """A trajectory, and how it came about."""

    trajectory: Trajectory
    """The new one if it is accepted, else the one that is flown."""
    accepted: bool
    """Whether every constraint holds, so that it may be sent."""
    reason: str
    """`accepted`, or why not."""
    shifted_slack: float
    """Least slack of the rows at the trajectory that is flown, m; by Theorem 1 never negative."""
    solve_ms: float
    """In the solver, all programs together, CPU time of this thread, ms."""
    total_ms: float
    """From call to return, CPU time of this thread, ms."""
    iterations: int
    """Steps of the solver, all programs together."""
    programs: int
    """How many were solved, each with more rows than the one before."""
    num_rows: int
    """Rows of the last program."""
    in_reach: int
    """Trajectories and obstacles that the drone can come near to: the others cost no row."""


def plan_trajectory(
    own: Trajectory,
    start_round: int,
    compute_unit: int,
    neighbors: Neighbors,
    target: FloatArray,
    config: MlrDmpcConfig,
    solver: str = "daqp",
    planes: HalfSpaces | None = None,
) -> Planned:
    """Plan anew from where a drone will be at the start of a round.

    Args:
        own: what the drone flies.
        start_round: round at whose beginning the plan starts.
        compute_unit: its author.
        neighbors: what the other drones may fly, from `start_round` on.
        target: (3,) m.
        config: parameters.
        solver: `daqp`, `quadprog` or `osqp`.
        planes: further half-spaces for the drone, such as those of obstacles.

    Returns:
        The plan if every constraint holds as it will be sent, rounded to float32; else `own`.

    Raises:
        ValueError: there is no such solver.
    """
    begin = time.thread_time()
    fixed = condensed(config)
    problem = program(own, start_round, neighbors, target, config, planes)
    found = optimum(problem, solver)
    trajectory, reason = own, found.failure
    if not reason:
        jerk = fixed.jerks.at(problem.state, found.z)
        jerk[-1] = 0.0
        identity = Identity(start_round, compute_unit)
        plan = Trajectory(identity, problem.state, jerk, config.input_sampling_s)
        reason = broken(plan, problem, fixed)
        trajectory = plan if reason == ACCEPTED else own
    return Planned(
        trajectory,
        reason == ACCEPTED,
        reason,
        problem.shifted_slack,
        found.solve_ms,
        1e3 * (time.thread_time() - begin),
        found.iterations,
        found.programs,
        found.num_rows,
        problem.in_reach,
    )


def broken(plan: Trajectory, problem: Program, fixed: Condensed) -> str:
    """What a plan breaks, with the amount, or `accepted`; independent of how it was found.

    Half-spaces hold to half of `TOLERANCE`, bounds to all of it, unless the trajectory that is
    flown holds them less: then as well as that does.
    """
    rest = fixed.rest_by_state @ plan.state + fixed.rest_by_jerk @ plan.jerk
    if not (error := np.abs(rest).max()) <= TOLERANCE or plan.jerk[-1].any():
        return f"does not end at rest: {error:.1e}"
    positions, bounded = sampled(plan, 0.0, fixed)
    excess = np.maximum(problem.accepted_lower - bounded, bounded - problem.accepted_upper)
    if not (worst := float(excess.max())) <= 0.0:
        return f"breaks a bound by {worst:.1e}"
    slack = least_slack(positions, problem.rows.normals, problem.accepted_offsets)
    if not slack >= 0.0:
        return f"breaks a half-space by {-slack:.1e} m"
    return ACCEPTED
