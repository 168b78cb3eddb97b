"""Pictures of plans, like Fig. 6: paths with the drones on them, and the forces over time."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from swarm_envs.arguments import typed
from swarm_envs.baselines.neural_swarm.planner.plan import SwarmPlan
from swarm_envs.baselines.neural_swarm.planner.trajectories import predict_forces
from swarm_envs.interactions import InteractionModel
from swarm_envs.state import FloatArray
from swarm_envs.vehicles import GRAM_FORCE, team_string
from swarm_envs.viewing.style import GREY, INK, draw_drone, drone_colors, picture

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["PlanColumn", "draw_columns"]

_AXES = "xyz"
_METRES_PER_GRAM = 0.03  # length of a force's arrow
_VISIBLE_G = 0.5  # weaker forces get no arrow
_FORCE_COLOR = "#C0392B"
_OUTLINES = 5  # moments at which drones are drawn, start and end among them


class PlanColumn(NamedTuple):
    """Motions of a team over T instants, as a column of a picture shows them.

    Args:
        title: above the column.
        times: (T,) s.
        position: (T, N, 3) m.
        force: (T, N, 3) N.
    """

    title: str
    times: FloatArray
    position: FloatArray
    force: FloatArray


@typed
def plot_plan(
    path: str | Path,
    plan: SwarmPlan,
    unaware: SwarmPlan | None = None,
    model: InteractionModel | None = None,
) -> None:
    """Draw a plan after stage 1 and after stage 2, and a plan made without forces.

    Args:
        path: PNG, PDF or SVG to write.
        plan: of whatever team.
        unaware: a plan for the same team by a planner that knew of no forces.
        model: the forces that the unaware plan will meet; needed with it.

    Raises:
        ValueError: an unaware plan without a model, or of another team.
        OSError: the file cannot be written.
    """
    columns = [
        PlanColumn(title, m.times, m.position, m.forces)
        for title, m in (("Stage 1: search", plan.initial), ("Stage 2: refined", plan.trajectories))
    ]
    if unaware is not None:
        columns.append(_met_by(unaware, plan, model))
    where = "in the y-z plane" if plan.plane == "yz" else "in space"
    headline = f"Plan of {team_string(plan.team)} {where}, forces as {plan.model_name!r} has them"
    draw_columns(Path(path), plan, columns, headline)


def draw_columns(path: Path, plan: SwarmPlan, columns: Sequence[PlanColumn], headline: str) -> None:
    """Draw motions between the starts and goals of a plan, and the forces on them, as columns."""
    views = ((1, 2),) if plan.plane == "yz" else ((0, 1), (1, 2))
    points = np.concatenate([column.position.reshape(-1, 3) for column in columns])
    extent = np.ptp(points, axis=0) + 0.5
    ratios = [4.0 * min(max(extent[high] / extent[wide], 0.5), 1.2) for wide, high in views] + [2.6]
    with picture(path, 4.4 * len(columns), sum(ratios) + 1.0, headline) as figure:
        shape = len(ratios), len(columns)
        axes = figure.subplots(*shape, sharey="row", squeeze=False, height_ratios=ratios)
        for column, motion in zip(axes.T, columns, strict=True):
            for axis, view in zip(column, views):
                _draw_paths(axis, plan, motion, view)
            _draw_forces(column[-1], plan, motion)
            column[0].set_title(motion.title)
        for row, view in zip(axes, views):
            row[0].set_ylabel(f"{_AXES[view[1]]} (m)")
        axes[-1, 0].set_ylabel("Vertical force (g)")
        _add_legend(figure, plan)


def _met_by(unaware: SwarmPlan, plan: SwarmPlan, model: InteractionModel | None) -> PlanColumn:
    if model is None:
        raise ValueError("an unaware plan is given, but no model of the forces it will meet")
    if unaware.team != plan.team:
        raise ValueError(
            f"the unaware plan is of team {team_string(unaware.team)!r}, but the plan of "
            f"{team_string(plan.team)!r}; give plans of one team"
        )
    forces = predict_forces(model, plan.team, unaware.states)
    motions = unaware.trajectories
    return PlanColumn("Planned without forces", motions.times, motions.position, forces)


def _draw_paths(axis: Axes, plan: SwarmPlan, motion: PlanColumn, view: tuple[int, int]) -> None:
    """Paths of all drones, outlines at some moments, arrows of the forces if seen from the side."""
    from matplotlib.patches import Circle

    colors, last = drone_colors(plan.team), len(motion.times) - 1
    moments = np.linspace(0, last, _OUTLINES).round().astype(np.int64)
    for i, (vehicle, color) in enumerate(zip(plan.team, colors)):
        first, second = (motion.position[:, i, k] for k in view)
        axis.plot(first, second, color=color, linewidth=1.6, zorder=3)
        if view[1] == 2:
            _draw_arrows(axis, first, second, motion.force[:, i, 2] / GRAM_FORCE)
        for rank, k in enumerate(moments):
            alpha = 0.25 + 0.65 * rank / (_OUTLINES - 1)
            if view[1] == 2:
                draw_drone(axis, vehicle, first[k], second[k], color, alpha)
            else:
                place = (first[k], second[k])
                axis.add_patch(
                    Circle(place, vehicle.radius, facecolor=color, alpha=0.6 * alpha, zorder=5)
                )
        goal = plan.goals[i, list(view)]
        axis.plot(*goal, marker="x", color=color, markersize=7, markeredgewidth=1.6, zorder=7)
    axis.set_aspect("equal", adjustable="datalim")
    axis.set_xlabel(f"{_AXES[view[0]]} (m)")
    axis.grid(True)


def _draw_arrows(axis: Axes, across: FloatArray, up: FloatArray, force_g: FloatArray) -> None:
    """Vertical arrows where the air pushes, as long as it is strong."""
    felt = np.abs(force_g) > _VISIBLE_G
    if not felt.any():
        return
    style: Any = {"angles": "xy", "scale_units": "xy", "scale": 1.0, "width": 0.004}
    x, y, length = across[felt], up[felt], _METRES_PER_GRAM * force_g[felt]
    axis.quiver(x, y, np.zeros_like(length), length, color=_FORCE_COLOR, zorder=4, **style)
    axis.update_datalim(np.column_stack([x, y + length]))


def _draw_forces(axis: Axes, plan: SwarmPlan, motion: PlanColumn) -> None:
    """Vertical forces over time, and the bound of each type, dashed."""
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
    arrow = f"force, {10 * _METRES_PER_GRAM:.1f} m for 10 g"
    lines.append(Line2D([], [], color=_FORCE_COLOR, linewidth=1.6, label=arrow))
    figure.legend(handles=lines, loc="outside lower center", ncols=min(len(lines), 9))
