"""A made-up scoreboard: as large as a real one, with cells that failed and names that bite."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np

EVIL = "</script><script>window.bitten=1</script>\"'&<img src=x onerror=window.bitten=1>.py:Mine"
"""A name that would run in a page that does not escape it."""

AGENTS: dict[str, tuple[bool, float, float]] = {
    "hover": (False, 0.0, 9.0),
    "random": (False, 0.0, 20.0),
    "straight-line": (True, 0.25, 31.0),
    "tracking": (True, 0.32, 60.0),
    "tracking+compensated": (True, 0.41, 75.0),
    "detour": (True, 0.68, 420.0),
    "detour+compensated": (True, 0.75, 450.0),
    "swap-dagger": (False, 0.78, 190.0),
    "crowd-dagger": (False, 0.74, 210.0),
    "crowd-dagger+filter": (False, 0.97, 800.0),
    "neural-swarm-planner": (True, 0.88, 160.0),
    "mlr-dmpc": (True, 0.99, 5200.0),
    "mlr-dmpc+compensated": (True, 0.992, 5400.0),
    "rth3d": (True, 0.93, 33.0),
    "rth3d+compensated": (True, 0.96, 38.0),
    EVIL: (False, 0.5, 120.0),
}
"""Whether it is privileged, how good it is, and its microseconds a decision."""

METRICS = [
    ("success_rate", "Success", "%", "higher"),
    ("collision_rate", "Collisions", "%", "lower"),
    ("near_misses", "Near misses", "", "lower"),
    ("minimum_separation_m", "Minimum separation", "m", "higher"),
    ("makespan_s", "Makespan", "s", "lower"),
    ("worst_tracking_error_m", "Worst tracking error", "m", "lower"),
    ("energy_j", "Energy", "J", "lower"),
    ("fraction_outside", "Outside the measured range", "%", "neither"),
    ("act_us_p50", "Compute, median", "µs", "lower"),
    ("act_us_p99", "Compute, p99", "µs", "lower"),
]
"""Name, label, unit and which values are better."""

TASKS = [
    *(("swap", f"{layout}-{n}") for layout in ("circle", "random") for n in (2, 4, 8, 16)),
    *(("ring", f"{n}") for n in (5, 8, 16)),
    *(("formation", f"shapes-{n}") for n in (4, 9, 16)),
]
"""Family and setting."""


def scores(seed: int = 0) -> dict[str, Any]:
    """What a `scores.json` holds."""
    rng = np.random.default_rng(seed)
    tasks = [_task(family, setting) for family, setting in TASKS]
    cells = [_cell(task, name, rng) for task in tasks for name in AGENTS]
    return {
        "format": "swarm-envs scoreboard",
        "version": 1,
        "manifest": _manifest(),
        "metrics": [
            {"name": n, "label": label, "unit": u, "better": b, "help": f"What {label} means."}
            for n, label, u, b in METRICS
        ],
        "tasks": tasks,
        "agents": [
            {"name": name, "label": name, "privileged": told, "help": f"Flies as {name} does."}
            for name, (told, *_) in AGENTS.items()
        ],
        "cells": cells,
        "aggregates": {family: _standings(cells, family) for family, _ in TASKS},
        "profiles": {family: _profile(cells, family) for family, _ in TASKS},
    }


def write_scores(folder: Path, content: dict[str, Any] | None = None) -> Path:
    """Write a `scores.json` and return its folder."""
    folder.mkdir(parents=True, exist_ok=True)
    text = json.dumps(scores() if content is None else content)
    (folder / "scores.json").write_text(text, encoding="utf-8")
    return folder


def _task(family: str, setting: str) -> dict[str, Any]:
    drones = int(setting.rpartition("-")[2])
    layout = setting.rpartition("-")[0]
    label = ", ".join(filter(None, (family, layout, f"{drones} drones")))
    options = {"num_drones": drones, **({"layout": layout} if family == "swap" else {})}
    return {
        "id": f"{family}-{setting}-v2", "task": family, "label": label, "drones": drones,
        "environment": f"{family}_v1", "options": {**options, "physics": "batch"},
        "episodes": 64, "help": f"{drones} drones fly a {family}.",
    }  # fmt: skip


def _cell(task: dict[str, Any], agent: str, rng: np.random.Generator) -> dict[str, Any]:
    cell = {"task": task["id"], "agent": agent, "values": {}, "replay": None, "episodes": 0}
    if "dagger" in agent and task["task"] != "swap":
        reason = f"it was trained for swap, not {task['task']}"
        return {**cell, "status": "unsupported", "reason": reason}
    if agent == "neural-swarm-planner" and task["drones"] == 16:
        return {**cell, "status": "failed", "reason": "AgentFailed: <b>no plan</b> in 60 s"}
    number = [*AGENTS].index(agent)
    file = f"replays/{task['id']}--agent-{number}.html"
    replay = {"seed": 17, "episode": 3, "file": file, "why": "the first failure with a collision"}
    values = _values(task, agent, rng)
    part = agent.startswith("rth3d") and task["id"] == "ring-16-v2"
    refused = "refused 3 of 64 episodes: starts are too near" if part else None
    return {
        **cell, "status": "flown", "reason": refused, "episodes": 64, "values": values,
        "replay": replay,
    }  # fmt: skip


def _values(task: dict[str, Any], agent: str, rng: np.random.Generator) -> dict[str, Any]:
    _, skill, micros = AGENTS[agent]
    rate = round(64 * skill ** (math.log2(task["drones"]) / 2)) / 64
    p50 = micros * task["drones"] / 4
    means = {
        "success_rate": rate, "collision_rate": round(64 * (1 - rate) * 0.8) / 64,
        "near_misses": 3 * (1 - rate) + rng.random(), "minimum_separation_m": 0.1 + 0.2 * rate,
        "makespan_s": None if rate == 0 else 3 + 4 * rng.random(),
        "worst_tracking_error_m": 0.02 + 0.4 * rng.random(), "energy_j": 30.0 * task["drones"],
        "fraction_outside": 0.1 * rng.random(), "act_us_p50": p50, "act_us_p99": 2.4 * p50,
    }  # fmt: skip
    return {name: _value(name, mean) for name, mean in means.items()}


def _value(name: str, mean: float | None) -> dict[str, Any]:
    if mean is None:
        return {"value": None, "interval": None}
    if name.endswith("_rate"):
        ends = [max(0.0, 0.94 * mean - 0.01), min(1.0, 0.95 * mean + 0.05)]
        return {"value": mean, "interval": ends}
    return {"value": mean, "interval": [0.9 * mean, 1.1 * mean]}


def _rates(cells: list[dict[str, Any]], family: str) -> dict[str, float]:
    found: dict[str, list[float]] = {}
    for cell in cells:
        if cell["status"] == "flown" and cell["task"].startswith(family):
            rate = cell["values"]["success_rate"]["value"]
            found.setdefault(cell["agent"], []).append(rate)
    return {name: float(np.mean(rates)) for name, rates in found.items()}


def _standings(cells: list[dict[str, Any]], family: str) -> dict[str, Any]:
    return {
        name: {
            "value": rate,
            "interval": _value("a_rate", rate)["interval"],
            "metric": "interquartile mean of success",
        }
        for name, rate in _rates(cells, family).items()
    }


def _profile(cells: list[dict[str, Any]], family: str) -> dict[str, Any]:
    thresholds = np.linspace(0.0, 1.0, 41)
    curves = {}
    for name, rate in _rates(cells, family).items():
        fraction = rate ** (0.2 + thresholds) * (1.0 - 0.6 * thresholds**3)
        spread = 0.08 * np.sqrt(np.clip(fraction * (1 - fraction), 0.0, 1.0))
        curves[name] = {
            "fraction": fraction.tolist(),
            "low": np.clip(fraction - spread, 0, 1).tolist(),
            "high": np.clip(fraction + spread, 0, 1).tolist(),
        }
    label = "score of an episode"
    return {"metric": "score", "label": label, "thresholds": thresholds.tolist(), "agents": curves}


def _manifest() -> dict[str, Any]:
    return {
        "command": "swarm-envs benchmark --episodes 64 --seed 0 --out scoreboard",
        "versions": {"swarm-envs": "0.1.0", "python": "3.11.9", "numpy": "2.1.0"},
        "machine": {"cpu": "Some CPU at 2.5 GHz", "cores": 2, "system": "Linux 6.1"},
        "commit": "0123456789abcdef0123456789abcdef01234567",
        "config": {"episodes": 64, "seed": 0, "tasks": ["all"], "agents": [EVIL]},
        "config_hash": "c0ffee" * 10 + "abcd", "seed": 0, "force_rate": 240,
        "started": "2026-01-02T03:04:05+00:00", "cpu_s": 3210.0, "wall_s": 1800.0,
    }  # fmt: skip
