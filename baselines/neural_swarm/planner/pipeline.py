"""`plan_swarm`: both stages of Algorithm 1 in one call, from a problem to a verified plan."""

from __future__ import annotations

import math
import time
from dataclasses import replace
from pathlib import Path
from typing import Any, get_args

import numpy as np
import numpy.typing as npt

from swarm_envs.baselines.neural_swarm.planner.ao_rrt import SearchConfig
from swarm_envs.baselines.neural_swarm.planner.ao_rrt import search as search_team
from swarm_envs.baselines.neural_swarm.planner.convex_program import PenaltyWeights
from swarm_envs.baselines.neural_swarm.planner.plan import STATUSES, SwarmPlan
from swarm_envs.baselines.neural_swarm.planner.problem import (
    ROUNDING,
    Plane,
    PlanningBounds,
    PlanningProblem,
)
from swarm_envs.baselines.neural_swarm.planner.scp import (
    merit_terms,
    refine,
)
from swarm_envs.baselines.neural_swarm.planner.trajectories import (
    Trajectories,
    straight_lines,
    trajectories_through,
)
from swarm_envs.baselines.neural_swarm.planner.verify import check_plan
from swarm_envs.errors import check_array, check_integer, check_name, check_number
from swarm_envs.interactions import InteractionModel, load
from swarm_envs.vehicles import Team, parse_team

__all__ = ["plan_swarm"]

SEARCH = SearchConfig(iterations=40_000)
"""The options of stage 1: stage 2 needs a good class of motions, not the best motions of it."""
ATTEMPTS = 3
"""The most runs of both stages, with new random draws, until a plan meets all requirements."""
_SEARCH_SHARE = 0.6  # Stage 1's share of the time limit
_SHORTEST_SEARCH_S = 1e-3  # Enough for one tree
_GUESSES, _BEND_M = 30, 0.4  # The number of random bent lines, and their standard deviation, m


def plan_swarm(
    starts: npt.ArrayLike,
    goals: npt.ArrayLike,
    team: str | Team,
    model: InteractionModel | str | Path | None,
    bounds: PlanningBounds | None = None,
    seed: int = 0,
    *,
    plane: Plane = "xyz",
    dt: float = 0.1,
    max_duration: float = 5.0,
    time_limit: float | None = None,
    attempts: int = ATTEMPTS,
    initial: Trajectories | None = None,
    search: SearchConfig | None = None,
) -> SwarmPlan:
    """Plan the motions of a team under interaction forces (Neural-Swarm2, Algorithm 1).

    Args:
        starts: The start positions (N, 3), m, at which robots are at rest.
        goals: The goal positions (N, 3), m, at which robots are at rest in the end.
        team: The N vehicles, such as `"SSL"`.
        model: The planner's model of the forces, its name or path; None or `"none"` for no forces.
        bounds: The bounds of the plan; None for the paper's.
        seed: The random seed. Without a time limit, the same seed gives the same plan.
        plane: `"xyz"`, or `"yz"` for motion in one vertical plane.
        dt: The time between knots, s.
        max_duration: The latest end of the plan, s.
        time_limit: The time after which the best plan so far is returned, marked as not converged,
            s; None for no limit.
        attempts: The most attempts until a plan meets all requirements.
        initial: Motions to refine instead of those of stage 1.
        search: The options of stage 1; None for the defaults.

    Returns:
        The plan; check `plan.converged` and `plan.reason` before using it.

    Raises:
        ValueError: The problem has no solution, or an argument is out of range.
        ImportError: osqp is not installed.
    """
    check_integer("seed", seed, at_least=0)
    check_name("plane", plane, get_args(Plane))
    check_number("dt", dt)
    check_number("max_duration", max_duration)
    if time_limit is not None:
        check_number("time_limit", time_limit, above=0.0, unit="s")
    check_integer("attempts", attempts, at_least=1)
    began = time.monotonic()
    problem = PlanningProblem(
        starts=np.asarray(starts),
        goals=np.asarray(goals),
        team=parse_team(team),
        model=load("none" if model is None else model),
        bounds=bounds or PlanningBounds(),
        dt=dt,
        max_duration=max_duration,
        plane=plane,
    )
    if initial is not None:
        _check_initial(problem, initial)
    deadline = math.inf if time_limit is None else began + time_limit
    plans: list[SwarmPlan] = []
    for attempt in range(attempts):
        plans.append(_run(problem, (seed, attempt), initial, search or SEARCH, deadline))
        if plans[-1].converged or initial is not None or time.monotonic() > deadline:
            break

    def rank(plan: SwarmPlan) -> tuple[bool, bool, float]:
        """Return the sort key of a plan: converged, feasible and cheap ones come first."""
        merit = plan.history[-1].merit if plan.history else math.inf
        return not plan.converged, bool(plan.check.shortcomings()), merit

    return min(plans, key=rank)


