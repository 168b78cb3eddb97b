"""Stage 2: sequential convex programming (Algorithm 1, lines 18 to 21).

Robots solve their convex programs around the present motions of all, one after another in random
order. The paper only states that this converges. Here a step is accepted only if the merit of the
whole team, evaluated with the nonlinear model, falls; otherwise that robot's trust region shrinks,
and after success it grows again. So the merit falls monotonically, whatever the solver returns, and
the present plan is always the best so far. A robot has settled when its program predicts hardly any
improvement, or its trust region has become tiny. The refinement has converged when all have
settled.

Programs bound forces at knots and halfway between. If forces exceed a bound elsewhere, that bound
is lowered by the excess, and the refinement continues.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from swarm_envs.baselines.neural_swarm.planner import trajectories as paths
from swarm_envs.baselines.neural_swarm.planner.convex_program import (
    PenaltyWeights,
    ProgramSolution,
    RobotProgram,
    convexify,
)
from swarm_envs.baselines.neural_swarm.planner.problem import PlanningProblem
from swarm_envs.state import FloatArray


@dataclass(frozen=True, eq=False)
class MeritTerms:
    """The terms of the merit: a team's effort, its errors at goals and its excess over bounds."""

    effort: FloatArray  # (N,) sum of ||u||^2, m^2/s^4
    goal: FloatArray  # (N,) largest component of the error at the goal state, m or m/s
    state: FloatArray  # (N,) largest excess over the box, m or m/s, or over the own force bound, 1
    apart: FloatArray  # (N, N) missing clearance of each pair, summed over steps, m
    force: FloatArray
    """(N,) excess of each step's peak over the force bound, in its units, summed over steps."""
    control: FloatArray  # (N,) excess over the control bound, summed over knots and axes, m/s^2

    def team(self, weights: PenaltyWeights) -> float:
        """Return the merit of the team, which the refinement decreases."""
        pairs = self.apart.sum() / 2.0
        soft = pairs + self.force.sum() + self.control.sum()
        hard = weights.goal * self.goal.sum() + weights.state * self.state.sum()
        return float(self.effort.sum() + hard + weights.neighbor * soft)

    def robot(self, i: int, weights: PenaltyWeights) -> float:
        """Return the part of the merit that is in robot i's program."""
        others = self.apart[i].sum() + self.force.sum() - self.force[i]
        hard = weights.goal * self.goal[i] + weights.state * self.state[i]
        return float(self.effort[i] + hard + weights.neighbor * others)


def merit_terms(
    problem: PlanningProblem, motions: paths.Trajectories, force_bounds: FloatArray
) -> MeritTerms:
    """Return the terms of consistent motions under force bounds (N,), N, which may be tightened."""
    bounds, axes = problem.bounds, list(problem.axes)
    position, velocity = motions.position[1:][..., axes], motions.velocity[1:][..., axes]
    controls = motions.controls[..., axes]
    low, high = np.array(bounds.lower)[axes], np.array(bounds.upper)[axes]
    outside = np.maximum(position - high, low - position).max(axis=(0, 2))
    fast = np.abs(velocity).max(axis=(0, 2)) - bounds.speed
    strong = _force_excess(problem, motions, paths.BOUNDED_FRACTIONS, force_bounds).max(axis=0)
    lacking = bounds.clearances(problem.team) - paths.pairwise_approach(motions).distance
    end = np.concatenate([position[-1] - problem.goals[:, axes], velocity[-1]], axis=-1)
    return MeritTerms(
        effort=(controls**2).sum(axis=(0, 2)),
        goal=np.abs(end).max(axis=-1),
        state=np.maximum(np.maximum(outside, fast), strong.max(axis=0)).clip(min=0.0),
        apart=lacking.clip(min=0.0).sum(axis=0),
        force=strong.clip(min=0.0).sum(axis=0),
        control=(np.abs(controls) - bounds.acceleration).clip(min=0.0).sum(axis=(0, 2)),
    )


