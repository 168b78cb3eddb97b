"""The program (13)-(15) of one trajectory of one drone, solved by row generation and checked."""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from swarm_envs.baselines.mlr_dmpc.avoidance_planes import (
    ROW_MARGIN,
    SPARE_M,
    HalfSpaces,
    Neighbors,
    out_of_reach,
    reachable_boxes,
    soft_weights,
    voronoi_planes,
)
from swarm_envs.baselines.mlr_dmpc.condensed_qp import Condensed, condensed
from swarm_envs.baselines.mlr_dmpc.mlr_dmpc_config import MlrDmpcConfig
from swarm_envs.baselines.mlr_dmpc.row_generation import (
    NO_ROWS,
    Program,
    ProgramRows,
    solve_by_rows,
)
from swarm_envs.baselines.mlr_dmpc.trajectory import (
    Identity,
    Trajectory,
    least_distances,
    sampled_positions,
)
from swarm_envs.state import FloatArray, IntArray

TOLERANCE = 1e-6
"""The tolerance of bounds, SI; that of half-spaces is half, as two drones share it."""
ACCEPTED = "accepted"  # The outcome of a plan that is sent and flown
_BOUND_MARGIN = 2e-5
_BOUND_ROUNDING = 2e-6
_ROW_ROUNDING = 1e-6
_STRIDE_S = 0.3
_RELINEARIZATIONS = 6  # The most programs of a plan after the first
_NEAR_M = 0.3  # Candidates within the required distance plus this have rows
_SETTLED_M = 0.02  # A plan whose end moves less is not solved again
_NEGLIGIBLE_WEIGHT = 1e-9


def program(
    own: Trajectory,
    start_round: int,
    neighbors: Neighbors,
    target: FloatArray,
    config: MlrDmpcConfig,
    planes: Sequence[HalfSpaces] = (),
    around: Trajectory | None = None,
) -> Program:
    """Return the program of a plan from the state of `own` at the start of a round.

    Planes to drones that are not planned in the same round are those of `around`, if given: a plan
    from then on that keeps its distances. Bounds are relaxed as for the present trajectory; with
    those of `around`, each solution would relax them a little more.

    The present trajectory stays feasible although its state is rounded at the new start: see
    `_required_slack`.
    """
    fixed = condensed(config)
    since = config.round_s * (start_round - own.identity.start_round)
    state = own.states(np.array([since]))[0].astype(np.float32).astype(np.float64)
    flown, bounded = _samples_left(own, since, fixed)
    positions, jerk = flown, bounded[-config.num_inputs :]
    if around is not None:
        positions, jerk = _samples_left(around, 0.0, fixed)[0], around.jerk
    between = voronoi_planes(positions, neighbors, config)
    if around is not None:
        both = neighbors.concurrent  # Both drones need the same plane
        same = voronoi_planes(flown, neighbors.some(both), config)
        between.normals[both], between.offsets[both] = same
    parts = [between, *planes]
    spaces = HalfSpaces(*(np.concatenate(arrays) for arrays in zip(*parts)))
    slack = np.einsum("rsi,si->rs", spaces.normals, positions) - spaces.offsets
    offset = np.array(state)
    offset[0] -= target
    weights = soft_weights(positions[-1], target, neighbors.positions[:, -1], config)
    rounding = _ROW_ROUNDING if around is None else 0.0
    build = HalfSpaces(
        spaces.normals, spaces.offsets + _required_slack(slack, ROW_MARGIN, rounding)
    )
    lower = fixed.lower + _required_slack(bounded - fixed.lower, _BOUND_MARGIN, _BOUND_ROUNDING)
    upper = fixed.upper - _required_slack(fixed.upper - bounded, _BOUND_MARGIN, _BOUND_ROUNDING)
    rows = _program_rows(fixed, state, build, weights, config, (lower, upper))
    return Program(
        state,
        fixed.gradient @ offset,
        rows,
        fixed.jerks_inverse @ (jerk - fixed.jerks.start @ state),
        float(slack.min(initial=np.inf)),
        int((~rows.done).any(axis=1).sum()),
        spaces.offsets + np.minimum(-TOLERANCE / 2, slack),
        np.minimum(fixed.lower - TOLERANCE, bounded),
        np.maximum(fixed.upper + TOLERANCE, bounded),
        max(round(_STRIDE_S / config.collision_sampling_s), 1),
    )


