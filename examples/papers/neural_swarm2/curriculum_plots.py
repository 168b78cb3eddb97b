"""The picture of a curriculum: clearances, errors and explained variance by round."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from swarm_envs.viewing.style import GREY, INK, picture

if TYPE_CHECKING:
    from matplotlib.axes import Axes

BLUE, ORANGE, GREEN = "#0072B2", "#D55E00", "#009E73"


def plot_curriculum(path: Path, report: Mapping[str, Any], goals: Mapping[int, float]) -> None:
    """Draw the rounds of `curriculum.json`; goals are explained shares by number of drones."""
    headline = f"Curriculum in an environment with the force model {report['interactions']!r}"
    with picture(path, 12.0, 4.0, headline) as figure:
        left, middle, right = figure.subplots(1, 3)
        _plot_closeness(left, report)
        _plot_errors(middle, report)
        _plot_explained(right, report, goals)
        for axis in (left, middle, right):
            axis.set_xticks([r["number"] for r in report["rounds"]])
            axis.set_xlabel("round")
            axis.grid(axis="y")


def _plot_closeness(axis: Axes, report: Mapping[str, Any]) -> None:
    number = [r["number"] for r in report["rounds"]]
    planned = [100 * r["clearance_m"] for r in report["rounds"]]
    flown = [100 * r["closeness"].least_clearance_m for r in report["rounds"]]
    error = [100 * r["closeness"].gap_error_m for r in report["rounds"]]
    axis.plot(number, planned, "o-", color=INK, label="least planned")
    axis.plot(number, flown, "s--", color=BLUE, label="least flown")
    axis.plot(number, error, "^:", color=ORANGE, label="error of the gap (95 %)")
    axis.axhline(0.0, color=GREY, linewidth=0.8)
    axis.set_ylabel("vertical clearance of two spheres, cm")
    axis.set_title("How close drones flew")
    axis.legend(fontsize=9)


def _plot_errors(axis: Axes, report: Mapping[str, Any]) -> None:
    number = np.array([r["number"] for r in report["rounds"]])
    zero = [r["zero_mse"] for r in report["rounds"]]
    model = [r["validation_mse"] for r in report["rounds"]]
    axis.bar(number - 0.2, zero, 0.38, color="#C9CDD2", label="no model")
    axis.bar(number + 0.2, model, 0.38, color=BLUE, label="model of the round")
    for x, value in zip(number + 0.2, model, strict=True):
        axis.annotate(f"{value:.2f}", (x, value), ha="center", va="bottom", fontsize=9)
    axis.set_ylabel("MSE of $f_{a,z}$ on held-out flights, g²")
    axis.set_title("Validation, noisy labels")
    axis.legend(fontsize=9)


def _plot_explained(axis: Axes, report: Mapping[str, Any], goals: Mapping[int, float]) -> None:
    number = [r["number"] for r in report["rounds"]]
    for size, color in zip(goals, (BLUE, GREEN, ORANGE), strict=True):
        shares = np.array([u["explained"] for u in report["unseen"] if u["drones"] == size])
        if not len(shares):
            continue
        axis.plot(number, 100 * shares.mean(axis=0), "o-", color=color, label=f"{size} drones")
        low, high = 100 * shares.min(axis=0), 100 * shares.max(axis=0)
        axis.fill_between(number, low, high, color=color, alpha=0.15, linewidth=0)
    for goal in sorted(set(goals.values())):
        axis.axhline(100 * goal, color=GREY, linewidth=0.9, linestyle="--")
        axis.annotate(
            f"goal {100 * goal:.0f}",
            (0.99, 100 * goal),
            xycoords=axis.get_yaxis_transform(),  # right margin
            ha="right",
            va="center",
            fontsize=8,
            color=INK,
            bbox={"boxstyle": "round,pad=0.15", "facecolor": "white", "edgecolor": "none"},
            zorder=5,
        )
    axis.set_ylim(bottom=max(0.0, axis.get_ylim()[0]), top=101)
    axis.set_ylabel("% of the variance of the true $f_{a,z}$")
    axis.set_title("Unseen swaps (band: all teams)")
    axis.legend(fontsize=9, loc="lower right")
