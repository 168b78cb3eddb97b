"""Row generation: a program is solved with only those of its rows that a plan would break."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from swarm_envs.baselines.mlr_dmpc.condensed_qp import solve_qp
from swarm_envs.compiled import kernel
from swarm_envs.state import BoolArray, FloatArray, IntArray

NO_ROWS: IntArray = np.zeros((0, 3), dtype=np.int64)
"""No rows of a program, as `broken_rows` names them."""
_FIRST_SLACK = 0.1
_BROKEN = -1e-7
_MOST_PROGRAMS = 30


class ProgramRows(NamedTuple):
    """Every row of a program, and flags of those that are in it already or need not be."""

    base: FloatArray  # (S, 3) positions at the collision samples for variables of zero, m
    by_variables: FloatArray  # (S, n) positions of an axis by its variables
    normals: FloatArray  # (R, S, 3) of half-spaces
    offsets: FloatArray  # (R, S) least normal . p, m
    done: BoolArray  # (R, S) True for half-spaces in the program or out of reach
    soft_offsets: FloatArray
    """(C,) least normal . p at the last sample with the full soft margin, m."""
    soft_scales: FloatArray
    """(C,) reduction of the margin per unit of its soft variable, m; 0 if it has none."""
    soft_done: BoolArray  # (C,) True for soft rows in the program or out of reach
    bounded_base: FloatArray  # (B, 3) bounded quantities for variables of zero
    bounded_by_variables: FloatArray  # (B, n) bounded quantities of an axis by its variables
    lower: FloatArray  # (B, 3) lower bounds
    upper: FloatArray  # (B, 3) upper bounds
    bounds_done: BoolArray  # (2, B, 3) True for bounds in the program, lower and upper


@kernel
def _working_set(rows: ProgramRows, picked: IntArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Mark rows `picked` (m, 3) as done; return their matrix (m, 3 n), bound and scale (m,).

    A row is matrix @ z + scale * (soft variable of the row) >= bound, with scale 0 if it has none.
    """
    free, count = rows.by_variables.shape[1], picked.shape[0]
    matrix, bound = np.zeros((count, 3 * free)), np.empty(count)
    scale = np.zeros(count)
    for m in range(count):
        kind, r, s = picked[m]
        if kind < 2:
            rows.bounds_done[kind, r, s] = True
            sign = 1.0 if kind == 0 else -1.0
            limit = rows.lower[r, s] if kind == 0 else rows.upper[r, s]
            bound[m] = sign * (limit - rows.bounded_base[r, s])
            for k in range(free):
                matrix[m, s * free + k] = sign * rows.bounded_by_variables[r, k]
            continue
        bound[m] = rows.offsets[r, s]
        if kind == 2:
            rows.done[r, s] = True
        else:
            rows.soft_done[r] = True
            bound[m], scale[m] = rows.soft_offsets[r], rows.soft_scales[r]
        for i in range(3):
            bound[m] -= rows.normals[r, s, i] * rows.base[s, i]
            for k in range(free):
                matrix[m, i * free + k] = rows.normals[r, s, i] * rows.by_variables[s, k]
    return matrix, bound, scale


@kernel
def broken_rows(rows: ProgramRows, z: FloatArray, threshold: float, stride: int) -> IntArray:
    """Return the rows not yet done with slack below a threshold, m, at variables z (n, 3).

    Of each trajectory's half-spaces only every `stride`-th is returned, including the most broken:
    others close in time then seldom bind.

    Returns:
        (m, 3) kind (lower, upper, half-space, soft), row, and sample or axis.
    """
    most = rows.bounds_done.size + rows.done.size + rows.soft_done.size
    picked, count = np.empty((most, 3), np.int64), 0
    bounded = rows.bounded_base + rows.bounded_by_variables @ z
    for r in range(bounded.shape[0]):
        for i in range(3):
            slacks = (bounded[r, i] - rows.lower[r, i], rows.upper[r, i] - bounded[r, i])
            for kind in range(2):
                if slacks[kind] < threshold and not rows.bounds_done[kind, r, i]:
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
                picked[count] = 2, r, s
                count += 1
        soft = r < rows.soft_done.shape[0] and not rows.soft_done[r]
        if soft and _along(rows.normals, position, r, last) - rows.soft_offsets[r] < threshold:
            picked[count] = 3, r, last
            count += 1
    return picked[:count]


