"""The columns of the table of episodes, and the metrics of an agent on a task.

An episode's score in [0, 1] makes episodes of different tasks comparable:

- `time` (swap): success weighted by completion time (Yokoyama, Ha and Batra, IROS 2021): the
  shortest possible time of the slowest drone to its goal, over its actual time; 0 without success.
- `shapes` (formation): the fraction of the shapes that were reached.
- `tracking` (ring): 1 minus the worst error over 0.15 m, the bound of success; 0 without success.
- `own` (crowd, pursuit, gates): the task's own score over that of `full_score`, at most 1; with or
  without success.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, Literal

import numpy as np

from swarm_envs.agents.evaluation import (
    COLLISIONS,
    Episode,
    bootstrap_interval,
    collided,
    interquartile_mean,
    rate_interval,
)
from swarm_envs.baselines.neural_swarm.planner.problem import shortest_time
from swarm_envs.envs.view import View
from swarm_envs.tasks.base import ACCELERATION_LIMIT, SPEED_LIMIT, Success, TrackingSuccess
from swarm_envs.training.scoreboard.tasks import ScoredTask, make_scored

__all__ = ["COLUMNS", "METRICS", "EpisodeRow", "fastest_times", "row_of", "values_of"]

EpisodeRow = dict[str, Any]  # A row of the table of episodes: values by column
_SAMPLES_S = 1.0 / 48.0
_NUMBERS = (
    "minimum_separation_m",
    "worst_tracking_error_m",
    "rms_tracking_error_m",
    "worst_height_error_m",
    "worst_force_g",
    "fraction_over_force_bound",
    "energy_j",
    "fraction_outside_measured_range",
    "length_s",
    *COLLISIONS.values(),
    "near_misses",
    "force_bound_violations",
    "stages_reached",
)
COLUMNS: Mapping[str, str] = MappingProxyType(
    {
        "agent": "string",
        "task": "string",
        "seed": "int64",
        "episode": "int64",  # Index of the seed
        "drones": "int64",
        "refusal": "string",  # The error of an agent's reset that refused the episode
        **dict.fromkeys(("success", "collided", "near_miss"), "bool_"),
        **dict.fromkeys(("score", "makespan_s", *_NUMBERS), "float64"),
        **dict.fromkeys(("act_us_p50", "act_us_p99"), "float64"),  # If decisions were timed
    }
)
"""Columns of the table of episodes, and their types in Arrow; null without a value."""


@dataclass(frozen=True)
class Metric:
    """A statistic of the episodes of an agent on a task."""

    name: str
    statistic: Literal["rate", "mean", "iqm", "median"] = "iqm"
    column: str = ""
    """The column of the table of episodes; empty for the metric's name."""
    of_successes: bool = False
    """True if only successful episodes count."""


METRICS = (
    Metric("success_rate", "rate", "success"),
    Metric("score"),
    Metric("collision_rate", "rate", "collided"),
    Metric("near_miss_rate", "rate", "near_miss"),
    Metric("minimum_separation_m"),
    Metric("makespan_s", of_successes=True),
    Metric("worst_tracking_error_m"),
    Metric("rms_tracking_error_m"),
    Metric("worst_height_error_m"),
    Metric("worst_force_g"),
    Metric("fraction_over_force_bound", "mean"),
    Metric("energy_j", of_successes=True),
    Metric("fraction_outside_measured_range", "mean"),
    Metric("act_us_p50", "median"),
    Metric("act_us_p99", "median"),
)
"""The metrics of the benchmark in order; docs/benchmark.md explains them."""


def row_of(
    task: ScoredTask, agent: str, index: int, episode: Episode, fastest_s: float | None
) -> EpisodeRow:
    """Return an episode's row; the metrics of an episode that the agent refused are null.

    Args:
        task: the task.
        agent: the name of the agent.
        index: the index of the seed.
        episode: the episode, from `swarm_envs.agents.evaluation`.
        fastest_s: the shortest time of its seed, from `fastest_times`, for the score `time`.
    """
    metrics, act_us = episode["metrics"], episode["act_us"]
    row: EpisodeRow = dict.fromkeys(COLUMNS)
    row |= {"agent": agent, "task": task.id, "drones": task.drones}
    row |= {"seed": episode["seed"], "episode": index}
    row |= {"success": False, "collided": False, "near_miss": False, "score": 0.0}
    if "refused" in metrics:
        return row | {"refusal": metrics["refused"]}
    row["success"] = bool(metrics["success"])
    row["collided"] = collided(metrics)
    row["near_miss"] = not row["collided"] and metrics["near_misses"] > 0
    row["score"] = score_of(task, metrics, fastest_s)
    row["makespan_s"] = _makespan(task, metrics) if row["success"] else None
    row |= {name: metrics[name] for name in _NUMBERS}
    if act_us:
        row["act_us_p50"], row["act_us_p99"] = np.percentile(act_us, [50.0, 99.0]).tolist()
    return row


def _makespan(task: ScoredTask, metrics: Mapping[str, Any]) -> float | None:
    """Return the completion time, s; None for tasks that last until the time limit."""
    if task.score in ("tracking", "own"):
        return None
    found: float = metrics["length_s" if task.score == "shapes" else "time_to_goal_s"]
    return found


def values_of(rows: Sequence[EpisodeRow]) -> dict[str, dict[str, Any]]:
    """Return `value` and `interval` of every metric of an agent's episodes of a task."""
    return {metric.name: _value(metric, rows) for metric in METRICS}


def _value(metric: Metric, rows: Sequence[EpisodeRow]) -> dict[str, Any]:
    column = metric.column or metric.name
    if metric.statistic == "rate":
        count = sum(row[column] for row in rows)
        return {"value": count / len(rows), "interval": rate_interval(count, len(rows))}
    counted = [row for row in rows if row["success"]] if metric.of_successes else rows
    values = np.array([r[column] for r in counted if r[column] is not None], np.float64)
    if not len(values):
        return {"value": None, "interval": None}
    if metric.statistic == "median":
        return {"value": float(np.median(values)), "interval": None}
    statistic = np.mean if metric.statistic == "mean" else interquartile_mean
    return {"value": float(statistic(values)), "interval": bootstrap_interval(values, statistic)}


def fastest_times(task: ScoredTask, seeds: Sequence[int]) -> dict[int, float]:
    """Return, by seed, the shortest time in which the slowest drone can reach its goal, s.

    It is the time of rest-to-rest motion on a straight line at the limits of acceleration and
    speed, and at least that of a moving reference of the task.
    """
    env = make_scored(task.environment, task.setting)
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
    late = 0.0
    for time in times.tolist():
        off = np.linalg.norm(view.reference(time).position - view.goals, axis=1)
        if off.max() >= Success().radius:
            late = time + _SAMPLES_S
    return max(alone, late)


def score_of(task: ScoredTask, metrics: Mapping[str, Any], fastest_s: float | None = None) -> float:
    """Return the score of an episode.

    Args:
        task: the task.
        metrics: the metrics of the episode, from `swarm_envs.envs.evaluation.metrics`.
        fastest_s: the shortest time of its seed, for the score `time`.
    """
    if task.score == "shapes":
        return float(metrics["stages_reached"]) / float(metrics["stages"])
    if task.full_score is not None:
        name, full = task.full_score
        return min(1.0, float(metrics[name]) / full)
    if not metrics["success"]:
        return 0.0
    if task.score == "tracking":
        return max(0.0, 1.0 - metrics["worst_tracking_error_m"] / TrackingSuccess().worst_error)
    assert fastest_s is not None
    return fastest_s / max(fastest_s, metrics["time_to_goal_s"])
