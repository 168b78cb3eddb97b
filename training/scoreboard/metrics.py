"""What an episode is measured by, and what an agent's episodes of a task add up to.

An episode's score in [0, 1] makes episodes of unlike tasks comparable:

- `time` (swap): success weighted by completion time (Yokoyama, Ha and Batra, IROS 2021): the time
  in which the slowest drone could be at its goal, over the time it took; 0 without success.
- `shapes` (formation): of the shapes the share that was reached.
- `tracking` (ring): 1 less the worst error over 0.15 m, at which success ends; 0 without success.
- `own` (crowd, pursuit, gates): the task's own score over the one that the row calls full, at most
  1; with or without success.
"""

from __future__ import annotations

import csv
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np

from swarm_envs.agents.evaluation import (
    COLLISIONS,
    Episode,
    bootstrap_interval,
    interquartile_mean,
    rate_interval,
)
from swarm_envs.baselines.neural_swarm.planner.problem import shortest_time
from swarm_envs.envs.view import View
from swarm_envs.files import pyarrow, written_whole
from swarm_envs.tasks.base import ACCELERATION_LIMIT, SPEED_LIMIT, Success, TrackingSuccess
from swarm_envs.training.scoreboard.board import Metric
from swarm_envs.training.scoreboard.tasks import ScoredTask, make_scored

EpisodeRow = dict[str, Any]  # An episode as a row of the table of episodes: columns by name
TableForm = Literal["parquet", "csv"]  # How tables of episodes are written
_TEXT = ("task_id", "agent", "refusal")
_FLAGS = ("refused", "success", "collided", "near_miss")
_WHOLE = ("drones", "seed", "episode", "decisions")
LABELS = {
    "mixed": "score of each task",
    "time": "success weighted by completion time",
    "shapes": "share of shapes reached",
    "tracking": "margin to the tracking limit",
    "own": "share of a full score",
}
"""What a score is, in a few words."""
_SAMPLES_S = 1.0 / 48.0


@dataclass(frozen=True)
class Measured(Metric):
    """A metric, and how it is made of the table of episodes."""

    column: str = ""
    """Of the table of episodes, if it has another name; times of decisions are not in it."""
    statistic: Literal["rate", "mean", "iqm", "percentile"] = "iqm"  # What is shown of the column
    of: Literal["all", "successes"] = "all"  # Of which episodes


METRICS = (
    Measured("success_rate", "success", "%", "higher",
             "Share of episodes in which the team did its task; Wilson's interval.",
             "success", "rate"),
    Measured("score", "score", "", "higher",
             "In [0, 1]: swap, columns and delivery, success weighted by completion time; "
             "formation, share of shapes reached; ring, margin to the tracking limit; crowd, "
             "pursuit and gates, share of a full score."),
    Measured("collision_rate", "collided", "%", "lower",
             "Share of episodes in which any drone hit another, the floor, a wall, or tumbled.",
             "collided", "rate"),
    Measured("near_miss_rate", "near miss", "%", "lower",
             "Share of episodes without a crash in which two drones came within 1.5 times the sum "
             "of their radii.", "near_miss", "rate"),
    Measured("minimum_separation_m", "separation", "m", "higher",
             "Smallest distance between two drones."),
    Measured("makespan_s", "makespan", "s", "lower",
             "Time until the whole team was done, of successes: swap, the last arrival; "
             "formation, the last shape held.", of="successes"),
    Measured("worst_tracking_error_m", "worst error", "m", "lower",
             "Largest distance of any drone to its reference, where the task gives a moving one."),
    Measured("rms_tracking_error_m", "RMS error", "m", "lower",
             "Root mean square distance to the reference, where the task gives a moving one."),
    Measured("worst_height_error_m", "height error", "m", "lower",
             "Largest vertical distance of any drone to its reference: what downwash does."),
    Measured("worst_force_g", "worst force", "g", "lower",
             "Largest force of the air on any drone."),
    Measured("fraction_over_force_bound", "over force bound", "%", "lower",
             "Share of drone-steps with a vertical force above 5 g (small) or 10 g (large).",
             statistic="mean"),
    Measured("energy_j", "energy", "J", "lower",
             "Ideal induced energy of all rotors, of successes.", of="successes"),
    Measured("fraction_outside_measured_range", "extrapolated", "%", "neither",
             "Share of drone-steps whose force lies outside what was measured: trust these less.",
             statistic="mean"),
    Measured("act_us_p50", "decision p50", "µs", "lower",
             "Median time of one decision for the whole team, on the machine of the manifest.",
             statistic="percentile"),
    Measured("act_us_p99", "decision p99", "µs", "lower",
             "99th percentile of the same: replanning counts here, planning at reset does not.",
             statistic="percentile"),
)  # fmt: skip
"""Columns of the scoreboard, in order."""

_COUNTS = (*COLLISIONS.values(), "near_misses", "force_bound_violations", "stages_reached")
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
)


