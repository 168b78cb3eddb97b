"""Pictures of plans, as in Fig. 6: paths with the drones on them, and the forces over time."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from swarm_envs.baselines.neural_swarm import SwarmPlan
from swarm_envs.state import FloatArray
from swarm_envs.vehicles import GRAM_FORCE
from swarm_envs.viewing.style import GREY, INK, draw_drone, drone_colors, picture

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

METERS_PER_GRAM = 0.03  # length of a force's arrow
VISIBLE_G = 0.5  # weaker forces get no arrow
FORCE_COLOR = "#C0392B"
OUTLINES = 5  # moments at which drones are drawn, start and end among them


class PlanColumn(NamedTuple):
    """Motions of a team over T instants, a column of a picture."""

    title: str  # above the column
    times: FloatArray  # (T,) s
    position: FloatArray  # (T, N, 3) m
    force: FloatArray  # (T, N, 3) N


def draw_columns(path: Path, plan: SwarmPlan, columns: Sequence[PlanColumn], headline: str) -> None:
    """Draw motions in the y-z plane between the starts and goals of a plan, and their forces."""
    points = np.concatenate([column.position.reshape(-1, 3) for column in columns])
    extent = np.ptp(points, axis=0) + 0.5
    high = 4.0 * min(max(extent[2] / extent[1], 0.5), 1.2)
    with picture(path, 4.4 * len(columns), high + 3.6, headline) as figure:
        axes = figure.subplots(
            2, len(columns), sharey="row", squeeze=False, height_ratios=[high, 2.6]
        )
        for (above, below), motion in zip(axes.T, columns, strict=True):
            _draw_paths(above, plan, motion)
            _draw_forces(below, plan, motion)
            above.set(title=motion.title, xlabel="y (m)")
        axes[0, 0].set_ylabel("z (m)")
        axes[1, 0].set_ylabel("Vertical force (g)")
        _add_legend(figure, plan)


def _draw_paths(axis: Axes, plan: SwarmPlan, motion: PlanColumn) -> None:
    """Draw all paths, drones at some moments, and arrows of the forces."""
    last = len(motion.times) - 1
    moments = np.linspace(0, last, OUTLINES).round().astype(np.int64)
    for i, (vehicle, color) in enumerate(zip(plan.team, drone_colors(plan.team))):
        y, z = motion.position[:, i, 1], motion.position[:, i, 2]
        axis.plot(y, z, color=color, linewidth=1.6, zorder=3)
        _draw_arrows(axis, y, z, motion.force[:, i, 2] / GRAM_FORCE)
        for rank, k in enumerate(moments):
            draw_drone(axis, vehicle, y[k], z[k], color, 0.25 + 0.65 * rank / (OUTLINES - 1))
        goal = plan.goals[i, 1:]
        axis.plot(*goal, marker="x", color=color, markersize=7, markeredgewidth=1.6, zorder=7)
    axis.set_aspect("equal", adjustable="datalim")
    axis.grid(True)


def _draw_arrows(axis: Axes, across: FloatArray, up: FloatArray, force_g: FloatArray) -> None:
    """Draw vertical arrows where the air pushes."""
    felt = np.abs(force_g) > VISIBLE_G
    if not felt.any():
        return
    style: Any = {"angles": "xy", "scale_units": "xy", "scale": 1.0, "width": 0.004}
    x, y, length = across[felt], up[felt], METERS_PER_GRAM * force_g[felt]
    axis.quiver(x, y, np.zeros_like(length), length, color=FORCE_COLOR, zorder=4, **style)
    axis.update_datalim(np.column_stack([x, y + length]))


def _draw_forces(axis: Axes, plan: SwarmPlan, motion: PlanColumn) -> None:
    """Draw vertical forces over time, and the bound of each type, dashed."""
    colors, limits = drone_colors(plan.team), plan.bounds.force_bounds(plan.team) / GRAM_FORCE
    for force, color in zip(motion.force[..., 2].T / GRAM_FORCE, colors):
        axis.plot(motion.times, force, color=color, linewidth=1.6)
    for limit, color in zip(limits, colors):
        for sign in (-1, 1):
            axis.axhline(sign * limit, color=color, linewidth=1.0, linestyle="--", alpha=0.7)
    axis.axhline(0.0, color=GREY, linewidth=0.8, zorder=1)
    axis.set(xlabel="Time (s)", xlim=(0.0, float(motion.times[-1])))
    axis.grid(True)


def _add_legend(figure: Figure, plan: SwarmPlan) -> None:
    from matplotlib.lines import Line2D

    lines = [
        Line2D([], [], color=color, linewidth=1.8, label=f"{i + 1}: {vehicle.token}")
        for i, (vehicle, color) in enumerate(zip(plan.team, drone_colors(plan.team)))
    ]
    others: Sequence[tuple[str, Any]] = (
        ("goal", {"marker": "x", "linestyle": "none"}),
        ("force bound", {"linestyle": "--", "linewidth": 1.0}),
    )
    lines += [Line2D([], [], color=INK, label=label, **style) for label, style in others]
    arrow = f"force, {10 * METERS_PER_GRAM:.1f} m for 10 g"
    lines.append(Line2D([], [], color=FORCE_COLOR, linewidth=1.6, label=arrow))
    figure.legend(handles=lines, loc="outside lower center", ncols=min(len(lines), 9))
