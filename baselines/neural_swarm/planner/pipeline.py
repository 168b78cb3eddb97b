"""`plan_swarm`: both stages of Algorithm 1 in one call."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from swarm_envs.arguments import typed
from swarm_envs.baselines.neural_swarm.planner.ao_rrt import Loop, SearchConfig, search
from swarm_envs.baselines.neural_swarm.planner.convex_program import Weights
from swarm_envs.baselines.neural_swarm.planner.plan import STATUSES, SwarmPlan
from swarm_envs.baselines.neural_swarm.planner.problem import (
    Plane,
    PlanningBounds,
    PlanningProblem,
    check_positive,
)
from swarm_envs.baselines.neural_swarm.planner.scp import (
    Refinement,
    RefinementOptions,
    StepRecord,
    measure,
    refine,
)
from swarm_envs.baselines.neural_swarm.planner.trajectories import (
    Trajectories,
    trajectories_through,
)
from swarm_envs.baselines.neural_swarm.planner.verify import PlanCheck, check_plan
from swarm_envs.errors import check_array, check_integer
from swarm_envs.interactions import InteractionModel, load
from swarm_envs.trajectories import rest_to_rest
from swarm_envs.vehicles import Team, parse_team


@typed
def straight_lines(
    problem: PlanningProblem, steps: int | None = None, bend: npt.ArrayLike | None = None
) -> Trajectories:
    """Motions straight from starts to goals, all at once: a guess for stage 2 to refine.

    Args:
        problem: what is planned.
        steps: number of steps T; None for as many as the problem allows.
        bend: (N, 3) by how much each robot swerves half way, m; None for not at all.

    Raises:
        ValueError: the bend has another shape, or there is no step.
    """
    count = problem.steps if steps is None else check_integer("steps", steps, 1)
    aside = np.zeros((len(problem.team), 3)) if bend is None else bend
    swerve = 4.0 * check_array("bend", aside, problem.starts.shape, "(N, 3), m")
    time = np.arange(count + 1) * problem.dt
    progress = rest_to_rest(np.zeros(3), np.ones(3), count * problem.dt, time)
    share, rate = progress.position[:, None], progress.velocity[:, None]
    way = problem.goals - problem.starts
    return _flown(problem, rate * (way + swerve * (1.0 - 2.0 * share)))


def bent_lines(
    problem: PlanningProblem, rng: np.random.Generator, tries: int = 30, size: float = 0.4
) -> Trajectories:
    """The best of some lines with random bends, by the merit of stage 2.

    Args:
        problem: what is planned.
        rng: draws the bends.
        tries: how many are looked at.
        size: standard deviation of the bends, m.
    """
    weights, best, least = Weights(), None, np.inf
    for _ in range(tries):
        bend = np.zeros_like(problem.starts)
        bend[:, problem.axes] = size * rng.standard_normal((len(bend), len(problem.axes)))
        lines = straight_lines(problem, bend=bend)
        merit = measure(problem, lines).team(weights)
        if merit < least:
            best, least = lines, merit
    assert best is not None
    return best


def _flown(problem: PlanningProblem, velocity: npt.NDArray[np.float64]) -> Trajectories:
    """Motions from the starts at velocities (T + 1, N, 3), m/s, that are at rest at first."""
    way = np.cumsum(0.5 * problem.dt * (velocity[1:] + velocity[:-1]), axis=0)
    position = problem.starts + np.concatenate([np.zeros_like(way[:1]), way])
    return trajectories_through(problem, np.concatenate([position, velocity], axis=-1))


_LEAST_TIME = 1e-3
"""A search gets at least so much time, s: then it plans one tree and finds the time is up."""


def first_motions(
    problem: PlanningProblem,
    config: SearchConfig,
    rng: np.random.Generator,
    deadline: float,
    watch: Callable[[str], None],
) -> tuple[Trajectories, dict[str, Any]]:
    """Search motions for all robots by stage 1; bent lines if none are found.

    Args:
        problem: what is planned.
        config: options of stage 1.
        rng: of everything drawn.
        deadline: `time.monotonic()` at which the search ends, s.
        watch: told in words how the search goes.

    Returns:
        The motions, and what the search says of itself.
    """

    def say(loop: Loop) -> None:
        watch(f"search: cost {loop.cost:.3g} after {loop.iterations} iterations")

    left = deadline - time.monotonic()
    limits = [x for x in (config.time_limit, max(left, _LEAST_TIME)) if x is not None]
    limited = replace(config, time_limit=min(limits)) if np.isfinite(min(limits)) else config
    found = search(problem, limited, rng, say)
    about = {
        "found": found.trajectories is not None,
        "stop": found.stop,
        "loops": len(found.loops),
        "iterations": found.iterations if found.loops else 0,
    }
    if found.trajectories is not None:
        return found.trajectories, about
    return bent_lines(problem, rng), about


SEARCH = SearchConfig(iterations=40_000)
"""Options of stage 1: stage 2 needs a good class of motions, not the best motions of it."""
ATTEMPTS = 3
"""How often both stages are run, each time drawn anew, until a plan keeps everything."""
_SEARCH_SHARE = 0.6
"""Of the time that is left, what stage 1 may take."""
_NEXT_TO_NOTHING = 1e-9


@typed
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
    """Plan the motions of a team that blows on itself (Neural-Swarm2, Algorithm 1).

    Args:
        starts: (N, 3) start positions, m; robots rest there.
        goals: (N, 3) goal positions, m; robots rest there at the end.
        team: the N vehicles, such as `"SSL"`.
        model: what the planner believes of the forces: a model, its name or path; None or
            `"none"` for a planner that knows of none.
        bounds: what the plan must keep to; None for the paper's.
        seed: of everything drawn. Without a time limit, same seed, same plan.
        plane: `"xyz"`, or `"yz"` for motion in one vertical plane.
        dt: time between knots, s.
        max_duration: the latest end of the plan, s.
        time_limit: seconds after which the best plan so far is returned, marked as not converged;
            None for none.
        attempts: how often to begin anew while a plan breaks a bound.
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
    began = time.monotonic()
    if time_limit is not None:
        check_positive("time_limit", time_limit)
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
    check_integer("seed", seed, 0)
    if initial is not None:
        check_initial(problem, initial)
    deadline = math.inf if time_limit is None else began + time_limit
    with _Progress(progress) as bar:
        best: SwarmPlan | None = None
        for attempt in range(check_integer("attempts", attempts, 1)):
            plan = _attempt(
                problem, seed, attempt, initial, search or SEARCH, options, deadline, bar
            )
            if best is None or _rank(plan) < _rank(best):
                best = plan
            if best.converged or initial is not None or time.monotonic() > deadline:
                break
    assert best is not None
    return best


