"""One robot's convex program, eq. (17): forces and distances linearized, then solved by OSQP.

The program is linearized around the prior motions of all robots. It differs from the printed one:

- The force enters the acceleration divided by the mass, and depends on the state through its
  derivative instead of being a state itself: f_k = fbar_k + A_k (x_k - xbar_k).
- A held acceleration moves a robot by p' = p + dt (v + v') / 2, which (14) approximates by
  p + dt v.
- The half-space of a pair points from the neighbor to the robot. It is taken at the closest
  approach within each step, not only at knots, so that robots do not collide between knots.
- Forces are bounded halfway between knots too, where they are often largest. The neighbor's force
  is also bounded absolutely, as (6) requires.
- The effort of the neighbors, part of the sum of (6), is linearized: a robot that pushes another
  down increases that one's effort. `effort_by_state` is its slope.

The program is set up once; then only its numbers change.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from swarm_envs.baselines.neural_swarm.planner import trajectories as paths
from swarm_envs.baselines.neural_swarm.planner.force_jacobian import force_jacobian
from swarm_envs.baselines.neural_swarm.planner.problem import PlanningProblem
from swarm_envs.state import FloatArray, IntArray
from swarm_envs.vehicles import GRAM_FORCE

_TINY = 1e-9  # Shorter offsets have no direction, m


@dataclass(frozen=True, eq=False)
class ConvexSubproblem:
    """One robot's problem around a prior: T steps, D axes of motion, M neighbors. SI units."""

    dt: float  # Time between knots, s
    mass: float  # Mass of the robot, kg
    prior: FloatArray  # (T + 1, 2 D) prior states xbar: positions, velocities
    prior_control: FloatArray  # (T, D) prior controls ubar, m/s^2
    goal: FloatArray  # (2 D) final state
    lower: FloatArray  # (2 D) lower bound of the states
    upper: FloatArray  # (2 D) upper bound of the states
    control_bound: float  # Largest |u| along each axis, m/s^2
    force: FloatArray  # (T, D) force on the robot at the knot that begins each step, N
    force_by_state: FloatArray  # (T, D, 2 D) A_k: its derivative by the state there
    effort_by_state: FloatArray
    """(T, 2 D) derivative of the neighbors' effort, the sum of ||u||^2, by the robot's state."""
    shares: FloatArray  # (S,) fractions of each step at which forces are bounded
    bounded: FloatArray  # (S, T, 2 D) prior states of the robot at these fractions
    bounded_force: FloatArray  # (S, T) vertical force on the robot there, N
    bounded_by_state: FloatArray  # (S, T, 2 D) its derivative by the robot's state there
    force_bound: float  # f_a,max: largest vertical force on the robot, N
    neighbor_force: FloatArray  # (S, T, M) vertical forces on the neighbors there, N
    neighbor_by_state: FloatArray
    """(S, T, M, 2 D) C_k: their derivatives by the robot's state there."""
    neighbor_bound: FloatArray  # (M) f_a,max of each neighbor, N
    force_change: float  # b_fa: largest change of a neighbor's force, N
    normal: FloatArray
    """(T, M, D) unit vectors from neighbor to robot at the closest approach of each step."""
    fraction: FloatArray  # (T, M) fraction of the step at which it occurs
    level: FloatArray  # (T, M) least value of <normal, p(fraction)>, m
    trust_state: FloatArray  # (2 D) b_x: largest |x - xbar|
    trust_control: float  # b_u: largest |u - ubar|, m/s^2


