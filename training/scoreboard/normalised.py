"""An episode's score in [0, 1], so that episodes of unlike tasks can be put together.

- `time` (swap): success weighted by completion time (Yokoyama, Ha and Batra, IROS 2021): the time
  in which the slowest drone could be at its goal, over the time it took; 0 without success.
- `shapes` (formation): of the shapes the share that was reached.
- `tracking` (ring): 1 less the worst error over 0.15 m, at which success ends; 0 without success.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from swarm_envs import make
from swarm_envs.baselines.neural_swarm.planner.problem import shortest_time
from swarm_envs.envs.view import View
from swarm_envs.tasks.base import ACCELERATION_LIMIT, SPEED_LIMIT, Success, TrackingSuccess
from swarm_envs.training.scoreboard.tasks import ScoredTask

LABELS = {
    "time": "success weighted by completion time",
    "shapes": "share of shapes reached",
    "tracking": "margin to the tracking limit",
}
"""What a score is, in a few words."""
_SAMPLES_S = 1.0 / 48.0


def fastest_times(task: ScoredTask, seeds: Sequence[int]) -> dict[int, float]:
    """By seed, the time in which the slowest drone could be within reach of its goal, s.

    From rest to rest on a straight line at the limits of acceleration and speed; where the task
    gives a moving reference, no less than that takes, as nobody is asked to be faster.
    """
    env = make(task.environment, **task.setting)
    try:
        times = {}
        for seed in seeds:
            env.reset(seed=seed)
            times[seed] = _fastest(env.view)
        return times
    finally:
        env.close()


def _fastest(view: View) -> float:
    away = np.linalg.norm(view.goals - view.state.position, axis=1)
    alone = float(shortest_time(away, SPEED_LIMIT, ACCELERATION_LIMIT).max())
    if not view.reference_moves:
        return alone
    times = np.arange(0.0, view.horizon_s, _SAMPLES_S)
    late = [t for t in times.tolist() if _off(view, t) >= Success().radius]
    return max(alone, late[-1] + _SAMPLES_S if late else 0.0)


def _off(view: View, time: float) -> float:
    """How far the reference is from the goals at most at a time, m."""
    apart: float = np.linalg.norm(view.reference(time).position - view.goals, axis=1).max()
    return apart


def score_of(task: ScoredTask, metrics: Mapping[str, Any], fastest_s: float | None = None) -> float:
    """The score of an episode.

    Args:
        task: what was flown.
        metrics: of the episode, as of `swarm_envs.envs.judge.metrics`.
        fastest_s: of its seed, where the score is of time.
    """
    if task.score == "shapes":
        return float(metrics["stages_reached"]) / float(metrics["stages"])
    if not metrics["success"]:
        return 0.0
    if task.score == "tracking":
        return max(0.0, 1.0 - metrics["worst_tracking_error_m"] / TrackingSuccess().worst_error)
    assert fastest_s is not None
    return fastest_s / max(fastest_s, metrics["time_to_goal_s"])
