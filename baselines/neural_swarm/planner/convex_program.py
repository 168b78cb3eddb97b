"""One robot's convex program, eq. (17), in OSQP: set up once, then only numbers change."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from swarm_envs.baselines.neural_swarm.planner.linearization import ConvexSubproblem
from swarm_envs.baselines.neural_swarm.planner.trajectories import BOUNDED_FRACTIONS, step_weights
from swarm_envs.state import FloatArray, IntArray


@dataclass(frozen=True)
class PenaltyWeights:
    """Penalties of missed goals and bounds, beside the effort, the sum of ||u||^2."""

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
    """After which an inexact solution is taken, and reported as one."""
    rho: float = 30.0
    """OSQP's step, kept constant: OSQP adapts it by the clock, and results would vary."""


@dataclass(frozen=True)
class ProgramSolution:
    """What a program's solver returned."""

    states: FloatArray
    """(T + 1, 2 D) new states as the linearised dynamics see them."""
    controls: FloatArray
    """(T, D) new controls as the linearised dynamics see them, m/s^2."""
    goal_slack: float
    """Largest component by which the goal is missed, m or m/s."""
    state_slack: float
    """delta."""
    objective: float
    """Value of the program's objective."""
    status: str
    """OSQP's word: `solved`, `maximum iterations reached`, `primal infeasible` ..."""
    iterations: int
    """OSQP's iterations."""

    @property
    def usable(self) -> bool:
        """Whether there is a solution at all, exact or not."""
        return bool(np.isfinite(self.states).all()) and "infeasible" not in self.status


class ConstraintPattern:
    """A sparse matrix A with a fixed pattern: rows l <= A z <= u, added in named groups.

    Once the pattern is finished, values and bounds are set by name.
    Rows that are never given bounds, or infinite ones, bind nothing.
    """

    def __init__(self) -> None:
        self.rows: dict[str, slice] = {}
        """The rows of each group."""
        self._count = 0
        self._parts: list[tuple[IntArray, IntArray, FloatArray]] = []
        self._blocks: dict[str, tuple[slice, tuple[int, ...]]] = {}
        self._filled = 0

    def add_rows(self, name: str, *shape: int) -> IntArray:
        """Add a group of rows; returns their indices, of the given shape."""
        count = int(np.prod(shape))
        self.rows[name] = slice(self._count, self._count + count)
        self._count += count
        return np.arange(self._count - count, self._count).reshape(shape)

    def put(
        self, rows: IntArray, columns: npt.ArrayLike, value: npt.ArrayLike, name: str = ""
    ) -> None:
        """Put entries where rows and columns, broadcast, meet; a name lets `set` change them."""
        r, c, v = np.broadcast_arrays(rows, columns, np.asarray(value, dtype=np.float64))
        if name:
            self._blocks[name] = (slice(self._filled, self._filled + r.size), r.shape)
        self._filled += r.size
        self._parts.append((r.ravel(), np.asarray(c).ravel(), v.ravel()))

    def finish(self, variables: int) -> None:
        """Fix the pattern, for so many variables; nothing can be added afterwards."""
        from scipy.sparse import csc_matrix

        rows, columns, values = (np.concatenate(part) for part in zip(*self._parts))
        order = np.lexsort((rows, columns))
        self._values, self._order = values, order
        start = np.concatenate([[0], np.cumsum(np.bincount(columns, minlength=variables))])
        shape = (self._count, variables)
        self.matrix: Any = csc_matrix((values[order], rows[order], start), shape=shape)
        self.lower = np.full(self._count, -np.inf)
        self.upper = np.full(self._count, np.inf)

    def set(self, name: str, value: npt.ArrayLike) -> None:
        """Set the entries that were put under a name."""
        where, shape = self._blocks[name]
        self._values[where] = np.broadcast_to(value, shape).ravel()

    def bound(self, name: str, lower: npt.ArrayLike, upper: npt.ArrayLike) -> None:
        """Set the bounds of a group of rows; arrays of the group's shape, or one number."""
        where = self.rows[name]
        self.lower[where], self.upper[where] = np.ravel(lower), np.ravel(upper)

    def update(self) -> Any:
        """The matrix (rows, variables) with the present values."""
        self.matrix.data[:] = self._values[self._order]
        return self.matrix