def convexify(
    problem: PlanningProblem,
    prior: paths.Trajectories,
    robot: int,
    trust_state: tuple[float, float],
    trust_control: float,
    force_bounds: FloatArray,
) -> ConvexSubproblem:
    """Return one robot's problem, linearized around the prior motions of all robots.

    `trust_state` is the largest change of a position, m, and of a velocity, m/s; `trust_control`
    that of a control, m/s^2; `force_bounds` (N,) is the largest vertical force on each robot, N.
    """
    axes, bounds, steps = list(problem.axes), problem.bounds, prior.steps
    columns, dims = axes + [3 + axis for axis in axes], len(axes)
    others = [j for j in range(len(problem.team)) if j != robot]
    within = paths.states_within(prior, paths.BOUNDED_FRACTIONS)
    forces = paths.vertical_forces(problem, within)
    states = np.concatenate([prior.states[:-1], within.reshape(-1, *within.shape[2:])])
    jacobian = force_jacobian(problem.model, problem.team, states, robot)[..., columns]
    by_state = jacobian[steps:, :, 2].reshape(*forces.shape, 2 * dims)
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
        shares=paths.BOUNDED_FRACTIONS,
        bounded=within[:, :, robot][..., columns],
        bounded_force=forces[:, :, robot],
        bounded_by_state=by_state[:, :, robot],
        force_bound=float(force_bounds[robot]),
        neighbor_force=forces[:, :, others],
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
    problem: PlanningProblem, prior: paths.Trajectories, robot: int, others: list[int]
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return normals (T, M, D), fractions (T, M) and levels (T, M) of half-spaces to the others."""
    axes = list(problem.axes)
    offset = prior.states[:, [robot]] - prior.states[:, others]
    near = paths.closest_approach(offset, prior.dt)
    direction = near.offset[..., axes]
    length = np.linalg.norm(direction, axis=-1, keepdims=True)
    upward = np.eye(len(axes))[-1]
    normal = np.where(length > _TINY, direction / np.maximum(length, _TINY), upward)
    there = paths.position_within(prior.states[:, others], near.fraction, prior.dt)
    apart = problem.bounds.clearances(problem.team)[robot, others]
    return normal, near.fraction, apart + (normal * there[..., axes]).sum(axis=-1)


@dataclass(frozen=True)
class PenaltyWeights:
    """The penalties of missed goals and bounds, relative to the effort, the sum of ||u||^2."""

    goal: float = 1000.0
    """lambda_1, the penalty per largest component (m or m/s) of the error at the goal state."""
    state: float = 300.0
    """lambda_2, the penalty per delta, the excess over the box (m, m/s) or own force bound (1)."""
    neighbor: float = 100.0
    """The penalty per meter of each step's missing clearance, and per f_a,max of a neighbor's
    excess force in each step. They are soft so that every program has a solution."""


@dataclass(frozen=True)
class SolverSettings:
    """The settings of OSQP."""

    tolerance: float = 5e-4
    """The absolute and relative tolerance of the residuals."""
    max_iterations: int = 1000
    """The most iterations, after which an inexact solution is used and its status reported."""
    rho: float = 30.0
    """OSQP's step size, kept constant: OSQP adapts it by elapsed time, and results would vary."""


@dataclass(frozen=True)
class ProgramSolution:
    """The result of a program's solver."""

    states: FloatArray  # (T + 1, 2 D) new states by the linearized dynamics
    controls: FloatArray  # (T, D) new controls by the linearized dynamics, m/s^2
    objective: float  # Value of the program's objective
    status: str  # OSQP's status: `solved`, `maximum iterations reached`, `primal infeasible` ..
    iterations: int  # OSQP's iterations

    @property
    def usable(self) -> bool:
        """True if there is a solution, exact or not."""
        return bool(np.isfinite(self.states).all()) and "infeasible" not in self.status


