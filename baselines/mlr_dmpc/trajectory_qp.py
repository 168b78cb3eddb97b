"""One trajectory of one drone: the program (13)-(15), solved by row generation, and checked.

Of thousands of rows, only those that a plan would break enter the program.
"""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from swarm_envs.baselines.mlr_dmpc.avoidance_planes import (
    ROW_MARGIN,
    HalfSpaces,
    Neighbors,
    comes_near,
    out_of_reach,
    reachable_boxes,
    soft_weights,
    voronoi_planes,
)
from swarm_envs.baselines.mlr_dmpc.condensed_qp import Condensed, condensed, solver
from swarm_envs.baselines.mlr_dmpc.mlr_dmpc_config import MlrDmpcConfig
from swarm_envs.baselines.mlr_dmpc.trajectory import Identity, Trajectory, end_position
from swarm_envs.compiled import kernel
from swarm_envs.state import BoolArray, FloatArray, IntArray


class _Rows(NamedTuple):
    """Every row of a program, as what it bounds; those that are in the program, or need not be."""

    base: FloatArray  # (S, 3) positions at the collision samples for variables of zero, m
    by_variables: FloatArray  # (S, n) positions of an axis by its variables
    normals: FloatArray  # (R, S, 3) of half-spaces
    offsets: FloatArray  # (R, S) least normal . p, m
    done: BoolArray  # (R, S) half-spaces in the program, or out of reach
    # (C,) least normal . p at the last sample with the soft margin wide open, m
    soft_offsets: FloatArray
    # (C,) by how much a unit of its soft variable closes a margin, m; 0 if it has none
    soft_scales: FloatArray
    soft_done: BoolArray  # (C,) soft rows in the program, or out of reach
    bounded_base: FloatArray  # (B, 3) bounded quantities for variables of zero
    bounded_by_variables: FloatArray  # (B, n) bounded quantities of an axis by its variables
    lower: FloatArray  # (B, 3) least bounded quantities
    upper: FloatArray  # (B, 3) largest bounded quantities
    bounds_done: BoolArray  # (2, B, 3) bounds in the program, lower and upper


class _WorkingSet(NamedTuple):
    """The rows in the program: matrix @ z + scale * (soft variable of the row) >= bound."""

    matrix: FloatArray  # (m, 3 n)
    bound: FloatArray  # (m,)
    scale: FloatArray  # (m,) 0 for a row without soft variable


@kernel
def broken_rows(rows: _Rows, z: FloatArray, threshold: float, stride: int) -> _WorkingSet:
    """Rows not yet done with slack below a threshold, m, at variables z (n, 3), now done.

    Of each trajectory's half-spaces only every `stride`-th, the most broken among them: others
    close in time seldom bind then.
    """
    free = z.shape[0]
    picked = _pick(rows, z, threshold, stride)
    count = picked.shape[0]
    matrix, bound = np.zeros((count, 3 * free)), np.empty(count)
    scale = np.zeros(count)
    for m in range(count):
        kind, r, s = picked[m]
        if kind < 2:
            sign = 1.0 if kind == 0 else -1.0
            limit = rows.lower[r, s] if kind == 0 else rows.upper[r, s]
            bound[m] = sign * (limit - rows.bounded_base[r, s])
            for k in range(free):
                matrix[m, s * free + k] = sign * rows.bounded_by_variables[r, k]
            continue
        bound[m] = rows.offsets[r, s]
        if kind == 3:
            bound[m], scale[m] = rows.soft_offsets[r], rows.soft_scales[r]
        for i in range(3):
            bound[m] -= rows.normals[r, s, i] * rows.base[s, i]
            for k in range(free):
                matrix[m, i * free + k] = rows.normals[r, s, i] * rows.by_variables[s, k]
    return _WorkingSet(matrix, bound, scale)