_GOAL_SCALE, _SLACK_SCALE = 3.0, 3.0
"""Of the rows of the goal and of the slacks' signs: OSQP converges in half the iterations."""


class RobotProgram:
    """The program of one robot with T steps, D axes and M neighbours.

    The variables are x_0, u_0, x_1, u_1 ... x_T, the goal's slack, delta, and a slack for each
    step's clearance to and force on each neighbour, upward and downward.
    """

    def __init__(
        self,
        steps: int,
        dims: int,
        neighbors: int,
        dt: float,
        weights: PenaltyWeights = PenaltyWeights(),  # frozen
        settings: SolverSettings = SolverSettings(),  # frozen
    ) -> None:
        self._steps, self._dims, self._weights, self._settings = steps, dims, weights, settings
        width = 3 * dims
        first = np.arange(steps + 1)[:, None] * width
        self._x = first + np.arange(2 * dims)
        self._u = first[:-1] + 2 * dims + np.arange(dims)
        free = (steps + 1) * width - dims
        self._goal, self._delta = free, free + 1
        self._slack = (free + 2 + np.arange(3 * steps * neighbors)).reshape(3, steps, neighbors)
        self._variables = free + 2 + self._slack.size
        self._pattern = ConstraintPattern()
        self._add_motion(dt)
        self._add_own_bounds()
        self._add_neighbors(neighbors)
        self._pattern.finish(self._variables)
        self._pattern.bound("sign", 0.0, np.inf)
        self._solver: Any = None

    def _add_motion(self, dt: float) -> None:
        pattern, steps, dims = self._pattern, self._steps, self._dims
        position, velocity = self._x[:, :dims], self._x[:, dims:]
        pattern.put(pattern.add_rows("start", 2 * dims), self._x[0], 1.0)
        rows = pattern.add_rows("position", steps, dims)
        pattern.put(rows, position[1:], -1.0)
        pattern.put(rows, position[:-1], 1.0)
        pattern.put(rows, velocity[:-1], 0.5 * dt)
        pattern.put(rows, velocity[1:], 0.5 * dt)
        rows = pattern.add_rows("velocity", steps, dims)
        pattern.put(rows, velocity[1:], -1.0)
        pattern.put(rows, self._u, dt)
        pattern.put(rows[:, :, None], self._x[:-1, None, :], 0.0, "velocity")
        for name, sign in (("goal above", -1.0), ("goal below", 1.0)):
            rows = pattern.add_rows(name, 2 * dims)
            pattern.put(rows, self._x[-1], _GOAL_SCALE)
            pattern.put(rows, self._goal, sign * _GOAL_SCALE)

    def _add_own_bounds(self) -> None:
        pattern, steps, dims = self._pattern, self._steps, self._dims
        later = self._x[1:]
        for side, sign in (("above", -1.0), ("below", 1.0)):
            rows = pattern.add_rows(f"box {side}", steps, 2 * dims)
            pattern.put(rows, later, 1.0)
            pattern.put(rows, self._delta, sign)
            rows = pattern.add_rows(f"force {side}", len(BOUNDED_FRACTIONS), steps)
            self._put_within(rows, f"force {side}")
            pattern.put(rows, self._delta, sign)
        pattern.put(pattern.add_rows("trust", steps, 2 * dims), later, 1.0)
        pattern.put(pattern.add_rows("control", steps, dims), self._u, 1.0)

    def _put_within(self, rows: IntArray, name: str) -> None:
        """Put entries (S, T, ...) for states within steps, which depend on those at the ends."""
        shape = (1, self._steps, *(1,) * (rows.ndim - 2), -1)
        end = self._x[1:, self._dims :]
        self._pattern.put(rows[..., None], self._x[:-1].reshape(shape), 0.0, f"{name}, start")
        self._pattern.put(rows[..., None], end.reshape(shape), 0.0, f"{name}, end")

    def _set_within(self, name: str, slope: FloatArray, problem: ConvexSubproblem) -> None:
        """Set them: `slope` (S, T, ..., 2 D) is by the states within steps."""
        share = problem.shares.reshape(-1, *(1,) * (slope.ndim - 1))
        first, second = step_weights(share, problem.dt)
        by_place, by_speed = np.split(slope, 2, axis=-1)
        by_start = first * by_place + (1.0 - share) * by_speed
        self._pattern.set(f"{name}, start", np.concatenate([by_place, by_start], axis=-1))
        self._pattern.set(f"{name}, end", second * by_place + share * by_speed)

    def _add_neighbors(self, neighbors: int) -> None:
        pattern, steps, dims = self._pattern, self._steps, self._dims
        size = (len(BOUNDED_FRACTIONS), steps, neighbors)
        rows, x = pattern.add_rows("apart", steps, neighbors), self._x[:, None]
        pattern.put(rows[:, :, None], x[:-1], 0.0, "apart from start")
        pattern.put(rows[:, :, None], x[1:, :, dims:], 0.0, "apart from end")
        pattern.put(rows, self._slack[0], 1.0)
        rows = pattern.add_rows("change", *size)
        self._put_within(rows, "change")
        rows = pattern.add_rows("neighbor", *size)
        self._put_within(rows, "neighbor")
        pattern.put(rows, self._slack[1], -1.0)
        pattern.put(rows, self._slack[2], 1.0)
        soft = np.concatenate([[self._delta], self._slack.ravel()])
        pattern.put(pattern.add_rows("sign", soft.size), soft, _SLACK_SCALE)

    def solve(self, problem: ConvexSubproblem) -> ProgramSolution:
        """Solve for one convexified problem, starting from the last one's solution.

        Args:
            problem: of the steps, axes and neighbours that the program was made for.
        """
        self._set_motion(problem)
        self._set_own_bounds(problem)
        self._set_neighbors(problem)
        return self._read(self._run(problem), problem)

    def _set_motion(self, problem: ConvexSubproblem) -> None:
        pattern, dt, dims = self._pattern, problem.dt, self._dims
        slope = dt / problem.mass * problem.force_by_state
        carry = np.einsum("kab,kb->ka", slope, problem.prior[:-1])
        known = carry - dt / problem.mass * problem.force
        pattern.bound("start", problem.prior[0], problem.prior[0])
        pattern.bound("position", 0.0, 0.0)
        pattern.set("velocity", slope + np.eye(2 * dims)[dims:])
        pattern.bound("velocity", known, known)
        pattern.bound("goal above", -np.inf, _GOAL_SCALE * problem.goal)
        pattern.bound("goal below", _GOAL_SCALE * problem.goal, np.inf)

    def _set_own_bounds(self, problem: ConvexSubproblem) -> None:
        pattern, x, trust = self._pattern, problem.prior[1:], problem.trust_state
        # Rows that the trust region cannot reach bind nothing; told so, OSQP is four times faster.
        above = np.where(x + trust > problem.upper, problem.upper, np.inf)
        below = np.where(x - trust < problem.lower, problem.lower, -np.inf)
        pattern.bound("box above", -np.inf, above)
        pattern.bound("box below", below, np.inf)
        self._set_force(problem)
        pattern.bound("trust", x - trust, x + trust)
        u, most, reach = problem.prior_control, problem.control_bound, problem.trust_control
        # A prior beyond the bound is allowed to stay where it is, so that a solution exists.
        lowest = np.minimum(np.maximum(-most, u - reach), u)
        highest = np.maximum(np.minimum(most, u + reach), u)
        pattern.bound("control", lowest, highest)

    def _set_force(self, problem: ConvexSubproblem) -> None:
        """Bound |force + slope (x - xbar)| by the bound and delta, x being within steps."""
        bound = problem.force_bound
        slope, force = problem.bounded_by_state / bound, problem.bounded_force / bound
        known, reach = _known_and_reach(slope, problem)
        for side in ("above", "below"):
            self._set_within(f"force {side}", slope, problem)
        above = np.where(force + reach > 1.0, known - force + 1.0, np.inf)
        below = np.where(force - reach < -1.0, known - force - 1.0, -np.inf)
        self._pattern.bound("force above", -np.inf, above)
        self._pattern.bound("force below", below, np.inf)

    def _set_neighbors(self, problem: ConvexSubproblem) -> None:
        pattern = self._pattern
        first, second = step_weights(problem.fraction[..., None], problem.dt)
        normal = problem.normal
        pattern.set("apart from start", np.concatenate([normal, first * normal], axis=-1))
        pattern.set("apart from end", second * normal)
        pattern.bound("apart", np.where(self._may_touch(problem), problem.level, -np.inf), np.inf)
        slope = problem.neighbor_by_state / problem.force_change
        known, reach = _known_and_reach(slope, problem)
        self._set_within("change", slope, problem)
        bound = np.where(reach > 1.0, 1.0, np.inf)
        pattern.bound("change", known - bound, known + bound)
        slope = problem.neighbor_by_state / problem.neighbor_bound[:, None]
        force = problem.neighbor_force / problem.neighbor_bound
        known, reach = _known_and_reach(slope, problem)
        self._set_within("neighbor", slope, problem)
        bound = np.where(np.abs(force) + reach > 1.0, 1.0, np.inf)
        pattern.bound("neighbor", known - force - bound, known - force + bound)

    def _may_touch(self, problem: ConvexSubproblem) -> Any:
        """(T, M) whether the trust region lets a robot cross the half-space of a step."""
        first, second = step_weights(problem.fraction, problem.dt)
        p, v = np.split(problem.prior[:, None], 2, axis=-1)
        place = p[:-1] + first[..., None] * v[:-1] + second[..., None] * v[1:]
        reach = np.abs(problem.normal) @ problem.trust_state[: self._dims]
        slower = (first + second) * (np.abs(problem.normal) @ problem.trust_state[self._dims :])
        return (problem.normal * place).sum(axis=-1) - reach - slower < problem.level

    def _run(self, problem: ConvexSubproblem) -> Any:
        matrix, pattern = self._pattern.update(), self._pattern
        cost = self._cost(problem)
        if self._solver is not None:
            self._solver.update(q=cost, Ax=matrix.data, l=pattern.lower, u=pattern.upper)
            return self._solver.solve(raise_error=False)
        self._solver = self._new_solver(cost)
        z, y = np.zeros(self._variables), np.zeros(matrix.shape[0])
        z[self._x], z[self._u] = problem.prior, problem.prior_control
        # Slacks are zero as a rule: then what they cost is what their sign's multiplier must be.
        y[pattern.rows["sign"]] = -cost[self._delta :] / _SLACK_SCALE
        self._solver.warm_start(x=z, y=y)
        return self._solver.solve(raise_error=False)

    def _cost(self, problem: ConvexSubproblem) -> FloatArray:
        cost = np.zeros(self._variables)
        cost[self._x[:-1]] = problem.effort_by_state
        cost[self._goal], cost[self._delta] = self._weights.goal, self._weights.state
        cost[self._slack] = self._weights.neighbor
        return cost

    def _new_solver(self, cost: FloatArray) -> Any:
        import osqp
        from scipy.sparse import csc_matrix

        pattern, settings = self._pattern, self._settings
        diagonal = np.zeros(self._variables)
        diagonal[self._u] = 2.0
        start = np.concatenate([[0], np.cumsum(diagonal > 0.0)])
        square = csc_matrix(
            (diagonal[diagonal > 0.0], np.flatnonzero(diagonal), start),
            shape=(self._variables, self._variables),
        )
        solver = osqp.OSQP()
        solver.setup(
            square,
            cost,
            pattern.matrix.copy(),
            pattern.lower,
            pattern.upper,
            verbose=False,
            scaling=0,  # the units are chosen; OSQP's scaling undoes the slacks' and is slower
            adaptive_rho=False,
            rho=settings.rho,
            eps_abs=settings.tolerance,
            eps_rel=settings.tolerance,
            max_iter=settings.max_iterations,
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
            goal_slack=float(z[self._goal]),
            state_slack=float(z[self._delta]),
            objective=float(info.obj_val) - constant,
            status=str(info.status),
            iterations=int(info.iter),
        )


def _known_and_reach(slope: FloatArray, problem: ConvexSubproblem) -> tuple[FloatArray, FloatArray]:
    """Of slope (S, T, ..., 2 D) times states within steps: value at the prior, and range."""
    shape = (*slope.shape[:2], *(1,) * (slope.ndim - 3), -1)
    known = (slope * problem.bounded.reshape(shape)).sum(axis=-1)
    near, fast = np.split(problem.trust_state, 2)
    farther = near + problem.dt * fast  # between knots velocities add to the way
    return known, np.abs(slope) @ np.concatenate([farther, fast])