class ConstraintRows:
    """Rows lower <= A z <= upper of a sparse matrix A, collected group by group."""

    def __init__(self) -> None:
        self.count = 0
        self._bounds: list[tuple[FloatArray, FloatArray]] = []
        self._entries: list[tuple[IntArray, IntArray, FloatArray]] = []

    def add(
        self,
        shape: tuple[int, ...],
        lower: npt.ArrayLike,
        upper: npt.ArrayLike,
        *entries: tuple[IntArray, npt.ArrayLike],
    ) -> slice:
        """Add a group of rows of a shape, and return their slice. Infinite bounds do not bind.

        `entries` are columns (*shape, n) and values of n variables in each row, broadcast. Zeros
        belong to the pattern, too.
        """
        first, self.count = self.count, self.count + int(np.prod(shape))
        rows = np.arange(first, self.count).reshape(*shape, 1)
        for columns, values in entries:
            r, c, v = np.broadcast_arrays(rows, columns, np.asarray(values, dtype=np.float64))
            self._entries.append((r.ravel(), c.ravel(), v.ravel()))
        low, high = (np.broadcast_to(bound, shape).ravel() for bound in (lower, upper))
        self._bounds.append((low, high))
        return slice(first, self.count)

    def bounds(self) -> tuple[FloatArray, FloatArray]:
        """Return lower and upper bounds of all rows."""
        lower, upper = zip(*self._bounds)
        return np.concatenate(lower), np.concatenate(upper)

    def entries(self) -> tuple[IntArray, IntArray, FloatArray]:
        """Return rows, columns and values of all entries of A, in the order of their addition."""
        rows, columns, values = zip(*self._entries)
        return np.concatenate(rows), np.concatenate(columns), np.concatenate(values)


_GOAL_SCALE, _SLACK_SCALE = 3.0, 3.0
"""The scales of the goal's rows and of the slacks' signs, which halve OSQP's iterations."""
_Entries = tuple[tuple[IntArray, npt.ArrayLike], ...]