def _force_excess(
    problem: PlanningProblem, motions: paths.Trajectories, fractions: FloatArray, bounds: FloatArray
) -> FloatArray:
    """Return (S, T, N) the vertical force over its bound, less 1, at S fractions of each step."""
    forces = paths.vertical_forces(problem, paths.states_within(motions, fractions))
    return np.asarray(np.abs(forces) / bounds - 1.0)


MAX_SWEEPS = 80
"""The most sweeps, in each of which all robots are planned once."""
MAX_TIGHTENINGS = 4
"""The most times that force bounds are lowered because forces exceed them between knots."""
_TRUST_POSITION, _TRUST_SPEED, _TRUST_CONTROL = 0.3, 1.0, 5.0
"""The initial and largest b_x of positions, m, and velocities, m/s, and b_u, m/s^2."""
_GROW, _SHRINK = 1.5, 0.4
"""The factors of a trust region after an accepted and after a rejected step."""
_LEAST_TRUST = 2e-3  # Share of the trust region at which a robot has settled
_RENEWED_TRUST = 0.2  # Least share of the trust region after force bounds were lowered
_TOLERANCE = 2e-4  # Share of the merit below which a predicted improvement is negligible
_NEARLY = 5e-3  # Share of a force bound by which it may be exceeded between knots
_WEIGHTS = PenaltyWeights()


@dataclass(frozen=True)
class StepRecord:
    """The record of one robot's program. Files of plans use these names."""

    sweep: int  # Index of the sweep over all robots
    robot: int  # Index of the robot
    status: str  # The solver's status
    iterations: int  # The solver's iterations
    step_ms: float  # Time for derivatives, program and solution, ms
    trust: float  # Share of the trust region that was allowed
    promised: float  # Reduction of the merit predicted by the linearized program
    gained: float
    """Actual reduction of the team's merit with the nonlinear model; negative for an increase."""
    taken: bool  # True if the step was accepted
    merit: float  # The team's merit afterwards


@dataclass(frozen=True)
class RefinementResult:
    """The result of stage 2."""

    trajectories: paths.Trajectories  # The best motions found
    history: tuple[StepRecord, ...]  # Every program, in order
    converged: bool  # True if all robots have settled, even if the plan exceeds bounds
    out_of_time: bool  # True if it ended at the deadline
    reason: str  # The reason for its end


