"""Compensation of the motors' lag, eq. (22), on and off, with an exact force model.

What is measured is the controller alone: it feeds forward the environment's own force model, an
oracle that no real controller has, so that what is left of the error is what the lag leaves.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from swarm_envs.baselines.neural_swarm.flights import Flights, fly, swap_test
from swarm_envs.control.config import GAINS, ControllerConfig
from swarm_envs.files import write_json, write_table
from swarm_envs.interactions import load
from swarm_envs.training.reproduce.runs import Cell, draw_seeds, run_cells
from swarm_envs.training.reproduce.studies.lag_plot import plot_lag

TRUTH = "learned"
"""The force that blows, and what the oracle feeds forward."""
TEAM = "L2S"
"""The swap whose errors the paper gives (Sec. VII-E)."""
WANTED_RATIO = 4.0
"""How many times smaller the compensated error shall be with lag compensation."""


@dataclass(frozen=True)
class Variant:
    """One controller of the study."""

    gains: str
    """`soft`, `mid` or `stiff`."""
    oracle: bool
    """Whether it feeds forward the exact force; else it is the uncompensated baseline."""
    lag: bool
    """Whether it compensates the motors' lag, eq. (22)."""

    @property
    def name(self) -> str:
        """Also its cell's name."""
        force = "exact force" if self.oracle else "no force"
        return f"{self.gains}, {force}, lag {'compensated' if self.lag else 'not compensated'}"

    @property
    def controller(self) -> ControllerConfig:
        """The configuration of the tracking loop."""
        oracle_force = load(TRUTH) if self.oracle else None
        return ControllerConfig(GAINS[self.gains], oracle_force, self.lag)


VARIANTS = tuple(
    Variant(gains, oracle, lag)
    for gains in GAINS
    for oracle in (False, True)
    for lag in (False, True)
)
"""What is flown: gains, beliefs, with and without lag compensation."""


def reproduce_lag(
    out: Path, seed: int = 0, episodes: int = 20, engine: str = "batch", progress: bool = True
) -> dict[str, Any]:
    """Fly the same swaps by every variant, and write `lag.json`, `lag.csv` and `lag.png`.

    Args:
        out: folder, made if missing; `lag_cells.json` there keeps what was flown.
        seed: seeds of the swaps are drawn from it.
        episodes: flights of each variant.
        engine: `bullet` or `batch`.
        progress: show a progress bar.

    Returns:
        The numbers, ready for JSON.

    Raises:
        ValueError: the folder holds the study with other settings.
    """
    seeds = draw_seeds(seed, episodes)
    settings = {"team": TEAM, "seed": seed, "episodes": episodes, "engine": engine, "truth": TRUTH}
    jobs = {v.name: partial(measure, v, seeds, engine) for v in VARIANTS}
    cells = run_cells(out / "lag_cells.json", settings, jobs, progress)
    rows = [_row(variant, cells[variant.name]) for variant in VARIANTS]
    summary = {**settings, "rows": rows, "reductions": reductions(rows)}
    write_json(out / "lag.json", summary)
    write_table(out / "lag.csv", rows)
    plot_lag(out / "lag.png", rows, {v.name: cells[v.name]["height_m"] for v in VARIANTS})
    return summary


def measure(variant: Variant, seeds: Sequence[int], engine: str) -> Cell:
    """Fly one variant: worst height errors of the lowest drone, and the first flight's errors."""
    flights = fly(swap_test(TEAM, truth=TRUTH, engine=engine), variant.controller, seeds)
    return {
        "worst_cm": np.round(100.0 * flights.worst_height_error[:, -1], 4).tolist(),
        "crashed": int(flights.crashed.sum()),
        "height_m": np.round(_height_error(flights, 0), 6).tolist(),
    }


def _height_error(flights: Flights, e: int) -> np.ndarray[Any, np.dtype[np.float64]]:
    """(T,) height error of the lowest drone of flight `e`, m."""
    return flights.position[e, :, -1, 2] - flights.reference[e, :, -1, 2]


def _row(variant: Variant, cell: Cell) -> dict[str, Any]:
    worst = np.array(cell["worst_cm"])
    return {
        "gains": variant.gains,
        "force": "exact" if variant.oracle else "none",
        "lag": "compensated" if variant.lag else "not compensated",
        "median_cm": round(float(np.median(worst)), 3),
        "best_cm": round(float(worst.min()), 3),
        "worst_cm": round(float(worst.max()), 3),
        "crashed": cell["crashed"],
    }


def reductions(rows: Sequence[dict[str, Any]]) -> dict[str, dict[str, float]]:
    """How many times smaller the median error is with lag compensation, by force and gains."""
    median = {(r["force"], r["gains"], r["lag"]): r["median_cm"] for r in rows}
    return {
        force: {
            gains: round(
                median[force, gains, "not compensated"] / median[force, gains, "compensated"], 2
            )
            for gains in GAINS
        }
        for force in ("none", "exact")
    }


def format_lag(summary: dict[str, Any]) -> str:
    """The table and the reductions as text."""
    lines = [
        f"Worst height error of the lowest drone, {summary['team']}, radius 0.5 m in 4 s, median "
        f"of {summary['episodes']} swaps (cm)",
        f"{'gains':8}{'feed-forward':>14}{'lag not comp.':>16}{'lag compensated':>18}{'ratio':>8}",
    ]
    median = {(r["force"], r["gains"], r["lag"]): r["median_cm"] for r in summary["rows"]}
    for force, ratios in summary["reductions"].items():
        for gains, ratio in ratios.items():
            off, on = (median[force, gains, f"{no}compensated"] for no in ("not ", ""))
            name = "exact (oracle)" if force == "exact" else "none"
            lines.append(f"{gains:8}{name:>14}{off:16.2f}{on:18.2f}{ratio:8.1f}")
    crashed = sum(row["crashed"] for row in summary["rows"])
    lines.append(f"flights that crashed: {crashed}")
    return "\n".join(lines)
