"""The motions that stage 2 begins with: those of stage 1, or lines where it finds none."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from swarm_envs.baselines.neural_swarm.planner.ao_rrt import Loop, SearchConfig, search
from swarm_envs.baselines.neural_swarm.planner.guess import bent_lines
from swarm_envs.baselines.neural_swarm.planner.problem import PlanningProblem
from swarm_envs.baselines.neural_swarm.planner.trajectories import Trajectories

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