@kernel
def _pick(rows: _Rows, z: FloatArray, threshold: float, stride: int) -> IntArray:
    """(m, 3) kind (lower, upper, half-space, soft), row and sample or axis of what is broken."""
    most = rows.bounds_done.size + rows.done.size + rows.soft_done.size
    picked, count = np.empty((most, 3), np.int64), 0
    bounded = rows.bounded_base + rows.bounded_by_variables @ z
    for r in range(bounded.shape[0]):
        for i in range(3):
            slacks = (bounded[r, i] - rows.lower[r, i], rows.upper[r, i] - bounded[r, i])
            for kind in range(2):
                if slacks[kind] < threshold and not rows.bounds_done[kind, r, i]:
                    rows.bounds_done[kind, r, i] = True
                    picked[count] = kind, r, i
                    count += 1
    position = rows.base + rows.by_variables @ z
    last = position.shape[0] - 1
    for r in range(rows.normals.shape[0]):
        worst, at = threshold, -1
        for s in range(last + 1):
            if not rows.done[r, s]:
                slack = _along(rows.normals, position, r, s) - rows.offsets[r, s]
                if slack < worst:
                    worst, at = slack, s
        for s in range(at % stride if at >= 0 else last + 1, last + 1, stride):
            slack = _along(rows.normals, position, r, s) - rows.offsets[r, s]
            if slack < threshold and not rows.done[r, s]:
                rows.done[r, s] = True
                picked[count] = 2, r, s
                count += 1
        soft = r < rows.soft_done.shape[0] and not rows.soft_done[r]
        if soft and _along(rows.normals, position, r, last) - rows.soft_offsets[r] < threshold:
            rows.soft_done[r] = True
            picked[count] = 3, r, last
            count += 1
    return picked[:count]


@kernel
def least_slack(positions: FloatArray, normals: FloatArray, offsets: FloatArray) -> float:
    """Least of normal . p - offset over all half-spaces, m; infinite if there are none."""
    least = math.inf
    for r in range(normals.shape[0]):
        for s in range(normals.shape[1]):
            along = -offsets[r, s]
            for i in range(3):
                along += normals[r, s, i] * positions[s, i]
            least = min(least, along)
    return least


@kernel
def _along(normals: FloatArray, positions: FloatArray, r: int, s: int) -> float:
    """Normal . p of half-space r at sample s."""
    return (
        normals[r, s, 0] * positions[s, 0]
        + normals[r, s, 1] * positions[s, 1]
        + normals[r, s, 2] * positions[s, 2]
    )


TOLERANCE = 1e-6
"""By how much a plan may break a bound, SI; a half-space by half of that, as two drones may."""
ACCEPTED = "accepted"
"""The outcome of a plan that is sent and flown."""
_BOUND_MARGIN = 2e-5
_BOUND_ROUNDING = 2e-6
_ROW_ROUNDING = 1e-6
_FIRST_SLACK = 0.1
_STRIDE_S = 0.3
_RELINEARISATIONS = 6  # most programs of a plan after the first
_RANGE_MARGIN = 1e-3  # bounds are broken by less, SI
_TOUCHING_M = 1e-4  # rows with more slack do not hold a plan back
_SETTLED_M = 0.02  # the end of a plan moves less: it is not solved again
_BROKEN = -1e-7
_MOST_PROGRAMS = 30
_NEGLIGIBLE_WEIGHT = 1e-9


@dataclass(frozen=True, eq=False)
class Program:
    """A quadratic program for one plan, with what its solution is checked against."""

    state: FloatArray
    """(3, 3) at the start, as a message carries it."""
    slope: FloatArray
    """(n, 3) of the cost."""
    rows: _Rows
    """What the solution must satisfy."""
    shifted: FloatArray
    """(n, 3) variables of the plan that is flown."""
    shifted_slack: float
    """Least slack of the half-spaces at the plan that is flown, m."""
    in_reach: int
    """Trajectories and obstacles with a half-space that may bind."""
    accepted_offsets: FloatArray
    """(R, S) least normal . p of an accepted plan, m."""
    accepted_lower: FloatArray
    """(B, 3) of the bounded quantities of an accepted plan."""
    accepted_upper: FloatArray
    """(B, 3) likewise."""
    stride: int
    """Samples from one half-space of a trajectory to the next in the first programs."""


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

    No row asks for all that the plan that is flown gives, so that plan stays feasible, although its
    state is rounded at the new start. As an instant is planned for at most every second round of
    the horizon, what roundings give away stays below the margins that bounds and rows begin with.
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
        _take_planes(between, flown, neighbors, config)
    parts = [between, *planes]
    spaces = HalfSpaces(*(np.concatenate(arrays) for arrays in zip(*parts)))
    slack = np.einsum("rsi,si->rs", spaces.normals, positions) - spaces.offsets
    offset = np.array(state)
    offset[0] -= target
    weights = soft_weights(positions[-1], target, neighbors.positions[:, -1], config)
    build = HalfSpaces(
        spaces.normals, spaces.offsets + np.minimum(ROW_MARGIN, slack - _ROW_ROUNDING)
    )
    lower = np.minimum(fixed.lower + _BOUND_MARGIN, bounded - _BOUND_ROUNDING)
    upper = np.maximum(fixed.upper - _BOUND_MARGIN, bounded + _BOUND_ROUNDING)
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


