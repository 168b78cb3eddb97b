"""Compensation of the motors' lag, eq. (22), on and off, with an exact force model.

What is measured is the controller alone: it feeds forward the environment's own force model, an
oracle that no real controller has, so that what is left of the error is what the lag leaves.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from swarm_envs.agents.evaluation import frozen_seeds
from swarm_envs.baselines.neural_swarm.flights import default_engine, fly, format_columns, swap_test
from swarm_envs.control.config import GAINS, ControllerConfig
from swarm_envs.interactions import load
from swarm_envs.training.reproduce.charts import draw_numbered_bars, label_axis
from swarm_envs.training.reproduce.study import Cell, Cells, Report, Study, error_cell
from swarm_envs.viewing.style import picture

TRUTH = "learned"  # The force model of the environment, and what the oracle feeds forward
TEAM = "L2S"  # The swap whose errors the paper gives (Sec. VII-E).
_EPISODES = 20


_FORCES, _LAGS = ("none", "exact"), ("not compensated", "compensated")
LAG_VARIANTS = tuple(itertools.product(GAINS, _FORCES, _LAGS))
"""What is flown: gains, the force that is fed forward, whether the motors' lag is compensated."""


def _name(gains: str, force: str, lag: str) -> str:
    """Of a variant's cell."""
    return f"{gains}, {'no' if force == 'none' else force} force, lag {lag}"


def _settings(options: Any) -> dict[str, Any]:
    return {
        "team": TEAM,
        "seed": options.seed,
        "episodes": options.episodes or _EPISODES,
        "engine": options.engine or default_engine(),
        "truth": TRUTH,
    }


def _grid(options: Any) -> Cells:
    """The same swaps by every variant."""
    seeds = frozen_seeds(options.seed, options.episodes or _EPISODES)
    engine = options.engine or default_engine()
    return {_name(*v): partial(_measure, *v, seeds, engine) for v in LAG_VARIANTS}


def _measure(gains: str, force: str, lag: str, seeds: Sequence[int], engine: str) -> Cell:
    """Fly one variant: worst height errors of the lowest drone, and the first flight's errors."""
    belief = load(TRUTH) if force == "exact" else None
    controller = ControllerConfig(GAINS[gains], belief, lag == "compensated")
    flights = fly(swap_test(TEAM, truth=TRUTH, engine=engine), controller, seeds)
    height = flights.position[0, :, -1, 2] - flights.reference[0, :, -1, 2]
    return {
        **error_cell(flights.worst_height_error[:, -1], flights.crashed),
        "height_m": np.round(height, 6).tolist(),
    }


def _row(gains: str, force: str, lag: str, cell: Cell) -> dict[str, Any]:
    worst = np.array(cell["worst_cm"])
    return {
        "gains": gains,
        "force": force,
        "lag": lag,
        "median_cm": round(float(np.median(worst)), 3),
        "best_cm": round(float(worst.min()), 3),
        "worst_cm": round(float(worst.max()), 3),
        "crashed": cell["crashed"],
    }


def reductions(rows: Sequence[dict[str, Any]]) -> dict[str, dict[str, float]]:
    """How many times smaller the median error is with lag compensation, by force and gains."""
    median = {(r["force"], r["gains"], r["lag"]): r["median_cm"] for r in rows}
    off, on = _LAGS
    return {
        force: {g: round(median[force, g, off] / median[force, g, on], 2) for g in GAINS}
        for force in _FORCES
    }


def _report(options: Any, cells: Mapping[str, Cell]) -> Report:
    rows = [_row(*variant, cells[_name(*variant)]) for variant in LAG_VARIANTS]
    summary = {**_settings(options), "rows": rows, "reductions": reductions(rows)}
    traces = [cells[_name(*variant)]["height_m"] for variant in LAG_VARIANTS]
    draw = partial(_plot, rows=rows, traces=traces)
    return Report(summary, _text(summary), rows, {"lag.png": draw})


def _text(summary: Mapping[str, Any]) -> str:
    lines = [("gains", "feed-forward", "lag not comp.", "lag compensated", "ratio")]
    median = {(r["force"], r["gains"], r["lag"]): r["median_cm"] for r in summary["rows"]}
    for force, ratios in summary["reductions"].items():
        for gains, ratio in ratios.items():
            off, on = (median[force, gains, lag] for lag in _LAGS)
            name = "exact (oracle)" if force == "exact" else "none"
            lines.append((gains, name, f"{off:.2f}", f"{on:.2f}", f"{ratio:.1f}"))
    return "\n".join(
        [
            f"Worst height error of the lowest drone, {TEAM}, radius 0.5 m in 4 s, median of "
            f"{summary['episodes']} swaps (cm)",
            *format_columns(lines),
            f"flights that crashed: {sum(row['crashed'] for row in summary['rows'])}",
        ]
    )


_LOOK = {
    ("none", "not compensated"): ("#E69F00", "no force, lag not compensated"),
    ("none", "compensated"): ("#D55E00", "no force, lag compensated"),
    ("exact", "not compensated"): ("#56B4E9", "exact force, lag not compensated"),
    ("exact", "compensated"): ("#0072B2", "exact force, lag compensated"),
}
_SAMPLES_PER_SECOND = 48


def _plot(path: Path, rows: Sequence[Mapping[str, Any]], traces: Sequence[Sequence[float]]) -> None:
    """Height errors of the first swap over time, default gains, and medians by gains."""
    headline = "A small drone passes under a large one: lag compensation, eq. (22)"
    with picture(path, 11.0, 4.2, headline) as figure:
        over_time, medians = figure.subplots(1, 2, width_ratios=[1.25, 1.0])
        for row, trace in zip(rows, traces, strict=True):
            if row["gains"] == "mid":
                color, label = _LOOK[row["force"], row["lag"]]
                time = np.arange(len(trace)) / _SAMPLES_PER_SECOND
                over_time.plot(time, 100.0 * np.array(trace), color=color, label=label)
        title = "One swap, gains mid"
        label_axis(over_time, title, "Time (s)", "Height error (cm)", legend=9, zero=True)
        series = [
            ([r["median_cm"] for r in rows if (r["force"], r["lag"]) == look], color, None)
            for look, (color, _) in _LOOK.items()
        ]
        draw_numbered_bars(medians, list(GAINS), series)
        medians.set_ylim(0.05, 60.0)
        label_axis(medians, "All swaps, by gains", "", "Worst height error, median (cm)", grid="y")


LAG = Study(
    paper="neural-swarm2",
    name="study-lag",
    label="Lag",
    shows="height errors with and without compensation of the motors' lag, eq. (22)",
    takes=("episodes", "engine"),
    grid=_grid,
    settings=_settings,
    report=_report,
)
"""Compensation of the motors' lag on and off."""
