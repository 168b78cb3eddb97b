"""Pictures of the calibration: predicted against measured bins, and forces over distance."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from swarm_envs.training.reproduce.bins import GROUND, LATERAL, VERTICAL, Bin, compare
from swarm_envs.training.reproduce.style import COLORS, GREY, picture

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_PAIRS = ("S2S", "L2S", "S2L", "L2L")
_SHADES = ("#08306B", "#2171B5", "#6BAED6", "#B5C7DB")
_TITLES = {
    GROUND: "Height above the ground",
    VERTICAL: "Vertical distance to one neighbour",
    LATERAL: "Lateral distance, 0.2-0.4 m below one",
}
_NAMES = {"S": "small", "L": "large"}


def plot_calibration(path: Path, bins: Sequence[Bin], model: str) -> None:
    """Scatter of predicted against measured bin means, one panel a case.

    Args:
        path: the picture to write.
        bins: as `predict_bins` returns them.
        model: its name, for the headline.
    """
    errors = compare(bins)
    ends = [value for b in bins for value in (b.measured_g, b.predicted_g)]
    low, high = min(ends) - 1.5, max(ends) + 1.5
    headline = f"Predicted and measured bin means, model {model!r}"
    with picture(path, 14.0, 5.2, headline) as figure:
        axes = figure.subplots(1, 3)
        for axis, kind in zip(axes, (VERTICAL, LATERAL, GROUND), strict=True):
            _scatter(axis, [b for b in bins if b.kind == kind])
            axis.plot([low, high], [low, high], color=GREY, linewidth=1.0, zorder=1)
            limits = (low, high) if kind != GROUND else (-1.5, 7.5)
            axis.set(xlim=limits, ylim=limits, title=_TITLES[kind], xlabel="Measured (g)")
            axis.set_aspect("equal")
            axis.grid(True)
        axes[0].set_ylabel("Predicted (g)")
        whole = errors["all"]
        figure.supxlabel(
            "Bars: spread of the rows in a bin; larger dots: more rows. Off by "
            f"{whole['root_mean_square_error_g']:.2f} g (root mean square over {whole['rows']:,} "
            "rows). Calibration offsets are subtracted.",
            fontsize=9,
        )


def _scatter(axis: Axes, bins: Sequence[Bin]) -> None:
    for scenario in dict.fromkeys(b.scenario for b in bins):
        own = [b for b in bins if b.scenario == scenario]
        x, y = [b.measured_g for b in own], [b.predicted_g for b in own]
        color, spread = COLORS[scenario], [b.spread_g for b in own]
        axis.errorbar(x, y, xerr=spread, fmt="none", ecolor=color, elinewidth=0.7, alpha=0.3)
        size = [8 + 14 * np.log10(max(b.rows, 10) / 10) for b in own]
        axis.scatter(x, y, size, color, label=scenario, edgecolor="white", linewidth=0.5, zorder=3)
    if bins:
        axis.legend(loc="upper left", handletextpad=0.2)


def plot_curves(path: Path, bins: Sequence[Bin], model: str) -> None:
    """Force over vertical and lateral distance, measured with its spread and predicted.

    Args:
        path: the picture to write.
        bins: as `predict_bins` returns them.
        model: its name, for the headline.
    """
    headline = f"Force over distance: measured (dots) and model {model!r} (lines)"
    with picture(path, 15.0, 8.0, headline) as figure:
        grid = figure.add_gridspec(2, 5)
        for column, scenario in enumerate(_PAIRS):
            above, below = _NAMES[scenario[0]], _NAMES[scenario[-1]]
            for row, kind in enumerate((VERTICAL, LATERAL)):
                axis = figure.add_subplot(grid[row, column])
                _curves(axis, [b for b in bins if b.kind == kind and b.scenario == scenario], kind)
                if row == 0:
                    axis.set_title(f"{scenario}: {below} below {above}")
                if column == 0:
                    axis.set_ylabel("Vertical force (g)")
        for row, scenario in enumerate(("Ge2S", "Ge2L")):
            axis = figure.add_subplot(grid[row, 4])
            _curves(axis, [b for b in bins if b.scenario == scenario], GROUND)
            axis.set_title(f"{_NAMES[scenario[-1]]} alone over the ground")
        figure.supxlabel(
            "Bars: standard deviation of the rows in a bin (shifted aside to be seen). Calibration "
            "offsets are subtracted.",
            fontsize=9,
        )


def _curves(axis: Axes, bins: Sequence[Bin], kind: str) -> None:
    seconds = sorted({b.second or (0.0, 0.0) for b in bins})
    for order, (color, second) in enumerate(zip(_SHADES, seconds, strict=False)):
        own = sorted(
            (b for b in bins if (b.second or (0.0, 0.0)) == second), key=lambda b: b.middle
        )
        scale, unit = (100, "cm") if kind == VERTICAL else (1, "m/s")
        label = f"{second[0] * scale:g}-{second[1] * scale:g} {unit}" if kind != GROUND else None
        for run in _without_gaps(own):
            x, line = [b.middle for b in run], [b.predicted_g for b in run]
            axis.plot(x, line, color=color, linewidth=1.8, label=label)
            label = None
        shift = 0.0 if kind == GROUND else 0.02 * (order - 1) * (own[-1].high - own[0].low)
        axis.errorbar(
            [b.middle + shift for b in own],
            [b.measured_g for b in own],
            [b.spread_g for b in own],
            fmt="o",
            color=color,
            markersize=4,
            markeredgecolor="white",
            markeredgewidth=0.5,
            elinewidth=0.9,
            ecolor=(color, 0.45),
            zorder=3,
        )
    axis.grid(True)
    axis.axhline(0.0, color=GREY, linewidth=0.8)
    labels = {
        GROUND: "Height (m)",
        VERTICAL: "Neighbour above by (m)",
        LATERAL: "Lateral distance (m)",
    }
    axis.set_xlabel(labels[kind])
    if kind != GROUND and bins:
        title = "lateral distance" if kind == VERTICAL else "relative speed"
        axis.legend(
            title=title,
            loc="lower left" if kind == VERTICAL else "lower right",
            fontsize=8,
            title_fontsize=8,
        )


def _without_gaps(bins: Sequence[Bin]) -> list[list[Bin]]:
    """Split sorted bins where one does not begin at the end of the last."""
    runs: list[list[Bin]] = []
    for b in bins:
        if runs and abs(runs[-1][-1].high - b.low) < 1e-6:
            runs[-1].append(b)
        else:
            runs.append([b])
    return runs
