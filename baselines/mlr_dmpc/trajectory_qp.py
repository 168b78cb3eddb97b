"""One trajectory of one drone: the program (13)-(15), solved by row generation, and checked."""

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
"""By how much a plan may break a bound, SI; a half-space by half of that, as two drones may."""
ACCEPTED = "accepted"  # The outcome of a plan that is sent and flown
_BOUND_MARGIN = 2e-5
_BOUND_ROUNDING = 2e-6
_ROW_ROUNDING = 1e-6
_STRIDE_S = 0.3
_RELINEARISATIONS = 6  # most programs of a plan after the first
_NEAR_M = 0.3  # candidates this much further off than they must be have rows
_SETTLED_M = 0.02  # the end of a plan moves less: it is not solved again
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
    """The program of a plan from where `own` will be at the start of a round.

    Planes to drones that are not planned in the same round are those of `around`, a plan from then
    on that keeps its distances, if there is one; these rows then are as wide as that needs. Bounds
    are those of what is flown, or each solution would wear them down a little more.

    The plan that is flown stays feasible although its state is rounded at the new start: see
    `_asked`.
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
        both = neighbors.concurrent  # here both drones need the same plane
        same = voronoi_planes(flown, neighbors.some(both), config)
        between.normals[both], between.offsets[both] = same
    parts = [between, *planes]
    spaces = HalfSpaces(*(np.concatenate(arrays) for arrays in zip(*parts)))
    slack = np.einsum("rsi,si->rs", spaces.normals, positions) - spaces.offsets
    offset = np.array(state)
    offset[0] -= target
    weights = soft_weights(positions[-1], target, neighbors.positions[:, -1], config)
    rounding = _ROW_ROUNDING if around is None else 0.0
    build = HalfSpaces(spaces.normals, spaces.offsets + _asked(slack, ROW_MARGIN, rounding))
    lower = fixed.lower + _asked(bounded - fixed.lower, _BOUND_MARGIN, _BOUND_ROUNDING)
    upper = fixed.upper - _asked(fixed.upper - bounded, _BOUND_MARGIN, _BOUND_ROUNDING)
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


def _asked(slack: FloatArray, margin: float, rounding: float) -> FloatArray:
    """What rows ask for beyond their offsets: a margin, or what is flown gives less its rounding.

    As an instant is planned for at most every second round of the horizon, roundings seldom use up
    the margin. Where they have, a row asks for nothing beyond its offset, or for a little more than
    what is flown gives: for less, the optimum would be refused, round after round.
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
    """Positions (S, 3), m, and bounded quantities (B, 3) of what is left of a trajectory."""
    times = since + np.concatenate([fixed.collision_times, fixed.state_times])
    states = trajectory.states(times)
    samples = len(fixed.collision_times)
    past = round(since / trajectory.input_sampling_s)
    jerk = np.zeros_like(trajectory.jerk)
    jerk[: max(len(jerk) - past, 0)] = trajectory.jerk[past:]
    bounded = states[samples:].transpose(1, 0, 2).reshape(-1, 3)
    return states[:samples, 0], np.concatenate([bounded, jerk])


class Planned(NamedTuple):
    """A trajectory, and how it came about."""

    trajectory: Trajectory  # The new one if it is accepted, else the one that is flown
    accepted: bool  # Whether every constraint holds, so that it may be sent
    reason: str  # `accepted`, or why not
    shifted_slack: float
    """Least slack of the rows at the trajectory that is flown, m; by Theorem T1 never negative."""
    solve_ms: float  # In the solver, all programs together, CPU time of this thread, ms
    total_ms: float  # From call to return, CPU time of this thread, ms
    num_rows: int  # Rows of the last program
    in_reach: int  # Trajectories and obstacles that have rows


def plan_trajectory(
    own: Trajectory,
    start_round: int,
    compute_unit: int,
    neighbors: Neighbors,
    target: FloatArray,
    config: MlrDmpcConfig,
    planes: Sequence[HalfSpaces] = (),
) -> Planned:
    """Replan from where a drone will be at the start of a round: solveOptimization, (13).

    `neighbors`: what the others may fly from then on. `planes`: further half-spaces for the drone.

    Returns:
        The plan if every constraint holds as it will be sent, rounded to float32; else `own`.
    """
    begin = time.thread_time()
    task = _Task(own, start_round, compute_unit, neighbors, target, config, planes)
    best = first = _best(task)
    solve_ms = first.solve_ms
    for _ in range(_RELINEARISATIONS):
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
    """What `plan_trajectory` is called with."""

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
    plan: Trajectory  # as it would be sent
    path: FloatArray  # (S, 3) of the plan
    reason: str  # `accepted`, or why not
    solve_ms: float  # in the solver
    num_rows: int  # of the last program
    active: IntArray  # (m, 3) half-spaces that hold with equality, as `broken_rows` names them
    held_back: bool  # by planes that may be taken anew
    with_rows: IntArray  # (K,) candidates that have rows, or are near to the plan


def _best(task: _Task, around: _Solution | None = None) -> _Solution:
    """The optimum behind planes of what is flown, or of a solution of before.

    With relinearised planes, only candidates that come near and those planned in the same round
    have rows. If a solution comes nearer than it may to others, it is found again with their rows.
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
        others = np.flatnonzero(near)  # they had no rows: nothing has kept the plan off them
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
    jerk[-1] = 0.0  # it is not sent: the plan ends at rest
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
    """What a plan breaks, with the amount, or `accepted`; independent of how it was found.

    Half-spaces hold to half of `TOLERANCE`, bounds to all of it, unless the trajectory that is
    flown holds them less: then as well as that does.
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
