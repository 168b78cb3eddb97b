"""Summaries of a benchmark's results as JSON, text tables and Markdown.

Scores over the tasks of a family are aggregated as proposed by Agarwal et al. (Deep reinforcement
learning at the edge of the statistical precipice, NeurIPS 2021, and its library rliable): the
interquartile mean of the scores of all episodes of all tasks, and the fraction of them above each
threshold; intervals are those of the stratified bootstrap, which resamples within each task. All
tasks have the same weight, independent of their number of episodes.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from scipy import stats
from tqdm import tqdm

from swarm_envs.agents.evaluation import CONFIDENCE, RESAMPLES
from swarm_envs.state import FloatArray
from swarm_envs.training.scoreboard.metrics import values_of
from swarm_envs.training.scoreboard.results import Cell, Results

__all__ = ["NOTE", "aggregate", "align_columns", "markdown", "standings", "summarize"]

THRESHOLDS = np.linspace(0.0, 1.0, 51)  # Scores at which profiles are evaluated
_AT_ONCE = 4_000_000  # Numbers that a bootstrap has in memory at once
NOTE = "* sees the true state; (k of n): supports only k of the n tasks"
"""Explanation of the marks in the tables."""
_NOT_FLOWN = {"unsupported": "-", "failed": "failed"}


def weighted_interquartile_mean(values: FloatArray, weights: FloatArray) -> FloatArray:
    """Return the mean of the middle half by weight of values (..., n) with weights (n,) >= 0.

    Values at the quartiles count partially.
    """
    order = np.argsort(values, axis=-1, kind="stable")
    share = weights[order] / weights.sum()
    end = np.cumsum(share, axis=-1)
    inside = np.minimum(end, 0.75) - np.maximum(end - share, 0.25)
    return (np.take_along_axis(values, order, -1) * np.maximum(inside, 0.0)).sum(axis=-1) / 0.5


def aggregate(scores: Sequence[FloatArray]) -> dict[str, Any]:
    """Aggregate scores in [0, 1], one array (n,) for each task.

    Returns:
        `value` and `interval` of the interquartile mean, and the performance profile: `fraction`,
        the fraction of episodes with a score above each of `THRESHOLDS` (or equal to the last),
        with the bounds `low` and `high` of its pointwise intervals.

    Raises:
        ValueError: there is no task, or one without episodes.
    """
    if not scores or any(len(part) == 0 for part in scores):
        raise ValueError("there is no score to aggregate; evaluate at least one episode per task")
    # A bootstrap needs two values; a repeated value does not change the result.
    parts = [part if len(part) > 1 else np.repeat(part, 2) for part in scores]
    weights = np.concatenate([np.full(len(part), 1.0 / len(part)) for part in parts])

    def statistics(*drawn: FloatArray, axis: int = -1) -> FloatArray:
        values = np.concatenate(drawn, axis=axis)
        mean = weighted_interquartile_mean(values, weights)
        return np.stack([mean, *_shares_above(values, weights)])

    value, *fraction = statistics(*parts).tolist()
    result = stats.bootstrap(
        parts,
        statistics,
        n_resamples=RESAMPLES,
        confidence_level=CONFIDENCE,
        method="percentile",
        vectorized=True,
        batch=max(1, _AT_ONCE // len(weights)),
        rng=np.random.default_rng(0),
    ).confidence_interval
    (low, *lows), (high, *highs) = result.low.tolist(), result.high.tolist()
    return {"value": value, "interval": [low, high]} | {
        "fraction": fraction, "low": lows, "high": highs,
    }  # fmt: skip


def _shares_above(values: FloatArray, weights: FloatArray) -> list[FloatArray]:
    """Return the weighted share of values (..., n) above each threshold, in [0, 1]."""
    share, last = weights / weights.sum(), np.nextafter(THRESHOLDS[-1], 0.0)
    return [np.minimum((values > min(t, last)) @ share, 1.0) for t in THRESHOLDS]


def summarize(results: Results) -> dict[str, Any]:
    """Summarize results, ready for JSON.

    Returns:
        `about`; `cells`: every agent on every task with its metrics; `families`: by family of tasks
        and agent, the result of `aggregate` and the number of tasks. Only tasks that an agent
        supports count. A task on which it failed has a score of 0.
    """
    cells = tqdm(results.cells, desc="intervals", unit="cell", mininterval=0.5)
    families: dict[str, Any] = {}
    for name in {each["family"]: None for each in results.about["tasks"].values()}:
        tasks = [k for k, v in results.about["tasks"].items() if v["family"] == name]
        families[name] = {}
        for agent in results.about["agents"]:
            of = [c for c in results.cells if c.agent == agent and c.task in tasks]
            if parts := [_scores(c) for c in of if c.status != "unsupported"]:
                counted = {"tasks": len(parts), "of": len(tasks)}
                families[name][agent] = {**aggregate(parts), **counted}
    return {
        "about": results.about,
        "cells": [_describe(cell) for cell in cells],
        "families": families,
        "thresholds": THRESHOLDS.tolist(),
    }


def _scores(cell: Cell) -> FloatArray:
    return np.array([row["score"] for row in cell.rows] if cell.rows else [0.0])


def _describe(cell: Cell) -> dict[str, Any]:
    flown = cell.status == "flown"
    return {
        "task": cell.task,
        "agent": cell.agent,
        "status": cell.status,
        "reason": cell.reason,
        "episodes": sum(row["refusal"] is None for row in cell.rows),
        "values": values_of(cell.rows) if flown else {},
    }


def standings(content: Mapping[str, Any]) -> list[list[str]]:
    """Return rows of the agents' aggregate scores by family, the header first."""
    families = content["families"]
    rows = [["agent", *families]]
    for name in content["about"]["agents"]:
        found = [agents.get(name) for agents in families.values()]
        rows.append([_marked(content, name), *map(_standing, found)])
    return rows


