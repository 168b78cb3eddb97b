"""The picture of a curriculum: how close drones flew, what was fitted, what it explains."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from swarm_envs.training.curriculum.report import CurriculumReport
from swarm_envs.training.curriculum.unseen import GOALS
from swarm_envs.training.reproduce.style import COLORS, GREY, INK, picture

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_SIZE_COLORS = dict(zip(GOALS, (COLORS["S2S"], COLORS["S2L"], COLORS["L2S"]), strict=True))


def draw(report: CurriculumReport, path: Path) -> None:
    """Draw the rounds and write the picture, whole, to `path` (PNG, PDF or SVG)."""
    headline = f"Curriculum in an environment with the force model {report.interactions!r}"
    with picture(path, 12.0, 4.0, headline) as figure:
        left, middle, right = figure.subplots(1, 3)
        _closeness(left, report)
        _errors(middle, report)
        _explained(right, report)
        for axis in (left, middle, right):
            axis.set_xticks([r.number for r in report.rounds])
            axis.set_xlabel("round")
            axis.grid(axis="y")


def _closeness(axis: Axes, report: CurriculumReport) -> None:
    number = [r.number for r in report.rounds]
    planned = [100 * r.clearance_m for r in report.rounds]
    flown = [100 * r.closeness.least_clearance_m for r in report.rounds]
    error = [100 * r.closeness.gap_error_m for r in report.rounds]
    axis.plot(number, planned, "o-", color=INK, label="least planned")
    axis.plot(number, flown, "s--", color=COLORS["S2S"], label="least flown")
    axis.plot(number, error, "^:", color=COLORS["L2S"], label="error of the gap (95 %)")
    axis.axhline(0.0, color=GREY, linewidth=0.8)
    axis.set_ylabel("vertical clearance of two spheres, cm")
    axis.set_title("How close drones flew")
    axis.legend(fontsize=9)


def _errors(axis: Axes, report: CurriculumReport) -> None:
    number = np.array([r.number for r in report.rounds])
    zero = [r.zero_mse for r in report.rounds]
    model = [r.validation_mse for r in report.rounds]
    axis.bar(number - 0.2, zero, 0.38, color="#C9CDD2", label="no model")
    axis.bar(number + 0.2, model, 0.38, color=COLORS["S2S"], label="model of the round")
    for x, value in zip(number + 0.2, model, strict=True):
        axis.annotate(f"{value:.2f}", (x, value), ha="center", va="bottom", fontsize=9)
    axis.set_ylabel("MSE of $f_{a,z}$ on held-out flights, g²")
    axis.set_title("Validation, noisy labels")
    axis.legend(fontsize=9)


def _explained(axis: Axes, report: CurriculumReport) -> None:
    number = [r.number for r in report.rounds]
    for size, color in _SIZE_COLORS.items():
        shares = np.array([u.explained for u in report.unseen if u.drones == size])
        if not len(shares):
            continue
        axis.plot(number, 100 * shares.mean(axis=0), "o-", color=color, label=f"{size} drones")
        low, high = 100 * shares.min(axis=0), 100 * shares.max(axis=0)
        axis.fill_between(number, low, high, color=color, alpha=0.15, linewidth=0)
    for goal in sorted(set(GOALS.values())):
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
