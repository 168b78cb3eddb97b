"""What an episode is measured by, and what a cell's episodes add up to."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from swarm_envs.agents.evaluation import Episode
from swarm_envs.agents.scores import (
    COLLISIONS,
    bootstrap_interval,
    interquartile_mean,
    rate_interval,
)
from swarm_envs.training.scoreboard.board import Metric
from swarm_envs.training.scoreboard.normalised import score_of
from swarm_envs.training.scoreboard.tasks import ScoredTask

Row = dict[str, Any]
"""An episode as a row of the table of episodes: columns by name."""
Value = dict[str, Any]
"""A number, `value`, and its 95 % `interval`; None where there is none."""


@dataclass(frozen=True)
class Measured(Metric):
    """A metric, and how it is made of the table of episodes."""

    column: str
    """Of the table of episodes; empty for the times of decisions, which are not in it."""
    statistic: Literal["rate", "mean", "iqm", "percentile"] = "iqm"
    """What a cell shows of the column."""
    of: Literal["all", "successes"] = "all"
    """Of which episodes."""


METRICS = (
    Measured(
        "success_rate",
        "success",
        "%",
        "higher",
        "Share of episodes in which the team did its task; Wilson's interval.",
        "success",
        "rate",
    ),
    Measured(
        "score",
        "score",
        "",
        "higher",
        "In [0, 1]: swap, success weighted by completion time; formation, share of shapes reached; "
        "ring, margin to the tracking limit.",
        "score",
    ),
    Measured(
        "collision_rate",
        "collided",
        "%",
        "lower",
        "Share of episodes in which any drone hit another, the floor, a wall, or tumbled.",
        "collided",
        "rate",
    ),
    Measured(
        "near_miss_rate",
        "near miss",
        "%",
        "lower",
        "Share of episodes without a crash in which two drones came within 1.5 times the sum of "
        "their radii.",
        "near_miss",
        "rate",
    ),
    Measured(
        "minimum_separation_m",
        "separation",
        "m",
        "higher",
        "Smallest distance between two drones.",
        "minimum_separation_m",
    ),
    Measured(
        "makespan_s",
        "makespan",
        "s",
        "lower",
        "Time until the whole team was done, of successes: swap, the last arrival; formation, the "
        "last shape held.",
        "makespan_s",
        of="successes",
    ),
    Measured(
        "worst_tracking_error_m",
        "worst error",
        "m",
        "lower",
        "Largest distance of any drone to its reference, where the task gives a moving one.",
        "worst_tracking_error_m",
    ),
    Measured(
        "rms_tracking_error_m",
        "RMS error",
        "m",
        "lower",
        "Root mean square distance to the reference, where the task gives a moving one.",
        "rms_tracking_error_m",
    ),
    Measured(
        "worst_height_error_m",
        "height error",
        "m",
        "lower",
        "Largest vertical distance of any drone to its reference: what downwash does.",
        "worst_height_error_m",
    ),
    Measured(
        "worst_force_g",
        "worst force",
        "g",
        "lower",
        "Largest force of the air on any drone.",
        "worst_force_g",
    ),
    Measured(
        "fraction_over_force_bound",
        "over force bound",
        "%",
        "lower",
        "Share of drone-steps with a vertical force above 5 g (small) or 10 g (large).",
        "fraction_over_force_bound",
        "mean",
    ),
    Measured(
        "energy_j",
        "energy",
        "J",
        "lower",
        "Ideal induced energy of all rotors, of successes.",
        "energy_j",
        of="successes",
    ),
    Measured(
        "fraction_outside_measured_range",
        "extrapolated",
        "%",
        "neither",
        "Share of drone-steps whose force lies outside what was measured: trust these less.",
        "fraction_outside_measured_range",
        "mean",
    ),
    Measured(
        "act_us_p50",
        "decision p50",
        "µs",
        "lower",
        "Median time of one decision for the whole team, on the machine of the manifest.",
        "",
        "percentile",
    ),
    Measured(
        "act_us_p99",
        "decision p99",
        "µs",
        "lower",
        "99th percentile of the same: plans made anew count here, those made at reset do not.",
        "",
        "percentile",
    ),
)
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
) -> Row:
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
    row: Row = {**about, "episode": index, "refused": refused}
    row["success"] = not refused and bool(metrics["success"])
    row["collided"] = collided
    row["near_miss"] = not refused and not collided and metrics["near_misses"] > 0
    row["score"] = 0.0 if refused else score_of(task, metrics, fastest_s)
    row["makespan_s"] = _makespan(task, metrics) if row["success"] else None
    row |= {name: None if refused else metrics[name] for name in (*_NUMBERS, *_COUNTS)}
    return row


def _makespan(task: ScoredTask, metrics: Mapping[str, Any]) -> float | None:
    """When the team was done, s; nobody is in a ring before the clock ends."""
    if task.family == "ring":
        return None
    found: float = metrics["length_s" if task.score == "shapes" else "time_to_goal_s"]
    return found


def values_of(rows: Sequence[Row], act_us: Sequence[int]) -> dict[str, Value]:
    """What episodes add up to, by metric.

    Args:
        rows: of one agent on one task, at least one.
        act_us: times of its decisions, microseconds.
    """
    return {metric.name: _value(metric, rows, act_us) for metric in METRICS}


def _value(metric: Measured, rows: Sequence[Row], act_us: Sequence[int]) -> Value:
    if metric.statistic == "percentile":
        share = float(metric.name.rpartition("_p")[2])
        spent = np.asarray(act_us, np.float64)
        return {"value": float(np.percentile(spent, share)) if len(spent) else None, **_NO_INTERVAL}
    if metric.statistic == "rate":
        count = sum(row[metric.column] for row in rows)
        return {"value": count / len(rows), "interval": rate_interval(count, len(rows))}
    counted = rows if metric.of == "all" else [row for row in rows if row["success"]]
    values = np.array([r[metric.column] for r in counted if r[metric.column] is not None], float)
    if not len(values):
        return {"value": None, **_NO_INTERVAL}
    statistic = np.mean if metric.statistic == "mean" else interquartile_mean
    return {"value": float(statistic(values)), "interval": bootstrap_interval(values, statistic)}


_NO_INTERVAL = {"interval": None}
