"""First motions without a search: straight lines, bent aside if asked."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from swarm_envs.arguments import typed
from swarm_envs.baselines.neural_swarm.planner.merit import measure
from swarm_envs.baselines.neural_swarm.planner.problem import PlanningProblem
from swarm_envs.baselines.neural_swarm.planner.solution import Weights
from swarm_envs.baselines.neural_swarm.planner.trajectories import (
    Trajectories,
    trajectories_through,
)
from swarm_envs.errors import check_array, check_integer
from swarm_envs.trajectories import rest_to_rest


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
