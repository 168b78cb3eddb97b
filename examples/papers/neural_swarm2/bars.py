"""Bars side by side with their numbers above."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from swarm_envs.viewing.style import INK

if TYPE_CHECKING:
    from matplotlib.axes import Axes


def draw_bars(
    axis: Axes, groups: Sequence[str], series: Mapping[str, tuple[str, Sequence[float]]]
) -> None:
    """Draw series (color and heights by label) on a logarithmic axis, numbers above the bars."""
    for k, (label, (color, heights)) in enumerate(series.items()):
        places = np.arange(len(groups)) + 0.2 * (k - 0.5 * (len(series) - 1))
        bars = axis.bar(places, heights, 0.19, color=color, label=label)
        axis.bar_label(bars, [f"{y:.3g}" for y in heights], fontsize=8, color=INK)
    axis.set_yscale("log")
    axis.set_xticks(range(len(groups)), groups)
    axis.grid(True, axis="y")
