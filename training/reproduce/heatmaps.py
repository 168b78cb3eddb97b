"""Pictures of Fig. 5: eight heat maps, and where pairs do not add up."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from swarm_envs.state import FloatArray
from swarm_envs.training.reproduce.maps import (
    BELOW_M,
    HALF_WIDTH_M,
    HEIGHT_M,
    LOWEST_MEASURED_M,
    ForceMap,
)
from swarm_envs.training.reproduce.style import (
    INK,
    draw_drone,
    draw_ground,
    force_colors,
    picture,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


def plot_heat_maps(path: Path, maps: Sequence[ForceMap], model: str) -> None:
    """Draw the eight maps on one colour scale.

    Args:
        path: the picture to write.
        maps: (a) to (h).
        model: its name, for the headline.
    """
    lowest = min(float(m.force_g.min()) for m in maps)
    highest = max(float(m.force_g.max()) for m in maps)
    headline = f"Force on a small drone among its neighbours, model {model!r} (Fig. 5 of the paper)"
    with picture(path, 14.0, 8.0, headline) as figure:
        axes = figure.subplots(2, 4)
        for axis, found in zip(axes.flat, maps, strict=True):
            colors = _draw(axis, found, found.force_g, (lowest, highest))
            case = found.case
            axis.set_title(f"({case.letter})  {case.title}")
        _finish(figure, axes, colors, "Vertical force (g): red pushes down")


def plot_gaps(path: Path, maps: Sequence[ForceMap], model: str) -> None:
    """Draw sum of pairs minus joint force where there is more than one neighbour."""
    several = [m for m in maps if len(m.case.neighbours) > 1]
    largest = max(float(np.abs(m.gap_g).max()) for m in several) or 1.0
    headline = f"Sum of pair forces minus joint force, model {model!r}"
    with picture(path, 14.0, 4.6, headline) as figure:
        axes = figure.subplots(1, len(several), squeeze=False)
        for axis, found in zip(axes.flat, several, strict=True):
            colors = _draw(axis, found, found.gap_g, (-largest, largest), 1.0)
            gap, y, z = found.extreme_gap()
            axis.plot([y], [z], marker="o", markersize=7, markerfacecolor="none", color=INK)
            axis.set_title(f"({found.case.letter})  largest {gap:+.1f} g (ring)")
        label = "Gap (g): red where the pairs\nwould push down more"
        _finish(figure, axes, colors, label)


def _draw(
    axis: Axes,
    found: ForceMap,
    value: FloatArray,
    limits: tuple[float, float],
    contour_g: float = 2.5,
) -> Any:
    span = (found.y[0], found.y[-1], found.z[0], found.z[-1])
    colors = axis.imshow(
        value,
        extent=span,
        origin="lower",
        cmap=force_colors(*limits),
        vmin=limits[0],
        vmax=limits[1],
        interpolation="bilinear",
    )
    steps = np.arange(np.ceil(limits[0] / contour_g), limits[1] / contour_g) * contour_g
    steps = steps[np.abs(steps) > 1e-9]
    if len(steps) and np.ptp(value) > contour_g:
        lines = axis.contour(found.y, found.z, value, steps, colors=INK, linewidths=0.5, alpha=0.55)
        axis.clabel(lines, steps[::2], fmt="%g", fontsize=7)
    if found.case.ground:
        draw_ground(axis)
        axis.axhline(LOWEST_MEASURED_M, color=INK, linewidth=0.7, linestyle=":", zorder=3)
    for neighbour in found.case.neighbours:
        draw_drone(axis, neighbour.kind, neighbour.y, neighbour.z)
        if neighbour.vy:
            _draw_arrow(axis, neighbour.y, neighbour.z, neighbour.vy)
    base = found.case.floor_m
    axis.set(xlim=(-HALF_WIDTH_M, HALF_WIDTH_M), xticks=[-0.4, -0.2, 0, 0.2, 0.4])
    axis.set_ylim(base - BELOW_M, base + HEIGHT_M)
    axis.set_aspect("equal")
    return colors


def _draw_arrow(axis: Axes, y: float, z: float, speed: float) -> None:
    start, length = y + 0.09, 0.22 * speed
    axis.annotate(
        "",
        (start + length, z),
        (start, z),
        arrowprops={"arrowstyle": "-|>", "color": INK, "linewidth": 1.6},
        zorder=6,
    )


def _finish(figure: Figure, axes: Any, colors: Any, label: str) -> None:
    for axis in axes[-1]:
        axis.set_xlabel("y (m)")
    for axis in axes[:, 0]:
        axis.set_ylabel("Height z (m)")
    bar = figure.colorbar(colors, ax=axes, shrink=0.75, aspect=30, pad=0.015)
    bar.set_label(label)
    bar.outline.set_linewidth(0.5)
    figure.supxlabel(
        "Drones drawn to scale; dashed: ground; dotted: the lowest height that was measured",
        fontsize=9,
        color=INK,
    )
