"""What all episodes add up to: `scores.json`, and its standings as a table of text.

Scores over the tasks of a family are aggregated as Agarwal et al. propose (Deep reinforcement
learning at the edge of the statistical precipice, NeurIPS 2021, and its library rliable): the
interquartile mean of the scores of all episodes of all tasks, and the share of them above each
threshold; intervals by the stratified bootstrap, which samples again within each task. Tasks weigh
the same, however many episodes were flown of each.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from tqdm import tqdm

from swarm_envs.agents.evaluation import CONFIDENCE, RESAMPLES
from swarm_envs.state import FloatArray
from swarm_envs.training.scoreboard.board import FORMAT, VERSION
from swarm_envs.training.scoreboard.metrics import LABELS, METRICS, EpisodeRow, values_of
from swarm_envs.training.scoreboard.replays import choose_episode
from swarm_envs.training.scoreboard.roster import place_of
from swarm_envs.training.scoreboard.tasks import ScoredTask, digest

if TYPE_CHECKING:
    from swarm_envs.training.scoreboard.runner import Evaluation, LoadedAgent

__all__ = ["NOTE", "align_columns", "standings"]

THRESHOLDS = tuple(float(k) / 50.0 for k in range(51))  # Scores at which profiles are given
_AT_ONCE = 4_000_000  # Numbers that a bootstrap holds at once
RESULTS = ("refused", "success", "score", "makespan_s")
"""What the file holds of every episode of a cell, in the order of the seeds."""
_METRIC_KEYS = ("name", "label", "unit", "better", "help")  # What the file says of a metric
NOTE = "* sees the true state; (k of n): of the tasks it supports, all where nothing stands"
"""What the marks in the tables mean."""


def weighted_interquartile_mean(values: FloatArray, weights: FloatArray) -> FloatArray:
    """Mean of the middle half by weight of values (..., n) with weights (n,), not negative.

    Where a quarter of the weight ends within a value, that part of the value counts.
    """
    order = np.argsort(values, axis=-1, kind="stable")
    share = weights[order] / weights.sum()
    end = np.cumsum(share, axis=-1)
    inside = np.minimum(end, 0.75) - np.maximum(end - share, 0.25)
    return (np.take_along_axis(values, order, -1) * np.maximum(inside, 0.0)).sum(axis=-1) / 0.5


def aggregate(scores: Sequence[FloatArray]) -> tuple[float, list[float]]:
    """Interquartile mean of scores, one array (n,) for each task, and its interval.

    Raises:
        ValueError: there is no task, or one without episodes.
    """
    weights = _weights(scores)
    value = float(weighted_interquartile_mean(np.concatenate(scores), weights))
    drawn = [weighted_interquartile_mean(part, weights) for part in _resamples(scores)]
    return value, _interval(np.concatenate(drawn)[:, None])[:, 0].tolist()


def performance_profile(scores: Sequence[FloatArray]) -> dict[str, list[float]]:
    """Share of episodes that score more than each of `THRESHOLDS`, or as much at the last.

    Returns:
        `fraction`, and `low` and `high`, the ends of its pointwise interval.

    Raises:
        ValueError: there is no task, or one without episodes.
    """
    weights = _weights(scores)
    fraction = _above(np.concatenate(scores)[None], weights)[0]
    drawn = np.concatenate([_above(part, weights) for part in _resamples(scores)])
    low, high = _interval(drawn)
    return {"fraction": fraction.tolist(), "low": low.tolist(), "high": high.tolist()}


def _above(values: FloatArray, weights: FloatArray) -> FloatArray:
    """(B, T) weighted share of values (B, n) above each threshold, in [0, 1]."""
    share = weights / weights.sum()
    last = np.nextafter(THRESHOLDS[-1], 0.0)
    columns = [(values > min(t, last)) @ share for t in THRESHOLDS]
    return np.clip(np.stack(columns, axis=1), 0.0, 1.0)


def _weights(scores: Sequence[FloatArray]) -> FloatArray:
    """(n,) of all episodes, so that each task weighs 1."""
    if not scores or any(len(part) == 0 for part in scores):
        raise ValueError("there is no score to put together: name a task, and fly an episode of it")
    return np.concatenate([np.full(len(part), 1.0 / len(part)) for part in scores])


def _resamples(scores: Sequence[FloatArray]) -> Iterator[FloatArray]:
    """`RESAMPLES` resamples (B, n), drawn within each task, in parts; the same in every run."""
    rng = np.random.default_rng(0)
    size = max(1, _AT_ONCE // sum(map(len, scores)))
    for done in range(0, RESAMPLES, size):
        rows = min(size, RESAMPLES - done)
        drawn = [part[rng.integers(0, len(part), (rows, len(part)))] for part in scores]
        yield np.concatenate(drawn, axis=1)


def _interval(drawn: FloatArray) -> FloatArray:
    """(2, T) percentile interval of draws (B, T)."""
    tail = 50.0 * (1.0 - CONFIDENCE)
    return np.asarray(np.percentile(drawn, [tail, 100.0 - tail], axis=0))


def scores_of(
    manifest: Mapping[str, Any], cells: Sequence[Evaluation], rows: Sequence[Sequence[EpisodeRow]]
) -> dict[str, Any]:
    """What `scores.json` holds, out of each evaluation and the rows of its episodes."""
    tasks = list({cell.task.id: cell.task for cell in cells}.values())
    agents = list({cell.loaded.name: cell.loaded for cell in cells}.values())
    flown = list(zip(cells, rows, strict=True))
    standings, profiles = families_of(
        [
            Reached(cell.task, cell.loaded.name, cell.outcome[0], [row["score"] for row in part])
            for cell, part in flown
        ]
    )
    bar = tqdm(flown, desc="intervals", unit="cell", mininterval=0.5)
    return {
        "format": FORMAT,
        "version": VERSION,
        "manifest": dict(manifest),
        "metrics": [{name: getattr(metric, name) for name in _METRIC_KEYS} for metric in METRICS],
        "tasks": [_task(task, cells) for task in tasks],
        "agents": [_agent(loaded) for loaded in agents],
        "cells": [_cell(cell, part) for cell, part in bar],
        "aggregates": standings,
        "profiles": profiles,
    }


def _task(task: ScoredTask, cells: Sequence[Evaluation]) -> dict[str, Any]:
    names = ("id", "task", "environment", "label", "drones")
    most = max(len(cell.seeds) for cell in cells if cell.task is task)
    about = {name: getattr(task, name) for name in names}
    told = {"options": task.setting, "episodes": most, "help": task.help}
    return {**about, **told, "digest": digest(task)}


def _agent(loaded: LoadedAgent) -> dict[str, Any]:
    place = place_of(loaded.name)
    about = {"name": loaded.name, "privileged": loaded.privileged, "digest": loaded.digest}
    return {**about, "label": place.label, "help": place.help}


def _cell(cell: Evaluation, rows: Sequence[EpisodeRow]) -> dict[str, Any]:
    status, reason = cell.outcome
    flown = status == "flown"
    return {
        "task": cell.task.id,
        "agent": cell.loaded.name,
        "status": status,
        "reason": reason,
        "episodes": len(rows) - len(cell.refused),
        "refused": len(cell.refused),
        "values": values_of(rows, cell.act_us) if flown else {},
        "results": {key: [row[key] for row in rows] for key in RESULTS} if flown else {},
        "replay": choose_episode(cell.task.id, cell.loaded.name, rows) if flown else None,
    }


class Reached(NamedTuple):
    """What an agent scored on a task."""

    task: ScoredTask  # What was flown
    agent: str  # Its name
    status: str  # `flown`, `failed` or `unsupported`
    scores: Sequence[float]  # Of its episodes


def families_of(cells: Sequence[Reached]) -> tuple[dict[str, Any], dict[str, Any]]:
    """Aggregates and profiles of each family of tasks.

    Of the tasks that an agent supports: `tasks` of `of` says how many. One on which it failed
    counts as nothing reached.
    """
    scores: dict[str, dict[str, list[FloatArray]]] = {}
    kinds: dict[str, set[str]] = {}
    measured: dict[str, set[str]] = {}
    for cell in cells:
        agents = scores.setdefault(cell.task.task, {})
        kinds.setdefault(cell.task.task, set()).add(cell.task.id)
        measured.setdefault(cell.task.task, set()).add(cell.task.score)
        if cell.status != "unsupported":
            reached = np.zeros(1) if cell.status == "failed" else np.array(cell.scores)
            agents.setdefault(cell.agent, []).append(reached)
    labels = {k: LABELS[min(v) if len(v) == 1 else "mixed"] for k, v in measured.items()}
    standings: dict[str, Any] = {}
    profiles: dict[str, Any] = {}
    for family, agents in scores.items():
        label, of = labels[family], len(kinds[family])
        standings[family] = {name: _aggregate(parts, label, of) for name, parts in agents.items()}
        curves = {name: performance_profile(parts) for name, parts in agents.items()}
        about = {"metric": "score", "label": label, "thresholds": list(THRESHOLDS)}
        profiles[family] = {**about, "agents": curves}
    return standings, profiles


def _aggregate(parts: Sequence[FloatArray], label: str, of: int) -> dict[str, Any]:
    value, interval = aggregate(parts)
    about = {"metric": f"interquartile mean of the {label}", "tasks": len(parts), "of": of}
    return {"value": value, "interval": interval, **about}


def standings(content: Mapping[str, Any]) -> list[list[str]]:
    """Rows of the agents' aggregates by family, a head first, out of a `scores.json`."""
    families = list(content["aggregates"])
    rows = [["agent", *families]]
    for agent in content["agents"]:
        found = (content["aggregates"][family].get(agent["name"]) for family in families)
        rows.append([_name(agent), *map(_standing, found)])
    return rows


def align_columns(rows: Sequence[Sequence[str]]) -> list[str]:
    """Lines of a table whose columns stand below each other."""
    widths = [max(len(row[k]) for row in rows) for k in range(len(rows[0]))]
    lines = ("  ".join(c.ljust(w) for c, w in zip(row, widths, strict=True)) for row in rows)
    return [line.rstrip() for line in lines]


def _name(agent: Mapping[str, Any]) -> str:
    return f"{agent['name']}{'*' if agent['privileged'] else ''}"


def _standing(standing: Mapping[str, Any] | None) -> str:
    if standing is None:
        return "-"
    (low, high), flown, of = standing["interval"], standing["tasks"], standing["of"]
    part = "" if flown == of else f" ({flown} of {of})"
    return f"{standing['value']:.2f} [{low:.2f}, {high:.2f}]{part}"
