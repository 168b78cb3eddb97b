"""Plots of flights."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from swarm_envs.files import written_whole
from swarm_envs.state import FloatArray
from swarm_envs.viewing.record import Comparison, FlightRecord

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

WITHOUT_COLOR = "#D55E00"
"""Vermilion of Okabe and Ito's palette, which colour-blind readers can tell from the blue."""
COMPENSATED_COLOR = "#0072B2"
"""Blue of the same."""

_STYLE: Any = {
    "font.size": 10,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.color": "#E3E6EA",
    "grid.linewidth": 0.8,
    "axes.axisbelow": True,
    "axes.edgecolor": "#60656B",
    "axes.labelcolor": "#202428",
}


def plot_comparisons(path: Path, comparisons: Sequence[Comparison], headline: str) -> None:
    """Plot height error and force of the lowest drone over time, one column a comparison.

    Thin lines are flights, bold ones their median at each time. Drawn without a display.

    Args:
        path: PNG, PDF or SVG to write.
        comparisons: one or more, each with at least one flight a side.
        headline: stands above all.

    Raises:
        ValueError: there is nothing to plot.
        OSError: the file cannot be written.
    """
    if not comparisons:
        raise ValueError("no comparison was given; plot at least one")
    import matplotlib as mpl
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    with mpl.rc_context(_STYLE):
        figure = Figure(figsize=(1.6 + 3.7 * len(comparisons), 6.4), layout="constrained")
        FigureCanvasAgg(figure)
        axes = figure.subplots(
            2,
            len(comparisons),
            sharex=True,
            sharey="row",
            squeeze=False,
            height_ratios=[3, 2],
        )
        for comparison, column in zip(comparisons, axes.T, strict=True):
            _plot_column(comparison, *column)
        axes[0, 0].set_ylabel("Height error of the lowest drone (cm)")
        axes[1, 0].set_ylabel("Vertical interaction force\non the lowest drone (g)")
        _add_legend(figure, axes[0, 0], len(comparisons[0].without))
        figure.suptitle(headline, fontsize=13, fontweight="bold")
        with written_whole(path) as partial:
            figure.savefig(partial, dpi=150)


def _plot_column(comparison: Comparison, upper: Axes, lower: Axes) -> None:
    sides = (
        (comparison.without, WITHOUT_COLOR),
        (comparison.compensated, COMPENSATED_COLOR),
    )
    for flights, color in sides:
        time = max((flight.time for flight in flights), key=len)
        _plot_lines(upper, time, [flight.height_error_cm() for flight in flights], color)
        _plot_lines(lower, time, [flight.vertical_force_g() for flight in flights], color)
    for axis in (upper, lower):
        axis.axhline(0.0, color="#60656B", linewidth=0.8, zorder=1)
        meeting = _meeting_time(comparison.without[0])
        if meeting is not None:
            axis.axvline(meeting, color="#60656B", linewidth=0.8, linestyle=":", zorder=1)
    before, after = np.median(comparison.without_cm), np.median(comparison.compensated_cm)
    upper.set_title(
        f"{comparison.title}\nmedian of worst errors: {before:.1f} → {after:.1f} cm", fontsize=11
    )
    lower.set_xlabel("Time (s)")
    lower.set_xlim(0.0, float(time[-1]))


def _plot_lines(axis: Axes, time: FloatArray, rows: Sequence[FloatArray], color: str) -> None:
    table = np.full((len(rows), len(time)), np.nan)  # a flight may have ended early
    for line, row in zip(table, rows, strict=True):
        line[: len(row)] = row
        axis.plot(time[: len(row)], row, color=color, linewidth=0.8, alpha=0.5)
    axis.plot(time, np.nanmedian(table, axis=0), color=color, linewidth=2.0)


def _meeting_time(flight: FlightRecord) -> float | None:
    """When the drones should be above one another, s; None if the team is a single drone."""
    if len(flight.team) < 2:
        return None
    across = flight.reference[:, :, :2] - flight.reference[:, -1:, :2]
    return float(flight.time[np.argmin(np.linalg.norm(across, axis=2).max(axis=1))])


def _add_legend(figure: Figure, axis: Axes, flights: int) -> None:
    from matplotlib.lines import Line2D

    lines = [
        Line2D([], [], color=WITHOUT_COLOR, linewidth=2.0, label="without compensation"),
        Line2D([], [], color=COMPENSATED_COLOR, linewidth=2.0, label="with compensation"),
        Line2D([], [], color="#60656B", linewidth=0.7, label=f"one of {flights} swaps"),
        Line2D([], [], color="#60656B", linewidth=2.0, label="median"),
        Line2D([], [], color="#60656B", linewidth=0.8, linestyle=":", label="drones in line"),
    ]
    figure.legend(handles=lines, loc="outside lower center", ncols=len(lines), frameon=False)