class _Refiner:
    """The state of one refinement."""

    def __init__(self, problem: PlanningProblem, motions: paths.Trajectories) -> None:
        team = len(problem.team)
        self.problem, self.motions = problem, motions
        self.force_bounds, self.tightened = problem.bounds.force_bounds(problem.team), 0
        self.trust, self.settled = np.ones(team), np.zeros(team, dtype=np.bool_)
        self.history: list[StepRecord] = []
        shape = (motions.steps, len(problem.axes), team - 1)
        self.programs = [RobotProgram(*shape, _WEIGHTS) for _ in range(team)]
        self.evaluate()

    def evaluate(self) -> None:
        """Update the merit of the present motions under the present force bounds."""
        self.terms = merit_terms(self.problem, self.motions, self.force_bounds)
        self.merit = self.terms.team(_WEIGHTS)

    def tighten(self) -> bool:
        """Lower the force bounds that are exceeded between knots; return True if any was."""
        bounds = self.problem.bounds.force_bounds(self.problem.team)
        peak = _force_excess(self.problem, self.motions, paths.CHECKED_FRACTIONS, bounds).max(
            axis=(0, 1)
        )
        excess = 1.0 + np.maximum(peak, 0.0)
        if self.tightened == MAX_TIGHTENINGS or excess.max() < 1.0 + _NEARLY:
            return False
        self.tightened += 1
        margin = np.where(excess > 1.0, 1.0 + _NEARLY, 1.0)
        self.force_bounds = self.force_bounds / (excess * margin)
        self.settled[:], self.trust[:] = False, np.maximum(self.trust, _RENEWED_TRUST)
        self.evaluate()
        return True

    def step(self, sweep: int, robot: int) -> None:
        """Solve one robot's program, and take the step if it reduces the team's merit."""
        began, trust = time.perf_counter(), float(self.trust[robot])
        convex = convexify(
            self.problem,
            self.motions,
            robot,
            (trust * _TRUST_POSITION, trust * _TRUST_SPEED),
            trust * _TRUST_CONTROL,
            self.force_bounds,
        )
        solution = self.programs[robot].solve(convex)
        spent = time.perf_counter() - began
        own = self.terms.robot(robot, _WEIGHTS)
        promised = own - solution.objective if solution.usable else 0.0
        gained = self._try(robot, solution)
        taken = gained > 0.0
        little = _TOLERANCE * max(self.merit, 1.0)
        tiny = trust * _SHRINK < _LEAST_TRUST
        self.settled[robot] = solution.usable and (promised < little or (not taken and tiny))
        if taken and gained > little:
            self.settled[:] = False  # Others may now be able to improve
        change = _GROW if taken else _SHRINK
        if not solution.usable:
            change = _GROW  # The trust region was too small to contain a solution
        self.trust[robot] = min(1.0, max(trust * change, _LEAST_TRUST))
        self.history.append(
            StepRecord(
                sweep=sweep,
                robot=robot,
                status=solution.status,
                iterations=solution.iterations,
                step_ms=1e3 * spent,
                trust=trust,
                promised=promised,
                gained=gained,
                taken=taken,
                merit=self.merit,
            )
        )

    def _try(self, robot: int, solution: ProgramSolution) -> float:
        """Take the step if the team's merit falls; return the reduction, negative if it rises."""
        if not solution.usable:
            return 0.0
        velocity = solution.states[:, len(self.problem.axes) :]
        motions = with_velocity(self.problem, self.motions, robot, velocity)
        terms = merit_terms(self.problem, motions, self.force_bounds)
        merit = terms.team(_WEIGHTS)
        gained = self.merit - merit
        if gained > 0.0:
            self.motions, self.terms, self.merit = motions, terms, merit
        return gained


def refine(
    problem: PlanningProblem,
    initial: paths.Trajectories,
    rng: np.random.Generator,
    deadline: float = float("inf"),
    watch: Callable[[StepRecord], None] | None = None,
) -> RefinementResult:
    """Refine motions until no robot can improve the team's plan, or the deadline has passed.

    The initial motions begin at the starts, and may miss goals and exceed bounds. `watch` is called
    after every program.
    """
    state = _Refiner(problem, initial)
    out_of_time = False
    for sweep in range(MAX_SWEEPS):
        for robot in rng.permutation(len(problem.team)):
            out_of_time = time.monotonic() > deadline
            if out_of_time:
                break
            state.step(sweep, int(robot))
            if watch is not None:
                watch(state.history[-1])
        if out_of_time or (state.settled.all() and not state.tighten()):
            break
    converged = bool(state.settled.all())
    if converged:
        reason = "no robot's program predicts a further improvement"
    elif out_of_time:
        reason = "the time limit was reached"
    else:
        reason = f"not converged after {MAX_SWEEPS} sweeps"
    return RefinementResult(state.motions, tuple(state.history), converged, out_of_time, reason)


def with_velocity(
    problem: PlanningProblem, motions: paths.Trajectories, robot: int, velocity: FloatArray
) -> paths.Trajectories:
    """Return the motions with other velocities (T + 1, D) of one robot."""
    states = motions.states.copy()
    new = np.zeros((len(velocity), 3))
    new[:, list(problem.axes)] = velocity
    new[0] = states[0, robot, 3:]
    states[:, robot, 3:] = new
    states[1:, robot, :3] = paths.integrate_velocity(states[0, robot, :3], new, motions.dt)[1:]
    return paths.trajectories_through(problem, states)
