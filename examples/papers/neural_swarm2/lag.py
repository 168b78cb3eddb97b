"""Lag compensation of the motors, eq. (22), on and off, with an exact force model.

The controller compensates the force model of the environment (an oracle), so that the remaining
error is due to the lag.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from examples.papers.common import markdown, write_json
from examples.papers.neural_swarm2.bars import draw_bars
from swarm_envs.agents.evaluation import frozen_seeds
from swarm_envs.baselines.neural_swarm.flights import default_engine, run_flights, swap_test
from swarm_envs.control.config import GAINS, ControllerConfig
from swarm_envs.interactions import load
from swarm_envs.state import FloatArray
from swarm_envs.viewing.style import GREY, picture

TRUTH = "learned"  # the force model of the environment, and of the oracle
TEAM = "L2S"  # the swap whose errors the paper gives (Sec. VII-E)
FORCES, LAGS = ("none", "exact"), ("not compensated", "compensated")
VARIANTS = tuple(itertools.product(GAINS, FORCES, LAGS))
"""Gains, the force that is fed forward, and whether the motors' lag is compensated."""
LOOKS = {
    ("none", "not compensated"): ("#E69F00", "no force, lag not compensated"),
    ("none", "compensated"): ("#D55E00", "no force, lag compensated"),
    ("exact", "not compensated"): ("#56B4E9", "exact force, lag not compensated"),
    ("exact", "compensated"): ("#0072B2", "exact force, lag compensated"),
}
"""Color and label by force and lag."""


def lag(
    out: Path = Path("neural_swarm2"),
    episodes: int = 20,
    engine: str = default_engine(),
    seed: int = 0,
) -> None:
    """Fly a swap with and without compensation of the motors' lag (eq. 22; docs/limits.md).

    Writes `lag.json` (`rows`: errors by gains, force and lag; `reductions`: how many times smaller
    the median error is with lag compensation) and `lag.png`.

    Args:
        out: folder, made if missing.
        episodes: swaps of each variant.
        engine: of the flights, `bullet` or `batch`.
        seed: seeds of the flights are drawn from it.
    """
    seeds = frozen_seeds(seed, episodes)
    rows, traces = [], []
    for gains, force, compensation in tqdm(VARIANTS, "lag"):
        belief = load(TRUTH) if force == "exact" else None
        controller = ControllerConfig(GAINS[gains], belief, compensation == "compensated")
        flights = run_flights(swap_test(TEAM, truth=TRUTH, engine=engine), controller, seeds)
        traces.append((flights.position - flights.reference)[0, :, -1, 2])
        worst = np.round(100.0 * flights.worst_height_error[:, -1], 4)
        rows.append(
            {
                "gains": gains,
                "force": force,
                "lag": compensation,
                "median_cm": round(float(np.median(worst)), 3),
                "best_cm": round(float(worst.min()), 3),
                "worst_cm": round(float(worst.max()), 3),
                "crashed": int(flights.crashed.sum()),
            }
        )
    summary = {
        "team": TEAM,
        "seed": seed,
        "episodes": episodes,
        "engine": engine,
        "truth": TRUTH,
        "rows": rows,
        "reductions": reductions(rows),
    }
    write_json(out / "lag.json", summary)
    plot_lag(out / "lag.png", rows, traces)
    print(f"Worst height error of the lowest drone, {TEAM}, {episodes} swaps")
    print(markdown(rows, ("gains", "force", "lag", "median_cm", "best_cm", "worst_cm", "crashed")))


def reductions(rows: Sequence[Mapping[str, Any]]) -> dict[str, dict[str, float]]:
    """Return how many times smaller the median error is with compensation, by force and gains."""
    median = {(r["force"], r["gains"], r["lag"]): r["median_cm"] for r in rows}
    off, on = LAGS
    return {
        force: {g: round(median[force, g, off] / median[force, g, on], 2) for g in GAINS}
        for force in FORCES
    }


def plot_lag(path: Path, rows: Sequence[Mapping[str, Any]], traces: Sequence[FloatArray]) -> None:
    """Draw height errors of the first swap over time, default gains, and medians by gains."""
    headline = "A small drone passes under a large one: lag compensation, eq. (22)"
    with picture(path, 11.0, 4.2, headline) as figure:
        over_time, medians = figure.subplots(1, 2, width_ratios=[1.25, 1.0])
        for row, trace in zip(rows, traces, strict=True):
            if row["gains"] == "mid":
                color, label = LOOKS[row["force"], row["lag"]]
                time = np.arange(len(trace)) / 48.0  # set-points a second
                over_time.plot(time, 100.0 * trace, color=color, label=label)
        over_time.axhline(0.0, color=GREY, linewidth=0.8, zorder=0)
        over_time.set(title="One swap, gains mid", xlabel="Time (s)", ylabel="Height error (cm)")
        over_time.grid(True)
        over_time.legend(fontsize=9)
        series = {
            label: (color, [r["median_cm"] for r in rows if (r["force"], r["lag"]) == look])
            for look, (color, label) in LOOKS.items()
        }
        draw_bars(medians, list(GAINS), series)
        medians.set(title="All swaps, by gains", ylim=(0.05, 60.0))
        medians.set_ylabel("Worst height error, median (cm)")
