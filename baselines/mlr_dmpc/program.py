"""The program (13)-(15) of one plan: its rows, and its optimum by row generation."""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np

from swarm_envs.baselines.mlr_dmpc.condensed import Condensed, condensed
from swarm_envs.baselines.mlr_dmpc.config import MlrDmpcConfig
from swarm_envs.baselines.mlr_dmpc.generation import Rows, Working, broken_rows
from swarm_envs.baselines.mlr_dmpc.neighbors import (
    ROW_MARGIN,
    HalfSpaces,
    Neighbors,
    voronoi_planes,
)
from swarm_envs.baselines.mlr_dmpc.reach import out_of_reach, reach
from swarm_envs.baselines.mlr_dmpc.soft import soft_weights
from swarm_envs.baselines.mlr_dmpc.solvers import Solver, solver
from swarm_envs.baselines.mlr_dmpc.trajectory import Trajectory
from swarm_envs.state import BoolArray, FloatArray

TOLERANCE = 1e-6
"""By how much a plan may break a bound, SI; a half-space by half of that, as two drones may."""
_BOUND_MARGIN = 5e-6
_FIRST_SLACK = 0.1
_STRIDE = 3
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
    rows: Rows
    """What the solution must satisfy."""
    shifted: FloatArray
    """(n, 3) variables of the plan that is flown."""
    shifted_slack: float
    """Least slack of the half-spaces at the plan that is flown, m."""
    accepted_offsets: FloatArray
    """(R, S) least normal . p of an accepted plan, m."""
    accepted_lower: FloatArray
    """(B, 3) of the bounded quantities of an accepted plan."""
    accepted_upper: FloatArray
    """(B, 3) likewise."""


@dataclass(frozen=True, eq=False)
class Optimum:
    """Where row generation ended."""

    z: FloatArray
    """(n, 3) variables."""
    failure: str
    """Why there is no optimum, or nothing."""
    solve_ms: float
    """In the solver, CPU time of this thread, ms."""
    iterations: int
    """Steps of the solver."""
    programs: int
    """Programs solved."""
    num_rows: int
    """Rows of the last one."""


def program(
    own: Trajectory,
    start_round: int,
    neighbors: Neighbors,
    target: FloatArray,
    config: MlrDmpcConfig,
    planes: HalfSpaces | None = None,
) -> Program:
    """The program of a plan from where `own` will be at the start of a round (arguments as there).

    No row asks for more than the plan that is flown gives, so that plan stays feasible.
    """
    fixed = condensed(config)
    since = config.round_s * (start_round - own.identity.start_round)
    state = own.states(np.array([since]))[0].astype(np.float32).astype(np.float64)
    positions, bounded = sampled(own, since, fixed)
    spaces = voronoi_planes(positions, neighbors, config)
    if planes is not None:
        spaces = HalfSpaces(*(np.concatenate(pair) for pair in zip(spaces, planes, strict=True)))
    slack = np.einsum("rsi,si->rs", spaces.normals, positions) - spaces.offsets
    offset = np.array(state)
    offset[0] -= target
    weights = soft_weights(positions[-1], target, neighbors.positions[:, -1], config)
    build = HalfSpaces(spaces.normals, spaces.offsets + np.minimum(ROW_MARGIN, slack))
    lower = np.minimum(fixed.lower + _BOUND_MARGIN, bounded)
    upper = np.maximum(fixed.upper - _BOUND_MARGIN, bounded)
    return Program(
        state,
        fixed.gradient @ offset,
        _rows(fixed, state, build, weights, config, (lower, upper)),
        fixed.jerks_inverse @ (bounded[-config.num_inputs :] - fixed.jerks.start @ state),
        float(slack.min(initial=np.inf)),
        spaces.offsets + np.minimum(-TOLERANCE / 2, slack),
        np.minimum(fixed.lower - TOLERANCE, bounded),
        np.maximum(fixed.upper + TOLERANCE, bounded),
    )


def _rows(
    fixed: Condensed,
    state: FloatArray,
    spaces: HalfSpaces,
    weights: FloatArray,
    config: MlrDmpcConfig,
    bounds: tuple[FloatArray, FloatArray],
) -> Rows:
    low, high = reach(state, *bounds, config)
    done = out_of_reach(low, high, spaces.normals, spaces.offsets)
    end = spaces.normals[: len(weights), -1:]
    soft_offsets = spaces.offsets[: len(weights), -1] + config.soft_m
    soft_done = out_of_reach(low[-1:], high[-1:], end, soft_offsets[:, None])[:, 0]
    soft_done |= (weights <= _NEGLIGIBLE_WEIGHT) | (config.soft_m == 0.0)
    return Rows(
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


def sampled(
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


def optimum(problem: Program, name: str) -> Optimum:
    """Solve a program with ever more rows until the solution breaks none of the others."""
    generation = _Generation(problem, solver(name))
    generation.add(problem.shifted, _FIRST_SLACK, _STRIDE)
    for programs in range(1, _MOST_PROGRAMS + 1):
        if not generation.solve():
            return generation.result("the solver found no plan", programs)
        if not generation.add(generation.z, _BROKEN, _STRIDE if programs == 1 else 1):
            return generation.result("", programs)
    return generation.result(f"no end of rows after {_MOST_PROGRAMS} programs", _MOST_PROGRAMS)


class _Generation:
    """The program with the rows found so far."""

    def __init__(self, problem: Program, solve: Solver) -> None:
        self.problem, self._solve = problem, solve
        self.z = -problem.slope
        self._parts: list[Working] = []
        self._active: BoolArray = np.zeros(0, dtype=bool)
        self._iterations, self._seconds = 0, 0.0

    def add(self, z: FloatArray, threshold: float, stride: int = 1) -> int:
        """Take in the rows with slack below a threshold at z; how many there were."""
        part = broken_rows(self.problem.rows, z, threshold, stride)
        self._parts.append(part)
        self._active = np.concatenate([self._active, np.zeros(len(part.bound), dtype=bool)])
        return len(part.bound)

    def solve(self) -> bool:
        """Solve for the rows so far; whether there is a solution."""
        matrix, bound, scale = (np.concatenate([part[k] for part in self._parts]) for k in range(3))
        soft = np.flatnonzero(scale)
        margins = np.zeros((len(bound), len(soft)))
        margins[soft, np.arange(len(soft))] = scale[soft]
        slope = np.concatenate([self.problem.slope.T.ravel(), np.zeros(len(soft))])
        begin = time.thread_time()
        found = self._solve(slope, np.hstack([matrix, margins]), bound, self._active)
        self._seconds += time.thread_time() - begin
        self._active, self._iterations = found.active, self._iterations + found.iterations
        free = len(self.problem.slope)
        self.z = np.ascontiguousarray(found.y[: 3 * free].reshape(3, free).T)
        return found.solved

    def result(self, failure: str, programs: int) -> Optimum:
        """What is to be said at the end."""
        return Optimum(
            self.z, failure, 1e3 * self._seconds, self._iterations, programs, len(self._active)
        )