def row_of(
    task: ScoredTask, agent: str, index: int, episode: Episode, fastest_s: float | None
) -> EpisodeRow:
    """An episode's row; of one that the agent refused, all but who and what is missing or none.

    Args:
        task: what was flown.
        agent: who flew.
        index: of the seed among the frozen ones.
        episode: as of `swarm_envs.agents.evaluation`.
        fastest_s: of its seed, as of `fastest_times`, where the score is of time.
    """
    metrics = episode["metrics"]
    about = {"task_id": task.id, "agent": agent, "drones": task.drones, "seed": episode["seed"]}
    refused = "refused" in metrics
    collided = not refused and any(metrics[name] for name in COLLISIONS.values())
    row: EpisodeRow = {**about, "episode": index, "refused": refused}
    row["success"] = not refused and bool(metrics["success"])
    row["collided"] = collided
    row["near_miss"] = not refused and not collided and metrics["near_misses"] > 0
    row["score"] = 0.0 if refused else score_of(task, metrics, fastest_s)
    row["makespan_s"] = _makespan(task, metrics) if row["success"] else None
    row |= {name: None if refused else metrics[name] for name in (*_NUMBERS, *_COUNTS)}
    return row


def _makespan(task: ScoredTask, metrics: Mapping[str, Any]) -> float | None:
    """When the team was done, s; nobody is in a ring or a crowd before the clock ends."""
    if task.score in ("tracking", "own"):
        return None
    found: float = metrics["length_s" if task.score == "shapes" else "time_to_goal_s"]
    return found


def values_of(rows: Sequence[EpisodeRow], act_us: Sequence[int]) -> dict[str, dict[str, Any]]:
    """What an agent's episodes of a task add up to, by metric; at least one.

    `act_us` are the times of its decisions, microseconds.
    """
    return {metric.name: value_of_metric(metric, rows, act_us) for metric in METRICS}


def value_of_metric(
    metric: Measured, rows: Sequence[EpisodeRow], act_us: Sequence[int]
) -> dict[str, Any]:
    """One of them: `value` and `interval`."""
    column = metric.column or metric.name
    if metric.statistic == "percentile":
        share = float(metric.name.rpartition("_p")[2])
        spent = np.asarray(act_us, np.float64)
        return {
            "value": float(np.percentile(spent, share)) if len(spent) else None,
            "interval": None,
        }
    if metric.statistic == "rate":
        count = sum(row[column] for row in rows)
        return {"value": count / len(rows), "interval": rate_interval(count, len(rows))}
    counted = rows if metric.of == "all" else [row for row in rows if row["success"]]
    values = np.array([r[column] for r in counted if r[column] is not None], float)
    if not len(values):
        return {"value": None, "interval": None}
    statistic = np.mean if metric.statistic == "mean" else interquartile_mean
    return {"value": float(statistic(values)), "interval": bootstrap_interval(values, statistic)}


def fastest_times(task: ScoredTask, seeds: Sequence[int]) -> dict[int, float]:
    """By seed, the time in which the slowest drone could be within reach of its goal, s.

    From rest to rest on a straight line at the limits of acceleration and speed; where the task
    gives a moving reference, no less than that takes, as nobody is asked to be faster.
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
    """The score of an episode.

    Args:
        task: what was flown.
        metrics: of the episode, as of `swarm_envs.envs.judge.metrics`.
        fastest_s: of its seed, where the score is of time.
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


def check_table_form(form: TableForm) -> None:
    """Refuse Parquet where it cannot be written, before hours are spent on its content.

    Raises:
        ImportError: pyarrow is missing; the message says how to get it, or do without.
    """
    if form == "parquet":
        _arrow()


def write_rows(path: Path, rows: Sequence[Mapping[str, Any]]) -> None:
    """Write rows of the same columns, whole or not at all; the same rows, the same bytes.

    Args:
        path: ends in `.parquet` or `.csv`.
        rows: None stands for no value, in CSV an empty cell.

    Raises:
        ImportError: Parquet without pyarrow.
        OSError: the file cannot be written.
    """
    names = list(rows[0]) if rows else []
    with written_whole(path) as partial:
        if path.suffix == ".csv":
            with partial.open("w", encoding="utf-8", newline="") as file:
                writer = csv.DictWriter(file, names, lineterminator="\n")
                writer.writeheader()
                writer.writerows(rows)
            return
        arrow, parquet = _arrow()
        schema = arrow.schema([(name, _type(arrow, name)) for name in names])
        columns = {name: [row[name] for row in rows] for name in names}
        parquet.write_table(arrow.table(columns, schema=schema), partial)


def _type(arrow: Any, name: str) -> Any:
    if name in _TEXT:
        return arrow.string()
    if name in _FLAGS:
        return arrow.bool_()
    return arrow.int64() if name in _WHOLE else arrow.float64()


def _arrow() -> tuple[Any, Any]:
    return pyarrow("a table of episodes in Parquet", "write CSV by --table csv")