def _required_slack(slack: FloatArray, margin: float, rounding: float) -> FloatArray:
    """Return the slack that rows require: a margin, or the present slack less its rounding.

    As an instant is planned for at most every second round of the horizon, roundings seldom use up
    the margin. Where they have, a row requires no slack, or a little more than the present
    trajectory has: with less, the optimum would be rejected in each round.
    """
    worn = np.minimum(slack + _ROW_ROUNDING, 0.0)
    return np.asarray(np.minimum(margin, np.maximum(slack - rounding, worn)))


def _program_rows(
    fixed: Condensed,
    state: FloatArray,
    spaces: HalfSpaces,
    weights: FloatArray,
    config: MlrDmpcConfig,
    bounds: tuple[FloatArray, FloatArray],
) -> ProgramRows:
    low, high = reachable_boxes(state, *bounds, config)
    done = out_of_reach(low, high, spaces.normals, spaces.offsets)
    end = spaces.normals[: len(weights), -1:]
    soft_offsets = spaces.offsets[: len(weights), -1] + config.soft_m
    soft_done = out_of_reach(low[-1:], high[-1:], end, soft_offsets[:, None])[:, 0]
    soft_done |= (weights <= _NEGLIGIBLE_WEIGHT) | (config.soft_m == 0.0)
    return ProgramRows(
        fixed.positions.start @ state,
        fixed.positions.free,
        spaces.normals,
        spaces.offsets,
        done,
        soft_offsets,
        1.0 / np.sqrt(np.maximum(weights, _NEGLIGIBLE_WEIGHT)),
        soft_done,
        fixed.bounded.start @ state,
        fixed.bounded.free,
        *bounds,
        np.zeros((2, *bounds[0].shape), dtype=bool),
    )


def _samples_left(
    trajectory: Trajectory, since: float, fixed: Condensed
) -> tuple[FloatArray, FloatArray]:
    """Return positions (S, 3), m, and bounded quantities (B, 3) of a trajectory's remainder."""
    times = since + np.concatenate([fixed.collision_times, fixed.state_times])
    states = trajectory.states(times)
    samples = len(fixed.collision_times)
    past = round(since / trajectory.input_sampling_s)
    jerk = np.zeros_like(trajectory.jerk)
    jerk[: max(len(jerk) - past, 0)] = trajectory.jerk[past:]
    bounded = states[samples:].transpose(1, 0, 2).reshape(-1, 3)
    return states[:samples, 0], np.concatenate([bounded, jerk])


class Planned(NamedTuple):
    """A planned trajectory and its statistics."""

    trajectory: Trajectory  # The new one if accepted, else the present one
    accepted: bool  # True if every constraint holds, so that it may be sent
    reason: str  # `accepted`, or the reason against it
    shifted_slack: float
    """The least slack of the rows at the present trajectory, m; by Theorem T1 never negative."""
    solve_ms: float  # The time in the solver, all programs together, CPU time of this thread, ms
    total_ms: float  # The time from call to return, CPU time of this thread, ms
    num_rows: int  # The number of rows of the last program
    in_reach: int  # The number of trajectories and obstacles that have rows


def plan_trajectory(
    own: Trajectory,
    start_round: int,
    compute_unit: int,
    neighbors: Neighbors,
    target: FloatArray,
    config: MlrDmpcConfig,
    planes: Sequence[HalfSpaces] = (),
) -> Planned:
    """Plan from the state of `own` at the start of a round: solveOptimization, (13).

    `neighbors` are the trajectories that others may fly from then on, `planes` further half-spaces.

    Returns:
        The plan if every constraint holds as it will be sent, rounded to float32; else `own`.
    """
    begin = time.thread_time()
    task = _Task(own, start_round, compute_unit, neighbors, target, config, planes)
    best = first = _best(task)
    solve_ms = first.solve_ms
    for _ in range(_RELINEARIZATIONS):
        if best.reason != ACCEPTED or not best.held_back:
            break
        found = _best(task, best)
        solve_ms += found.solve_ms
        if found.reason != ACCEPTED:
            break
        ends = found.path[-1] - best.path[-1]
        best = found
        if np.abs(ends).max() < _SETTLED_M:
            break
    accepted = first.reason == ACCEPTED
    return Planned(
        best.plan if accepted else own,
        accepted,
        first.reason,
        first.problem.shifted_slack,
        solve_ms,
        1e3 * (time.thread_time() - begin),
        best.num_rows,
        first.problem.in_reach,
    )