def _check_initial(problem: PlanningProblem, initial: Trajectories) -> None:
    """Raise ValueError if initial motions do not fit the team, time step or starts."""
    team, steps = len(problem.team), initial.steps
    check_array("initial.states", initial.states, (steps + 1, team, 6))
    check_array("initial.controls", initial.controls, (steps, team, 3))
    if not math.isclose(initial.dt, problem.dt, rel_tol=1e-9):
        raise ValueError(f"initial.dt is {initial.dt} s, but dt is {problem.dt} s; make them equal")
    if not 1 <= steps <= problem.steps:
        raise ValueError(
            f"initial has {steps} steps, but max_duration = {problem.max_duration:g} s allows 1 to "
            f"{problem.steps}"
        )
    rest = np.concatenate([problem.starts, np.zeros((team, 3))], axis=1)
    missed = float(np.abs(initial.states[0] - rest).max())
    if missed > ROUNDING:
        raise ValueError(
            f"initial begins {missed:.3g} (m, m/s) away from rest at the starts, but must begin "
            "there"
        )


def _run(
    problem: PlanningProblem,
    drawn: tuple[int, int],
    initial: Trajectories | None,
    search: SearchConfig,
    deadline: float,
) -> SwarmPlan:
    """Run both stages and the check of an attempt, with random draws by (seed, attempt)."""
    began, rng = time.monotonic(), np.random.default_rng(drawn)
    about: dict[str, Any] = {}
    if initial is None:
        left = _SEARCH_SHARE * (deadline - began)
        limit = min(search.time_limit or math.inf, max(left, _SHORTEST_SEARCH_S))
        config = replace(search, time_limit=limit) if limit < math.inf else search
        initial, about = _first_motions(problem, config, rng)
    else:
        initial = trajectories_through(problem, initial.states)
    searched = time.monotonic()
    refined = refine(problem, initial, rng, deadline=deadline)
    check = check_plan(problem, refined.trajectories)
    lacks = "; ".join(check.shortcomings())
    converged, time_limit, iteration_limit, not_feasible = STATUSES
    status = time_limit if refined.out_of_time else iteration_limit
    if refined.converged:
        status = not_feasible if lacks else converged
    return SwarmPlan(
        team=problem.team,
        starts=problem.starts,
        goals=problem.goals,
        trajectories=refined.trajectories,
        initial=initial,
        bounds=problem.bounds,
        plane=problem.plane,
        model_name=problem.model.name,
        model_fingerprint=problem.model.fingerprint,
        seed=drawn[0],
        status=status,
        reason=f"{refined.reason}; {lacks}" if lacks else refined.reason,
        check=check,
        search=about | {"attempt": drawn[1]},
        history=refined.history,
        seconds={"stage 1": searched - began, "stage 2": time.monotonic() - searched},
    )


def _first_motions(
    problem: PlanningProblem, config: SearchConfig, rng: np.random.Generator
) -> tuple[Trajectories, dict[str, Any]]:
    """Return the motions of stage 1, or bent lines if it finds none; and its statistics."""
    found = search_team(problem, config, rng)
    about = {
        "found": found.trajectories is not None,
        "stop": found.stop,
        "loops": len(found.costs),
        "iterations": found.iterations,
    }
    return found.trajectories or _bent_lines(problem, rng), about


def _bent_lines(problem: PlanningProblem, rng: np.random.Generator) -> Trajectories:
    """Return the best of some lines with random bends, by the merit of stage 2."""
    limits, guesses = problem.bounds.force_bounds(problem.team), []
    for _ in range(_GUESSES):
        bend = np.zeros_like(problem.starts)
        bend[:, problem.axes] = _BEND_M * rng.standard_normal((len(bend), len(problem.axes)))
        guesses.append(straight_lines(problem, bend=bend))
    return min(guesses, key=lambda m: merit_terms(problem, m, limits).team(PenaltyWeights()))