class RobotProgram:
    """The program of one robot with T steps, D axes and M neighbors.

    The variables are x_0, u_0, x_1, u_1 ... x_T, the goal's slack, delta, and slacks for each
    step's clearance to and force on each neighbor, upward and downward. OSQP is set up for the
    first problem; later ones have the same pattern and change only numbers.
    """

    def __init__(
        self,
        steps: int,
        dims: int,
        neighbors: int,
        weights: PenaltyWeights = PenaltyWeights(),
        settings: SolverSettings = SolverSettings(),
    ) -> None:
        self._steps, self._dims, self._weights, self._settings = steps, dims, weights, settings
        width = 3 * dims
        first = np.arange(steps + 1)[:, None] * width
        self._x = first + np.arange(2 * dims)
        self._u = first[:-1] + 2 * dims + np.arange(dims)
        free = (steps + 1) * width - dims
        self._goal, self._delta = np.array([free]), np.array([free + 1])
        self._slack = (free + 2 + np.arange(3 * steps * neighbors)).reshape(3, steps, neighbors)
        self._variables = free + 2 + self._slack.size
        self._solver: Any = None

    def solve(self, problem: ConvexSubproblem) -> ProgramSolution:
        """Solve one convexified problem, starting from the previous solution."""
        rows = ConstraintRows()
        self._add_motion(rows, problem)
        self._add_own_bounds(rows, problem)
        self._add_neighbors(rows, problem)
        soft = np.concatenate([self._delta, self._slack.ravel()])
        signs = rows.add(soft.shape, 0.0, np.inf, (soft[:, None], _SLACK_SCALE))
        cost, (lower, upper) = np.zeros(self._variables), rows.bounds()
        cost[self._x[:-1]] = problem.effort_by_state
        cost[self._goal], cost[self._delta] = self._weights.goal, self._weights.state
        cost[self._slack] = self._weights.neighbor
        if self._solver is None:
            self._solver = self._set_up(cost, rows)
            z, y = np.zeros(self._variables), np.zeros(rows.count)
            z[self._x], z[self._u] = problem.prior, problem.prior_control
            # Slacks are usually zero; the multipliers of their signs then equal their costs.
            y[signs] = -cost[soft] / _SLACK_SCALE
            self._solver.warm_start(x=z, y=y)
        else:
            values = rows.entries()[2][self._order]
            self._solver.update(q=cost, Ax=values, l=lower, u=upper)
        return self._read(self._solver.solve(raise_error=False), problem)

    def _add_motion(self, rows: ConstraintRows, problem: ConvexSubproblem) -> None:
        """Add the start, the dynamics, and the goal's slack."""
        dt, steps, dims = problem.dt, self._steps, self._dims
        position, velocity = self._x[:, :dims, None], self._x[:, dims:, None]
        rows.add((2 * dims,), problem.prior[0], problem.prior[0], (self._x[0, :, None], 1.0))
        moves = ((position[1:], -1.0), (position[:-1], 1.0))
        flies = ((velocity[:-1], 0.5 * dt), (velocity[1:], 0.5 * dt))
        rows.add((steps, dims), 0.0, 0.0, *moves, *flies)
        slope = dt / problem.mass * problem.force_by_state
        carry = np.einsum("kab,kb->ka", slope, problem.prior[:-1])
        known = carry - dt / problem.mass * problem.force
        forced = (self._x[:-1, None, :], slope + np.eye(2 * dims)[dims:])
        pushed = ((velocity[1:], -1.0), (self._u[..., None], dt))
        rows.add((steps, dims), known, known, *pushed, forced)
        goal, end = _GOAL_SCALE * problem.goal, (self._x[-1, :, None], _GOAL_SCALE)
        rows.add(goal.shape, -np.inf, goal, end, (self._goal, -_GOAL_SCALE))
        rows.add(goal.shape, goal, np.inf, end, (self._goal, _GOAL_SCALE))

    def _add_own_bounds(self, rows: ConstraintRows, problem: ConvexSubproblem) -> None:
        """Add box, speed and force, softened by delta; trust region and control bound."""
        x, trust, later = problem.prior[1:], problem.trust_state, (self._x[1:, :, None], 1.0)
        slope = problem.bounded_by_state / problem.force_bound
        force = problem.bounded_force / problem.force_bound
        known, reach = _known_and_reach(slope, problem)
        within = self._within(slope, problem)
        # Bounds out of reach of the trust region are made infinite: OSQP is four times faster.
        above = np.where(x + trust > problem.upper, problem.upper, np.inf)
        rows.add(x.shape, -np.inf, above, later, (self._delta, -1.0))
        above = np.where(force + reach > 1.0, known - force + 1.0, np.inf)
        rows.add(force.shape, -np.inf, above, *within, (self._delta, -1.0))
        below = np.where(x - trust < problem.lower, problem.lower, -np.inf)
        rows.add(x.shape, below, np.inf, later, (self._delta, 1.0))
        below = np.where(force - reach < -1.0, known - force - 1.0, -np.inf)
        rows.add(force.shape, below, np.inf, *within, (self._delta, 1.0))
        rows.add(x.shape, x - trust, x + trust, later)
        u, most, change = problem.prior_control, problem.control_bound, problem.trust_control
        # A prior beyond the bound may stay there, so that a solution exists.
        lowest = np.minimum(np.maximum(-most, u - change), u)
        highest = np.maximum(np.minimum(most, u + change), u)
        rows.add(u.shape, lowest, highest, (self._u[..., None], 1.0))

    def _add_neighbors(self, rows: ConstraintRows, problem: ConvexSubproblem) -> None:
        """Add half-spaces and the forces on neighbors, softened by slacks."""
        first, second = paths.step_weights(problem.fraction[..., None], problem.dt)
        normal, x, slack = problem.normal, self._x[:, None], self._slack[..., None]
        rows.add(
            normal.shape[:2],
            np.where(self._may_touch(problem), problem.level, -np.inf),
            np.inf,
            (x[:-1], np.concatenate([normal, first * normal], axis=-1)),
            (x[1:, :, self._dims :], second * normal),
            (slack[0], 1.0),
        )
        slope = problem.neighbor_by_state / problem.force_change
        known, reach = _known_and_reach(slope, problem)
        bound = np.where(reach > 1.0, 1.0, np.inf)
        rows.add(known.shape, known - bound, known + bound, *self._within(slope, problem))
        slope = problem.neighbor_by_state / problem.neighbor_bound[:, None]
        force = problem.neighbor_force / problem.neighbor_bound
        known, reach = _known_and_reach(slope, problem)
        bound = np.where(np.abs(force) + reach > 1.0, 1.0, np.inf)
        low, high = known - force - bound, known - force + bound
        slacks = ((slack[1], -1.0), (slack[2], 1.0))
        rows.add(known.shape, low, high, *self._within(slope, problem), *slacks)

    def _within(self, slope: FloatArray, problem: ConvexSubproblem) -> _Entries:
        """Return entries of slope (S, T, ..., 2 D) times states within steps, by their ends."""
        shape = (1, self._steps, *(1,) * (slope.ndim - 3), -1)
        share = problem.shares.reshape(-1, *(1,) * (slope.ndim - 1))
        first, second = paths.step_weights(share, problem.dt)
        by_place, by_speed = np.split(slope, 2, axis=-1)
        by_start = first * by_place + (1.0 - share) * by_speed
        start, end = self._x[:-1].reshape(shape), self._x[1:, self._dims :].reshape(shape)
        return (
            (start, np.concatenate([by_place, by_start], axis=-1)),
            (end, second * by_place + share * by_speed),
        )

    def _may_touch(self, problem: ConvexSubproblem) -> Any:
        """Return (T, M) True if the trust region lets a robot cross the half-space of a step."""
        first, second = paths.step_weights(problem.fraction, problem.dt)
        p, v = np.split(problem.prior[:, None], 2, axis=-1)
        place = p[:-1] + first[..., None] * v[:-1] + second[..., None] * v[1:]
        reach = np.abs(problem.normal) @ problem.trust_state[: self._dims]
        slower = (first + second) * (np.abs(problem.normal) @ problem.trust_state[self._dims :])
        return (problem.normal * place).sum(axis=-1) - reach - slower < problem.level

    def _set_up(self, cost: FloatArray, rows: ConstraintRows) -> Any:
        import osqp
        from scipy.sparse import csc_matrix

        row, column, value = rows.entries()
        self._order = np.lexsort((row, column))
        start = np.concatenate([[0], np.cumsum(np.bincount(column, minlength=self._variables))])
        matrix = csc_matrix(
            (value[self._order], row[self._order], start), shape=(rows.count, self._variables)
        )
        effort = self._u.ravel()
        square = csc_matrix(
            (np.full(effort.size, 2.0), (effort, effort)), shape=(self._variables,) * 2
        )
        solver = osqp.OSQP()
        solver.setup(
            square,
            cost,
            matrix,
            *rows.bounds(),
            verbose=False,
            scaling=0,  # OSQP's scaling would undo that of the slacks and is slower
            adaptive_rho=False,
            rho=self._settings.rho,
            eps_abs=self._settings.tolerance,
            eps_rel=self._settings.tolerance,
            max_iter=self._settings.max_iterations,
            polishing=True,
        )
        return solver

    def _read(self, result: Any, problem: ConvexSubproblem) -> ProgramSolution:
        z, info = result.x, result.info
        if z is None or z.shape != (self._variables,):
            z = np.full(self._variables, np.nan)
        constant = float((problem.effort_by_state * problem.prior[:-1]).sum())
        return ProgramSolution(
            states=z[self._x],
            controls=z[self._u],
            objective=float(info.obj_val) - constant,
            status=str(info.status),
            iterations=int(info.iter),
        )


def _known_and_reach(slope: FloatArray, problem: ConvexSubproblem) -> tuple[FloatArray, FloatArray]:
    """Return slope (S, T, ..., 2 D) times states within steps at the prior, and its range."""
    shape = (*slope.shape[:2], *(1,) * (slope.ndim - 3), -1)
    known = (slope * problem.bounded.reshape(shape)).sum(axis=-1)
    near, fast = np.split(problem.trust_state, 2)
    farther = near + problem.dt * fast  # Between knots, changes of velocity move the robot too
    return known, np.abs(slope) @ np.concatenate([farther, fast])
