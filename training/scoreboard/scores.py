"""`scores.json`: what cells add up to, ready to be shown."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from tqdm import tqdm

from swarm_envs.state import FloatArray
from swarm_envs.training.scoreboard.cells import Cell, Contender
from swarm_envs.training.scoreboard.metrics import METRICS, Row, values_of
from swarm_envs.training.scoreboard.normalised import LABELS
from swarm_envs.training.scoreboard.replays import choose
from swarm_envs.training.scoreboard.roster import place_of
from swarm_envs.training.scoreboard.statistics import THRESHOLDS, aggregate, profile
from swarm_envs.training.scoreboard.tasks import ScoredTask

FORMAT, VERSION = "swarm-envs scoreboard", 1
"""What the file says that it is."""


def content(
    manifest: Mapping[str, Any], cells: Sequence[Cell], rows: Sequence[Sequence[Row]]
) -> dict[str, Any]:
    """Everything that the report is made of, ready for JSON.

    Args:
        manifest: of the benchmark.
        cells: every agent on every task.
        rows: each cell's episodes, as of `row_of`.
    """
    tasks = list({cell.task.id: cell.task for cell in cells}.values())
    contenders = list({cell.contender.name: cell.contender for cell in cells}.values())
    standings, profiles = _families(cells, rows)
    shown = zip(cells, rows, strict=True)
    bar = tqdm(shown, total=len(cells), desc="intervals", unit="cell", mininterval=0.5)
    return {
        "format": FORMAT,
        "version": VERSION,
        "manifest": dict(manifest),
        "metrics": [_metric(k) for k in range(len(METRICS))],
        "tasks": [_task(task, cells) for task in tasks],
        "agents": [_agent(contender) for contender in contenders],
        "cells": [_cell(cell, part) for cell, part in bar],
        "aggregates": standings,
        "profiles": profiles,
    }


def _metric(k: int) -> dict[str, str]:
    names = ("name", "label", "unit", "better", "help")
    return {name: getattr(METRICS[k], name) for name in names}


def _task(task: ScoredTask, cells: Sequence[Cell]) -> dict[str, Any]:
    most = max(len(cell.seeds) for cell in cells if cell.task is task)
    return {
        "id": task.id,
        "task": task.family,
        "environment": task.environment,
        "label": task.label,
        "drones": task.drones,
        "options": task.setting,
        "episodes": most,
        "help": task.help,
    }


def _agent(contender: Contender) -> dict[str, Any]:
    place = place_of(contender.name)
    about = {"name": contender.name, "privileged": contender.privileged}
    return {**about, "label": place.label, "help": place.help}


def _cell(cell: Cell, rows: Sequence[Row]) -> dict[str, Any]:
    flown = cell.status == "flown"
    return {
        "task": cell.task.id,
        "agent": cell.contender.name,
        "status": cell.status,
        "reason": cell.reason,
        "episodes": len(rows) - len(cell.refused),
        "refused": len(cell.refused),
        "values": values_of(rows, cell.act_us) if flown else {},
        "replay": choose(cell.task.id, cell.contender.name, rows) if flown else None,
    }


def _families(
    cells: Sequence[Cell], rows: Sequence[Sequence[Row]]
) -> tuple[dict[str, Any], dict[str, Any]]:
    """Aggregates and profiles of each family of tasks.

    Of the tasks that an agent supports: `tasks` of `of` says how many. One on which it failed
    counts as nothing reached.
    """
    scores: dict[str, dict[str, list[FloatArray]]] = {}
    kinds: dict[str, set[str]] = {}
    for cell, part in zip(cells, rows, strict=True):
        agents = scores.setdefault(cell.task.family, {})
        kinds.setdefault(cell.task.family, set()).add(cell.task.id)
        if cell.status != "unsupported":
            failed = cell.status == "failed"
            reached = np.zeros(1) if failed else np.array([row["score"] for row in part])
            agents.setdefault(cell.contender.name, []).append(reached)
    labels = {cell.task.family: LABELS[cell.task.score] for cell in cells}
    standings: dict[str, Any] = {}
    profiles: dict[str, Any] = {}
    for family, agents in scores.items():
        standings[family] = {
            name: _standing(parts, labels[family], len(kinds[family]))
            for name, parts in agents.items()
        }
        profiles[family] = {
            "metric": "score",
            "label": labels[family],
            "thresholds": list(THRESHOLDS),
            "agents": {name: profile(parts) for name, parts in agents.items()},
        }
    return standings, profiles


def _standing(parts: Sequence[FloatArray], label: str, of: int) -> dict[str, Any]:
    value, interval = aggregate(parts)
    about = {"metric": f"interquartile mean of the {label}", "tasks": len(parts), "of": of}
    return {"value": value, "interval": interval, **about}
