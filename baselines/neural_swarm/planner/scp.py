"""Stage 2: sequential convex programming (Algorithm 1, lines 18 to 21).

One robot after another, in random order, solves its convex program around the present motions of
all. The paper says no more than that this converges. Here a step is taken only if the merit of the
whole team, measured on the nonlinear model, falls; if it does not, that robot's trust region
shrinks, and after success it grows again. So the merit falls monotonically, whatever the solver
returns, and the best plan so far is always the present one. A robot has settled when its program
promises next to nothing, or its trust region has become tiny; the refinement has converged when
all have.

Programs bound forces at knots and half way between. Where they peak elsewhere above a bound, that
bound is lowered by as much, and the refinement continues.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from swarm_envs.baselines.neural_swarm.planner import trajectories as ways
from swarm_envs.baselines.neural_swarm.planner.convex_program import (
    PenaltyWeights,
    ProgramSolution,
    RobotProgram,
    SolverSettings,
    convexify,
)
from swarm_envs.baselines.neural_swarm.planner.problem import PlanningProblem
from swarm_envs.errors import check_integer, check_number, check_type
from swarm_envs.state import FloatArray


@dataclass(frozen=True, eq=False)
class MeritTerms:
    """The terms of the merit: the effort of a team, and by how much it misses goals and bounds."""

    effort: FloatArray  # (N,) sum of ||u||^2, m^2/s^4
    goal: FloatArray  # (N,) largest component by which the goal state is missed, m or m/s
    state: FloatArray  # (N,) largest excess over the box, m or m/s, or over the own force bound, 1
    apart: FloatArray  # (N, N) clearance that each pair lacks, summed over steps, m
    force: FloatArray
    """(N,) excess of each step's peak over the force bound, in its units, summed over steps."""
    control: FloatArray  # (N,) excess over the control bound, summed over knots and axes, m/s^2

    def team(self, weights: PenaltyWeights) -> float:
        """The merit of all: what the whole refinement decreases."""
        pairs = self.apart.sum() / 2.0
        soft = pairs + self.force.sum() + self.control.sum()
        hard = weights.goal * self.goal.sum() + weights.state * self.state.sum()
        return float(self.effort.sum() + hard + weights.neighbor * soft)

    def robot(self, i: int, weights: PenaltyWeights) -> float:
        """The part of the merit that robot i's program sees."""
        others = self.apart[i].sum() + self.force.sum() - self.force[i]
        hard = weights.goal * self.goal[i] + weights.state * self.state[i]
        return float(self.effort[i] + hard + weights.neighbor * others)


def merit_terms(
    problem: PlanningProblem, motions: ways.Trajectories, force_bounds: FloatArray
) -> MeritTerms:
    """Evaluate motions that fit their controls and forces; `force_bounds` (N,), N, may be lower."""
    bounds, axes = problem.bounds, list(problem.axes)
    position, velocity = motions.position[1:][..., axes], motions.velocity[1:][..., axes]
    controls = motions.controls[..., axes]
    low, high = np.array(bounds.lower)[axes], np.array(bounds.upper)[axes]
    outside = np.maximum(position - high, low - position).max(axis=(0, 2))
    fast = np.abs(velocity).max(axis=(0, 2)) - bounds.speed
    strong = _force_excess(problem, motions, ways.BOUNDED_FRACTIONS, force_bounds).max(axis=0)
    lacking = bounds.clearances(problem.team) - ways.pairwise_approach(motions).distance
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
    problem: PlanningProblem, motions: ways.Trajectories, fractions: FloatArray, bounds: FloatArray
) -> FloatArray:
    """Vertical force over its bound, less 1, at S fractions of each step: (S, T, N)."""
    forces = ways.vertical_forces(problem, ways.states_within(motions, fractions))
    return np.asarray(np.abs(forces) / bounds - 1.0)


_NEARLY = 5e-3  # Share of a force bound by which it may be exceeded between knots


@dataclass(frozen=True)
class RefinementOptions:
    """How stage 2 searches."""

    max_sweeps: int = 80
    """How often all robots are planned, at most."""
    trust_position: float = 0.3
    """b_x of positions to begin with, and at most, m."""
    trust_speed: float = 1.0
    """b_x of velocities, m/s."""
    trust_control: float = 5.0
    """b_u, m/s^2."""
    grow: float = 1.5
    """By how much a trust region grows after a step that was taken."""
    shrink: float = 0.4
    """By how much it shrinks after one that was not."""
    least_trust: float = 2e-3
    """Share of the trust region at which a robot has settled."""
    max_tightenings: int = 4
    """How often force bounds are lowered because forces exceed them between knots."""
    renewed_trust: float = 0.2
    """Share of the trust region that robots have at least after that."""
    tolerance: float = 2e-4
    """Share of the merit that a step must promise, else the robot has settled."""
    weights: PenaltyWeights = PenaltyWeights()
    """Of goals and bounds."""
    solver: SolverSettings = SolverSettings()
    """Of each program."""

    def __post_init__(self) -> None:
        """Refuse values that an option cannot have."""
        check_type("weights", self.weights, PenaltyWeights)
        check_type("solver", self.solver, SolverSettings)
        for name in ("max_sweeps", "max_tightenings"):
            check_integer(name, getattr(self, name), at_least=0)
        for name in (
            "trust_position",
            "trust_speed",
            "trust_control",
            "grow",
            "shrink",
            "least_trust",
            "renewed_trust",
            "tolerance",
        ):
            check_number(name, getattr(self, name), at_least=0.0)
        check_type("weights", self.weights, PenaltyWeights)
        check_type("solver", self.solver, SolverSettings)