def check_initial(problem: PlanningProblem, initial: Trajectories) -> None:
    """Refuse motions that are no guess for this problem.

    Raises:
        ValueError: another team, time step or starts, or too long; the message says which.
    """
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
    if missed > _NEXT_TO_NOTHING:
        raise ValueError(
            f"initial begins {missed:.3g} (m, m/s) away from rest at the starts; its first state "
            "must be that"
        )


def _attempt(
    problem: PlanningProblem,
    seed: int,
    attempt: int,
    initial: Trajectories | None,
    config: SearchConfig,
    options: RefinementOptions | None,
    deadline: float,
    bar: _Progress,
) -> SwarmPlan:
    rng, began = np.random.default_rng([seed, attempt]), time.monotonic()
    search: dict[str, Any] = {}
    if initial is None:
        limit = began + _SEARCH_SHARE * (deadline - began)
        initial, search = first_motions(problem, config, rng, limit, bar.search)
    else:
        initial = trajectories_through(problem, initial.states)
    searched = time.monotonic()
    refined = refine(problem, initial, rng, options, deadline, bar.refine)
    check = check_plan(problem, refined.trajectories)
    status, reason = _outcome(refined, check)
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
        seed=seed,
        status=status,
        reason=reason,
        check=check,
        search=search | {"attempt": attempt},
        history=refined.history,
        seconds={"stage 1": searched - began, "stage 2": time.monotonic() - searched},
    )


def _outcome(refined: Refinement, check: PlanCheck) -> tuple[str, str]:
    """Status and reason of a plan."""
    lacks = "; ".join(check.shortcomings())
    converged, time_limit, iteration_limit, not_feasible = STATUSES
    if refined.converged:
        status = not_feasible if lacks else converged
    else:
        status = time_limit if refined.out_of_time else iteration_limit
    return status, f"{refined.reason}; {lacks}" if lacks else refined.reason


def _rank(plan: SwarmPlan) -> tuple[bool, bool, float]:
    """What orders plans, the best first: converged, feasible, cheap."""
    merit = plan.history[-1].merit if plan.history else math.inf
    return not plan.converged, bool(plan.check.shortcomings()), merit


class _Progress:
    """A bar over the programs of stage 2 that also says what stage 1 does; silent if not shown."""

    def __init__(self, shown: bool) -> None:
        from tqdm import tqdm

        self._bar: Any = tqdm(desc="plan", unit="program", disable=not shown)

    def __enter__(self) -> _Progress:
        return self

    def __exit__(self, *_: object) -> None:
        self._bar.close()

    def search(self, words: str) -> None:
        """Stage 1 reports."""
        self._bar.set_postfix_str(words)

    def refine(self, record: StepRecord) -> None:
        """Stage 2 has solved a program."""
        self._bar.set_postfix_str(f"sweep {record.sweep}, merit {record.merit:.4g}", refresh=False)
        self._bar.update()