class _Task(NamedTuple):
    """The arguments of `plan_trajectory`."""

    own: Trajectory
    start_round: int
    compute_unit: int
    neighbors: Neighbors
    target: FloatArray
    config: MlrDmpcConfig
    planes: Sequence[HalfSpaces]


class _Solution(NamedTuple):
    """A program's optimum as a plan."""

    problem: Program
    plan: Trajectory  # The plan as it would be sent
    path: FloatArray  # (S, 3) positions of the plan, m
    reason: str  # `accepted`, or the reason against it
    solve_ms: float  # The time in the solver, ms
    num_rows: int  # The number of rows of the last program
    active: IntArray  # (m, 3) rows that hold with equality, as `broken_rows` names them
    held_back: bool  # True if an active plane may be relinearized
    with_rows: IntArray  # (K,) candidates that have rows, or are near the plan


def _best(task: _Task, around: _Solution | None = None) -> _Solution:
    """Return the optimum with planes around the present trajectory, or around a solution.

    With relinearized planes, only candidates that come near and those planned in the same round
    have rows. If a solution comes too near to others, the program is solved again with their rows.
    """
    neighbors, config = task.neighbors, task.config
    near_m = config.sampled_distance_m + max(config.soft_m, _NEAR_M)
    if around is not None:
        chosen = around.with_rows
    elif config.planes == "fixed":
        chosen = np.arange(len(neighbors.drone))
    else:
        path = sampled_positions(task.own, task.start_round, config)
        near = least_distances(path, neighbors.positions, config.inverse_scaling) < near_m
        chosen = np.flatnonzero(near | neighbors.concurrent)
    while True:
        found = _solve(task, chosen, around)
        apart = least_distances(found.path, neighbors.positions, config.inverse_scaling)
        near = apart < near_m
        near[chosen] = False
        others = np.flatnonzero(near)  # Near the plan, but without rows
        chosen = np.concatenate([chosen, others])
        missed = (apart[others] < config.sampled_distance_m + SPARE_M).any()
        if found.reason != ACCEPTED or not missed:
            return found._replace(with_rows=chosen)


def _solve(task: _Task, chosen: IntArray, around: _Solution | None) -> _Solution:
    config, fixed = task.config, condensed(task.config)
    among = task.neighbors.some(chosen)
    plan = None if around is None else around.plan
    problem = program(task.own, task.start_round, among, task.target, config, task.planes, plan)
    found = solve_by_rows(problem, NO_ROWS if around is None else around.active)
    jerk = fixed.jerks.at(problem.state, found.z)
    jerk[-1] = 0.0  # The last jerk is not sent
    identity = Identity(task.start_round, task.compute_unit)
    plan = Trajectory(identity, problem.state, jerk, config.input_sampling_s)
    reason = found.failure or broken(plan, problem, fixed)
    kind, row, _ = found.active.T
    paths = (kind >= 2) & (row < len(chosen))
    fixed_planes = config.planes == "fixed" or among.concurrent[row[paths & (kind == 2)]].all()
    return _Solution(
        problem,
        plan,
        plan.positions(fixed.collision_times),
        reason,
        found.solve_ms,
        found.num_rows,
        found.active[(kind < 2) | paths],
        not fixed_planes,
        chosen,
    )


def broken(plan: Trajectory, problem: Program, fixed: Condensed) -> str:
    """Return `accepted`, or the constraint that a plan breaks and by how much.

    Half-spaces hold to half of `TOLERANCE` and bounds to all of it, or as well as the present
    trajectory holds them. The check is independent of the solver.
    """
    # Each comparison is written so that NaN fails it.
    rest = fixed.rest_by_state @ plan.state + fixed.rest_by_jerk @ plan.jerk
    if not (error := np.abs(rest).max()) <= TOLERANCE or plan.jerk[-1].any():
        return f"does not end at rest: {error:.1e}"
    positions, bounded = _samples_left(plan, 0.0, fixed)
    excess = np.maximum(problem.accepted_lower - bounded, bounded - problem.accepted_upper)
    if not (worst := float(excess.max())) <= 0.0:
        return f"breaks a bound by {worst:.1e}"
    along = np.einsum("rsi,si->rs", problem.rows.normals, positions)
    slack = float((along - problem.accepted_offsets).min(initial=np.inf))
    if not slack >= 0.0:
        return f"breaks a half-space by {-slack:.1e} m"
    return ACCEPTED