@dataclass(frozen=True)
class StepRecord:
    """One robot's program: what was asked, what came of it. Files of plans keep these names."""

    sweep: int  # Which time all robots are planned, from 0
    robot: int  # Index of the robot
    status: str  # The solver's status
    iterations: int  # The solver's iterations
    step_ms: float  # Time for derivatives, program and solution, ms
    trust: float  # Share of the trust region that was allowed
    promised: float  # Predicted reduction of the merit, by the linearised program
    gained: float
    """Actual reduction of the team's merit on the nonlinear model; negative: an increase."""
    taken: bool  # Whether the step was accepted
    merit: float  # The team's merit afterwards


@dataclass(frozen=True)
class RefinementResult:
    """The result of stage 2."""

    trajectories: ways.Trajectories  # The best motions found
    history: tuple[StepRecord, ...]  # Every program, in order
    converged: bool  # Whether all robots have settled: not yet that the plan keeps its bounds
    out_of_time: bool  # Whether it ended at the deadline
    reason: str  # Why it ended, in words


class _Refiner:
    """The state of one refinement."""

    def __init__(
        self, problem: PlanningProblem, motions: ways.Trajectories, options: RefinementOptions
    ) -> None:
        team = len(problem.team)
        self.problem, self.motions, self.options = problem, motions, options
        self.force_bounds, self.tightened = problem.bounds.force_bounds(problem.team), 0
        self.trust, self.settled = np.ones(team), np.zeros(team, dtype=np.bool_)
        self.history: list[StepRecord] = []
        shape = (motions.steps, len(problem.axes), team - 1)
        self.programs = [RobotProgram(*shape, options.weights, options.solver) for _ in range(team)]
        self.evaluate()

    def evaluate(self) -> None:
        """The merit of the present motions under the present force bounds."""
        self.terms = merit_terms(self.problem, self.motions, self.force_bounds)
        self.merit = self.terms.team(self.options.weights)

    def tighten(self) -> bool:
        """Lower the bounds of forces that are exceeded between knots; says whether any was."""
        bounds = self.problem.bounds.force_bounds(self.problem.team)
        peak = _force_excess(self.problem, self.motions, ways.CHECKED_FRACTIONS, bounds).max(
            axis=(0, 1)
        )
        excess = 1.0 + np.maximum(peak, 0.0)
        if self.tightened == self.options.max_tightenings or excess.max() < 1.0 + _NEARLY:
            return False
        self.tightened += 1
        margin = np.where(excess > 1.0, 1.0 + _NEARLY, 1.0)
        self.force_bounds = self.force_bounds / (excess * margin)
        self.settled[:], self.trust[:] = False, np.maximum(self.trust, self.options.renewed_trust)
        self.evaluate()
        return True

    def step(self, sweep: int, robot: int) -> None:
        """Solve one robot's program, and take the step if the team gains by it."""
        began, options, trust = time.perf_counter(), self.options, float(self.trust[robot])
        convex = convexify(
            self.problem,
            self.motions,
            robot,
            (trust * options.trust_position, trust * options.trust_speed),
            trust * options.trust_control,
            self.force_bounds,
        )
        solution = self.programs[robot].solve(convex)
        spent = time.perf_counter() - began
        own = self.terms.robot(robot, options.weights)
        promised = own - solution.objective if solution.usable else 0.0
        gained = self._try(robot, solution)
        taken = gained > 0.0
        little = options.tolerance * max(self.merit, 1.0)
        tiny = trust * options.shrink < options.least_trust
        self.settled[robot] = solution.usable and (promised < little or (not taken and tiny))
        if taken and gained > little:
            self.settled[:] = False  # others may gain by it now
        change = options.grow if taken else options.shrink
        if not solution.usable:
            change = options.grow  # the trust region was too small to hold a solution
        self.trust[robot] = min(1.0, max(trust * change, options.least_trust))
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
        """Take the step if the team's merit falls; returns by how much it falls or would."""
        if not solution.usable:
            return 0.0
        velocity = solution.states[:, len(self.problem.axes) :]
        motions = with_velocity(self.problem, self.motions, robot, velocity)
        terms = merit_terms(self.problem, motions, self.force_bounds)
        merit = terms.team(self.options.weights)
        gained = self.merit - merit
        if gained > 0.0:
            self.motions, self.terms, self.merit = motions, terms, merit
        return gained


def refine(
    problem: PlanningProblem,
    initial: ways.Trajectories,
    rng: np.random.Generator,
    options: RefinementOptions | None = None,
    deadline: float = float("inf"),
    watch: Callable[[StepRecord], None] | None = None,
) -> RefinementResult:
    """Refine motions until no robot can improve the team's plan, or the deadline has passed.

    The initial ones begin at the starts, and may miss goals and break bounds; `watch` is called
    after every program.
    """
    state = _Refiner(problem, initial, options or RefinementOptions())
    out_of_time = False
    for sweep in range(state.options.max_sweeps):
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
        reason = "no robot's program promises an improvement any more"
    elif out_of_time:
        reason = "the time limit was reached"
    else:
        reason = f"the merit still fell after {state.options.max_sweeps} sweeps"
    return RefinementResult(state.motions, tuple(state.history), converged, out_of_time, reason)


def with_velocity(
    problem: PlanningProblem, motions: ways.Trajectories, robot: int, velocity: FloatArray
) -> ways.Trajectories:
    """The motions with one robot flying at other velocities (T + 1, D)."""
    states = motions.states.copy()
    new = np.zeros((len(velocity), 3))
    new[:, list(problem.axes)] = velocity
    new[0] = states[0, robot, 3:]
    states[:, robot, 3:] = new
    states[1:, robot, :3] = ways.integrate_velocity(states[0, robot, :3], new, motions.dt)[1:]
    return ways.trajectories_through(problem, states)