def _take_planes(
    between: HalfSpaces, flown: FloatArray, neighbors: Neighbors, config: MlrDmpcConfig
) -> None:
    """Put the planes of what is flown (S, 3) where both drones need the same one."""
    both = neighbors.concurrent
    same = voronoi_planes(flown, neighbors.some(both), config)
    between.normals[both], between.offsets[both] = same


def _in_range(
    own: Trajectory, start_round: int, neighbors: Neighbors, config: MlrDmpcConfig
) -> Neighbors:
    """Those that are planned in the same round, or that some plan from now on comes near to.

    From the others every plan keeps its distance, and the soft margin at the end.
    """
    fixed = condensed(config)
    since = config.round_s * (start_round - own.identity.start_round)
    state = own.states(np.array([since]))[0]
    _, bounded = _samples_left(own, since, fixed)
    lower = np.minimum(fixed.lower, bounded) - _RANGE_MARGIN
    upper = np.maximum(fixed.upper, bounded) + _RANGE_MARGIN
    keep = np.full(config.num_samples, config.sampled_distance_m + _RANGE_MARGIN)
    keep[-1] += config.soft_m
    near = comes_near(
        *reachable_boxes(state, lower, upper, config),
        neighbors.positions,
        config.inverse_scaling,
        keep,
    )
    return neighbors.some(near | neighbors.concurrent)


def _program_rows(
    fixed: Condensed,
    state: FloatArray,
    spaces: HalfSpaces,
    weights: FloatArray,
    config: MlrDmpcConfig,
    bounds: tuple[FloatArray, FloatArray],
) -> _Rows:
    low, high = reachable_boxes(state, *bounds, config)
    done = out_of_reach(low, high, spaces.normals, spaces.offsets)
    end = spaces.normals[: len(weights), -1:]
    soft_offsets = spaces.offsets[: len(weights), -1] + config.soft_m
    soft_done = out_of_reach(low[-1:], high[-1:], end, soft_offsets[:, None])[:, 0]
    soft_done |= (weights <= _NEGLIGIBLE_WEIGHT) | (config.soft_m == 0.0)
    return _Rows(
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


class RowGeneration:
    """The optimum of a program: solved with ever more rows until it breaks none of the others.

    Raises:
        ValueError: there is no such solver.
    """

    def __init__(self, problem: Program, solver_name: str) -> None:
        self.z = -problem.slope
        """(n, 3) variables."""
        self.failure = f"no end of rows after {_MOST_PROGRAMS} programs"
        """Why there is no optimum, or nothing."""
        self.solve_ms = 0.0
        """In the solver, CPU time of this thread, ms."""
        self.softened = False
        """Whether the optimum closes a soft margin."""
        self._problem, self._solver = problem, solver(solver_name)
        self._parts: list[_WorkingSet] = []
        self._active: BoolArray = np.zeros(0, dtype=bool)
        self._run()

    @property
    def num_rows(self) -> int:
        """Rows of the last program."""
        return len(self._active)

    def _run(self) -> None:
        stride = self._problem.stride
        self._add(self._problem.shifted, _FIRST_SLACK, stride)
        for programs in range(1, _MOST_PROGRAMS + 1):
            if not self._solve():
                self.failure = "the solver found no plan"
                return
            if not self._add(self.z, _BROKEN, stride if programs == 1 else 1):
                self.failure = ""
                return

    def _add(self, z: FloatArray, threshold: float, stride: int) -> int:
        """Take in the rows with slack below a threshold at z; how many there were."""
        part = broken_rows(self._problem.rows, z, threshold, stride)
        self._parts.append(part)
        self._active = np.concatenate([self._active, np.zeros(len(part.bound), dtype=bool)])
        return len(part.bound)

    def _solve(self) -> bool:
        """Solve for the rows so far; whether there is a solution."""
        matrix, bound, scale = (np.concatenate([part[k] for part in self._parts]) for k in range(3))
        soft = np.flatnonzero(scale)
        margins = np.zeros((len(bound), len(soft)))
        margins[soft, np.arange(len(soft))] = scale[soft]
        slope = np.concatenate([self._problem.slope.T.ravel(), np.zeros(len(soft))])
        begin = time.thread_time()
        found = self._solver(slope, np.hstack([matrix, margins]), bound, self._active)
        self.solve_ms += 1e3 * (time.thread_time() - begin)
        self._active = found.active
        free = len(self._problem.slope)
        self.softened = bool((np.abs(found.y[3 * free :]) > TOLERANCE).any())
        self.z = np.ascontiguousarray(found.y[: 3 * free].reshape(3, free).T)
        return found.solved


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
    solver_name: str = "daqp",
    planes: Sequence[HalfSpaces] = (),
) -> Planned:
    """Replan from where a drone will be at the start of a round.

    `neighbors`: what the others may fly from then on. `planes`: further half-spaces for the drone.

    Returns:
        The plan if every constraint holds as it will be sent, rounded to float32; else `own`.
    """
    begin = time.thread_time()
    identity = Identity(start_round, compute_unit)
    anew = config.planes == "relinearised"
    if anew:
        neighbors = _in_range(own, start_round, neighbors, config)
    situation = own, start_round, neighbors, target, config, planes
    problem = program(*situation)
    first = _solve(problem, solver_name, identity, config)
    solve_ms, best = first.solve_ms, first
    again = anew and not neighbors.concurrent.all() and first.held_back
    for _ in range(_RELINEARISATIONS if again and first.reason == ACCEPTED else 0):
        found = _solve(program(*situation, best.plan), solver_name, identity, config)
        solve_ms += found.solve_ms
        if found.reason != ACCEPTED:
            break
        ends = end_position(found.plan, config) - end_position(best.plan, config)
        best = found
        if np.abs(ends).max() < _SETTLED_M:
            break
    accepted = first.reason == ACCEPTED
    return Planned(
        best.plan if accepted else own,
        accepted,
        first.reason,
        problem.shifted_slack,
        solve_ms,
        1e3 * (time.thread_time() - begin),
        best.num_rows,
        problem.in_reach,
    )