def _marked(content: Mapping[str, Any], name: str) -> str:
    return f"{name}{'*' if content['about']['agents'][name]['privileged'] else ''}"


def _standing(standing: Mapping[str, Any] | None) -> str:
    if standing is None:
        return "-"
    (low, high), flown, of = standing["interval"], standing["tasks"], standing["of"]
    part = "" if flown == of else f" ({flown} of {of})"
    return f"{standing['value']:.2f} [{low:.2f}, {high:.2f}]{part}"


def success_rates(content: Mapping[str, Any], family: str) -> list[list[str]]:
    """Return rows of the agents' success rates on a family's tasks, percent, the header first.

    Agents that support none of the tasks are omitted.
    """
    tasks = [k for k, v in content["about"]["tasks"].items() if v["family"] == family]
    cells = {(cell["task"], cell["agent"]): cell for cell in content["cells"]}
    rows = [["agent", *(_short(task, family) for task in tasks)]]
    for name in content["families"][family]:
        row = [_rate(cells[task, name]) for task in tasks]
        rows.append([_marked(content, name), *row])
    return rows


def _short(task_id: str, family: str) -> str:
    """Return a task's id without its version, and without the family or a common task."""
    first, *words, _ = task_id.split("-")
    return " ".join(words if first in {family, "swap", "formation"} else [first, *words])


def _rate(cell: Mapping[str, Any]) -> str:
    if cell["status"] != "flown":
        return _NOT_FLOWN[cell["status"]]
    return f"{100.0 * cell['values']['success_rate']['value']:.0f}"


def align_columns(rows: Sequence[Sequence[str]]) -> list[str]:
    """Return the lines of a table with aligned columns."""
    widths = [max(len(row[k]) for row in rows) for k in range(len(rows[0]))]
    lines = ("  ".join(c.ljust(w) for c, w in zip(row, widths, strict=True)) for row in rows)
    return [line.rstrip() for line in lines]


def markdown(content: Mapping[str, Any]) -> str:
    """Return the command of a summary and its tables as Markdown."""
    about, flown = content["about"], sum(cell["episodes"] for cell in content["cells"])
    machine, version = about["machine"], about["versions"]["swarm_envs"]
    parts = [
        f"`{about['command']}`: {flown:,} episodes, {machine['cores']} processors "
        f"({machine['cpu']}), swarm-envs {version}. {_escaped(NOTE)}."
    ]
    parts.append("Score [95 % interval]\n\n" + _table(standings(content)))
    for family in content["families"]:
        table = _table(success_rates(content, family))
        parts.append(f"Success in {family}, % of episodes\n\n{table}")
    return "\n\n".join(parts) + "\n"


def _table(rows: Sequence[Sequence[str]]) -> str:
    head, *others = (f"| {' | '.join(row)} |" for row in rows)
    return _escaped("\n".join([head, "|" + "---|" * len(rows[0]), *others]))


def _escaped(text: str) -> str:
    return text.replace("*", "\\*")
