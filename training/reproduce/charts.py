"""What the pictures of the papers' figures share: labelled axes, and bars side by side."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Literal

import numpy as np

from swarm_envs.viewing.style import GREY, INK

if TYPE_CHECKING:
    from matplotlib.axes import Axes


def label_axis(
    axis: Axes,
    title: str = "",
    xlabel: str = "",
    ylabel: str = "",
    *,
    grid: Literal["both", "x", "y"] = "both",
    legend: float | None = None,
    zero: bool = False,
) -> None:
    """Label an axis; give it a grid, a legend of a font size, and a line at height 0."""
    said = {"title": title, "xlabel": xlabel, "ylabel": ylabel}
    axis.set(**{name: text for name, text in said.items() if text})
    axis.grid(True, axis=grid)
    if zero:
        axis.axhline(0.0, color=GREY, linewidth=0.8, zorder=0)
    if legend is not None:
        axis.legend(fontsize=legend)


def draw_numbered_bars(
    axis: Axes, groups: Sequence[str], series: Sequence[tuple[Sequence[float], str, str | None]]
) -> None:
    """Draw series (heights by group, colour, name) as bars on a logarithmic axis, numbers above."""
    for k, (heights, color, label) in enumerate(series):
        places = np.arange(len(groups)) + 0.2 * (k - 0.5 * (len(series) - 1))
        axis.bar(places, heights, 0.19, color=color, label=label)
        for x, y in zip(places, heights, strict=True):
            said = f"{y:.1f}" if y >= 1.0 else f"{y:.2f}"
            axis.text(x, 1.06 * y, said, ha="center", va="bottom", fontsize=8, color=INK)
    axis.set_yscale("log")
    axis.set_xticks(range(len(groups)), groups)
