"""What the pictures of the papers' figures share: labelled axes, bars side by side, captions."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Literal, NamedTuple

import numpy as np

from swarm_envs.viewing.style import GREY, INK

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


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


class Bars(NamedTuple):
    """One bar in each group."""

    heights: Sequence[float]
    """By group."""
    color: str
    """Of all of them."""
    label: str | None = None
    """In the legend."""


def draw_numbered_bars(axis: Axes, groups: Sequence[str], series: Sequence[Bars]) -> None:
    """Draw bars side by side in each group, on a logarithmic axis, with their heights above."""
    for k, (heights, color, label) in enumerate(series):
        places = np.arange(len(groups)) + 0.2 * (k - 0.5 * (len(series) - 1))
        axis.bar(places, heights, 0.19, color=color, label=label)
        for x, y in zip(places, heights, strict=True):
            said = f"{y:.1f}" if y >= 1.0 else f"{y:.2f}"
            axis.text(x, 1.06 * y, said, ha="center", va="bottom", fontsize=8, color=INK)
    axis.set_yscale("log")
    axis.set_xticks(range(len(groups)), groups)


def write_caption(figure: Figure, text: str) -> None:
    """Say below a picture what its marks mean."""
    figure.supxlabel(text, fontsize=9)