@kernel
def _along(normals: FloatArray, positions: FloatArray, r: int, s: int) -> float:
    """Return normal . p of half-space r at sample s."""
    return (
        normals[r, s, 0] * positions[s, 0]
        + normals[r, s, 1] * positions[s, 1]
        + normals[r, s, 2] * positions[s, 2]
    )


@dataclass(frozen=True, eq=False)
class Program:
    """The quadratic program of a plan, with the limits by which its solution is accepted."""

    state: FloatArray  # (3, 3) at the start, as a message carries it
    slope: FloatArray  # (n, 3) linear term of the cost
    rows: ProgramRows
    shifted: FloatArray  # (n, 3) variables of the present trajectory
    shifted_slack: float  # Least slack of the half-spaces at the present trajectory, m
    in_reach: int  # The number of trajectories and obstacles with a half-space that may bind
    accepted_offsets: FloatArray  # (R, S) least normal . p of an accepted plan, m
    accepted_lower: FloatArray  # (B, 3) lower bounds of an accepted plan
    accepted_upper: FloatArray  # (B, 3) upper bounds of an accepted plan
    stride: int  # Samples from one half-space of a trajectory to the next in the first programs


class RowSolution(NamedTuple):
    """The result of `solve_by_rows`."""

    z: FloatArray  # (n, 3) variables
    failure: str  # The reason that there is no optimum, or an empty string
    solve_ms: float  # The time in the solver, CPU time of this thread, ms
    num_rows: int  # The number of rows of the last program
    active: IntArray  # (m, 3) rows that hold with equality, as `broken_rows` names them


def solve_by_rows(problem: Program, first: IntArray = NO_ROWS) -> RowSolution:
    """Return the optimum of a program, solved with more and more rows until it breaks no other.

    `first` are rows (m, 3), as in `active`, that are active at first.
    """
    rows, stride, solve_ms = problem.rows, problem.stride, 0.0
    parts, picked, active = [_working_set(rows, first)], first, np.ones(len(first), dtype=bool)
    more = broken_rows(rows, problem.shifted, _FIRST_SLACK, stride)
    z, failure = -problem.slope, f"rows still broken after {_MOST_PROGRAMS} programs"
    free = len(z)
    for programs in range(_MOST_PROGRAMS + 1):
        parts.append(_working_set(rows, more))
        picked = np.concatenate([picked, more])
        active = np.concatenate([active, np.zeros(len(more), dtype=bool)])
        if programs == _MOST_PROGRAMS:
            break
        matrix, bound, scale = (np.concatenate([part[k] for part in parts]) for k in range(3))
        soft = np.flatnonzero(scale)
        margins = np.zeros((len(bound), len(soft)))
        margins[soft, np.arange(len(soft))] = scale[soft]
        slope = np.concatenate([problem.slope.T.ravel(), np.zeros(len(soft))])
        begin = time.thread_time()
        found = solve_qp(slope, np.hstack([matrix, margins]), bound, active)
        solve_ms += 1e3 * (time.thread_time() - begin)
        active, z = found.active, np.ascontiguousarray(found.y[: 3 * free].reshape(3, free).T)
        if not found.solved:
            failure = "the solver found no plan"
            break
        more = broken_rows(rows, z, _BROKEN, stride if programs == 0 else 1)
        if not len(more):
            failure = ""
            break
    return RowSolution(z, failure, solve_ms, len(active), picked[active])
