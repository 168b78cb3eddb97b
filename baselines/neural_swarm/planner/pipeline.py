"""`plan_swarm`: both stages of Algorithm 1 in one call, from a problem to a verified plan."""

from __future__ import annotations

import math
import time
from dataclasses import replace
from pathlib import Path
from typing import Any, get_args

import numpy as np
import numpy.typing as npt
from tqdm import tqdm

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
    RefinementOptions,
    StepRecord,
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
"""Options of stage 1: stage 2 needs a good class of motions, not the best motions of it."""
ATTEMPTS = 3
"""How often both stages are run, each time sampled again, until a plan keeps everything."""
_SEARCH_SHARE = 0.6  # of the time that is left: what stage 1 may take
_SHORTEST_SEARCH_S = 1e-3  # then it plans one tree and finds the time is up
_GUESSES, _BEND_M = 30, 0.4  # bent lines that are drawn, and their standard deviation


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
    options: RefinementOptions | None = None,
    progress: bool = False,
) -> SwarmPlan:
    """Plan the motions of a team under interaction forces (Neural-Swarm2, Algorithm 1).

    Args:
        starts: (N, 3) start positions, m; robots rest there.
        goals: (N, 3) goal positions, m; robots rest there at the end.
        team: the N vehicles, such as `"SSL"`.
        model: the planner's model of the forces, its name or path; None or `"none"` for a planner
            that knows of none.
        bounds: what the plan must keep to; None for the paper's.
        seed: of everything drawn. Without a time limit, same seed, same plan.
        plane: `"xyz"`, or `"yz"` for motion in one vertical plane.
        dt: time between knots, s.
        max_duration: the latest end of the plan, s.
        time_limit: seconds after which the best plan so far is returned, marked as not converged;
            None for none.
        attempts: how often to restart while a plan breaks a bound.
        initial: motions to refine instead of those of stage 1.
        search: options of stage 1; None for the defaults.
        options: of stage 2; None for the defaults.
        progress: show a bar.

    Returns:
        The plan; look at `plan.converged` and `plan.reason` before you fly it.

    Raises:
        ValueError: the problem cannot be solved, whatever the plan, or an argument has no meaning.
        ImportError: osqp is missing.
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
    with tqdm(desc="plan", unit="program", disable=not progress) as bar:
        for attempt in range(attempts):
            drawn = (seed, attempt)
            plans.append(_run(problem, drawn, initial, search or SEARCH, options, deadline, bar))
            if plans[-1].converged or initial is not None or time.monotonic() > deadline:
                break

    def rank(plan: SwarmPlan) -> tuple[bool, bool, float]:
        """What orders plans, the best first: converged, feasible, cheap."""
        merit = plan.history[-1].merit if plan.history else math.inf
        return not plan.converged, bool(plan.check.shortcomings()), merit

    return min(plans, key=rank)


def _check_initial(problem: PlanningProblem, initial: Trajectories) -> None:
    """Refuse motions that are no guess for this problem: another team, time step or starts."""
    team, steps = len(problem.team), initial.steps
    check_array("initial.states", initial.states, (steps + 1, team, 6))
    check_array("initial.controls", initial.controls, (steps, team, 3))
    if not math.isclose(initial.dt, problem.dt, rel_tol=1e-9):
        raise ValueError(f"initial.dt is {initial.dt} s, but dt is {problem.dt} s; give both alike")
    if not 1 <= steps <= problem.steps:
        raise ValueError(
            f"initial has {steps} steps, but max_duration = {problem.max_duration:g} s allows 1 to "
            f"{problem.steps}"
        )
    rest = np.concatenate([problem.starts, np.zeros((team, 3))], axis=1)
    missed = float(np.abs(initial.states[0] - rest).max())
    if missed > ROUNDING:
        raise ValueError(
            f"initial begins {missed:.3g} (m, m/s) away from rest at the starts; its first state "
            "must be that"
        )


def _run(
    problem: PlanningProblem,
    drawn: tuple[int, int],
    initial: Trajectories | None,
    search: SearchConfig,
    options: RefinementOptions | None,
    deadline: float,
    bar: Any,
) -> SwarmPlan:
    """Both stages of an attempt, whose draws come from (seed, attempt), and the check."""
    began, rng = time.monotonic(), np.random.default_rng(drawn)
    about: dict[str, Any] = {}

    def show(record: StepRecord) -> None:
        bar.set_postfix_str(f"sweep {record.sweep}, merit {record.merit:.4g}", refresh=False)
        bar.update()

    if initial is None:
        left = _SEARCH_SHARE * (deadline - began)
        limit = min(search.time_limit or math.inf, max(left, _SHORTEST_SEARCH_S))
        config = replace(search, time_limit=limit) if limit < math.inf else search
        initial, about = _first_motions(problem, config, rng, bar)
    else:
        initial = trajectories_through(problem, initial.states)
    searched = time.monotonic()
    refined = refine(problem, initial, rng, options, deadline, show)
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
    problem: PlanningProblem, config: SearchConfig, rng: np.random.Generator, bar: Any
) -> tuple[Trajectories, dict[str, Any]]:
    """Motions of stage 1, or bent lines if it finds none; and what the search did."""

    def show(cost: float, iterations: int) -> None:
        bar.set_postfix_str(f"search: cost {cost:.3g} after {iterations} iterations")

    found = search_team(problem, config, rng, show)
    about = {
        "found": found.trajectories is not None,
        "stop": found.stop,
        "loops": len(found.costs),
        "iterations": found.iterations,
    }
    return found.trajectories or _bent_lines(problem, rng), about


def _bent_lines(problem: PlanningProblem, rng: np.random.Generator) -> Trajectories:
    """The best of some lines with random bends, by the merit of stage 2."""
    limits, guesses = problem.bounds.force_bounds(problem.team), []
    for _ in range(_GUESSES):
        bend = np.zeros_like(problem.starts)
        bend[:, problem.axes] = _BEND_M * rng.standard_normal((len(bend), len(problem.axes)))
        guesses.append(straight_lines(problem, bend=bend))
    return min(guesses, key=lambda m: merit_terms(problem, m, limits).team(PenaltyWeights()))
