"""The lag study as a picture: one swap over time, and medians of all of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from swarm_envs.training.reproduce.style import GREY, INK, picture

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_LOOK = {
    ("none", "not compensated"): ("#E69F00", "no force, lag not compensated"),
    ("none", "compensated"): ("#D55E00", "no force, lag compensated"),
    ("exact", "not compensated"): ("#56B4E9", "exact force, lag not compensated"),
    ("exact", "compensated"): ("#0072B2", "exact force, lag compensated"),
}
_SAMPLES_PER_SECOND = 48


def plot_lag(
    path: Path, rows: Sequence[Mapping[str, Any]], traces: Mapping[str, Sequence[float]]
) -> None:
    """Draw height errors of the first swap over time, default gains, and medians by gains.

    Args:
        path: the picture to write.
        rows: as `reproduce_lag` returns them.
        traces: height error (m) of each variant's first swap, in the order of the rows.
    """
    headline = "A small drone passes under a large one: lag compensation, eq. (22)"
    with picture(path, 11.0, 4.2, headline) as figure:
        over_time, medians = figure.subplots(1, 2, width_ratios=[1.25, 1.0])
        for row, trace in zip(rows, traces.values(), strict=True):
            if row["gains"] == "mid":
                color, label = _LOOK[row["force"], row["lag"]]
                time = np.arange(len(trace)) / _SAMPLES_PER_SECOND
                over_time.plot(time, 100.0 * np.array(trace), color=color, label=label)
        over_time.axhline(0.0, color=GREY, linewidth=0.8, zorder=0)
        over_time.set(xlabel="Time (s)", ylabel="Height error (cm)", title="One swap, gains mid")
        over_time.legend(fontsize=9)
        over_time.grid(True)
        _medians(medians, rows)


def _medians(axis: Axes, rows: Sequence[Mapping[str, Any]]) -> None:
    gains = list(dict.fromkeys(row["gains"] for row in rows))
    for k, (look, (color, _)) in enumerate(_LOOK.items()):
        own = [row for row in rows if (row["force"], row["lag"]) == look]
        place = np.array([gains.index(row["gains"]) for row in own]) + 0.2 * (k - 1.5)
        height = [row["median_cm"] for row in own]
        axis.bar(place, height, 0.19, color=color)
        for x, y in zip(place, height, strict=True):
            axis.text(
                x,
                1.06 * y,
                f"{y:.1f}" if y >= 1.0 else f"{y:.2f}",
                ha="center",
                va="bottom",
                fontsize=8,
                color=INK,
            )
    axis.set_yscale("log")
    axis.set_ylim(0.05, 60.0)
    axis.set_xticks(range(len(gains)), gains)
    axis.set(ylabel="Worst height error, median (cm)", title="All swaps, by gains")
    axis.grid(True, axis="y")