class _Solution(NamedTuple):
    """A program's optimum as a plan."""

    plan: Trajectory  # as it would be sent
    reason: str  # `accepted`, or why not
    solve_ms: float  # in the solver
    num_rows: int  # of the last program
    held_back: bool  # by a half-space or a soft margin: other planes may allow a better plan


def _solve(
    problem: Program, solver_name: str, identity: Identity, config: MlrDmpcConfig
) -> _Solution:
    fixed = condensed(config)
    found = RowGeneration(problem, solver_name)
    jerk = fixed.jerks.at(problem.state, found.z)
    jerk[-1] = 0.0
    plan = Trajectory(identity, problem.state, jerk, config.input_sampling_s)
    reason = found.failure or broken(plan, problem, fixed)
    rows = problem.rows
    slack = least_slack(rows.base + rows.by_variables @ found.z, rows.normals, rows.offsets)
    held_back = found.softened or slack < _TOUCHING_M
    return _Solution(plan, reason, found.solve_ms, found.num_rows, held_back)


def broken(plan: Trajectory, problem: Program, fixed: Condensed) -> str:
    """What a plan breaks, with the amount, or `accepted`; independent of how it was found.

    Half-spaces hold to half of `TOLERANCE`, bounds to all of it, unless the trajectory that is
    flown holds them less: then as well as that does.
    """
    rest = fixed.rest_by_state @ plan.state + fixed.rest_by_jerk @ plan.jerk
    if not (error := np.abs(rest).max()) <= TOLERANCE or plan.jerk[-1].any():
        return f"does not end at rest: {error:.1e}"
    positions, bounded = _samples_left(plan, 0.0, fixed)
    excess = np.maximum(problem.accepted_lower - bounded, bounded - problem.accepted_upper)
    if not (worst := float(excess.max())) <= 0.0:
        return f"breaks a bound by {worst:.1e}"
    slack = least_slack(positions, problem.rows.normals, problem.accepted_offsets)
    if not slack >= 0.0:
        return f"breaks a half-space by {-slack:.1e} m"
    return ACCEPTED
