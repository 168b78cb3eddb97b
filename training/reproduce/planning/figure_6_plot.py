"""Fig. 6 as a picture: paths in the y-z plane above, forces over time below."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from swarm_envs.baselines.neural_swarm.planner.plan import SwarmPlan
from swarm_envs.baselines.neural_swarm.planner.problem import FORCE_BOUNDS_G
from swarm_envs.baselines.neural_swarm.planner.trajectories import Trajectories
from swarm_envs.state import FloatArray
from swarm_envs.training.reproduce.planning.plant import Track, plan_at
from swarm_envs.training.reproduce.style import GREY, picture
from swarm_envs.vehicles import GRAM_FORCE

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_COLORS = ("#0072B2", "#E69F00", "#009E73")
"""Blue and orange for the small robots, green for the large one, as in the paper."""
_FINE_S = 1.0 / 60.0


def plot_figure_6(path: Path, plans: Mapping[str, SwarmPlan], tracks: Mapping[str, Track]) -> None:
    """Draw stage 1, stage 2 as planned and tracked, and the plan that does not know the forces.

    Args:
        path: the picture to write.
        plans: `aware` and `unaware`.
        tracks: what became of them on the planner's own model.
    """
    aware, unaware = plans["aware"], plans["unaware"]
    headline = "Fig. 6: two small robots and a large one exchange positions"
    with picture(path, 13.0, 6.0, headline) as figure:
        above, below = figure.subplots(2, 3, sharex="row", sharey="row")
        columns = (
            ("Stage 1, knowing the forces", aware, aware.initial, None),
            ("Stage 2, knowing the forces", aware, aware.trajectories, tracks["aware"]),
            ("Not knowing the forces", unaware, unaware.trajectories, tracks["unaware"]),
        )
        for k, (title, plan, motions, track) in enumerate(columns):
            _paths(above[k], plan, motions, track)
            _forces(below[k], plan, motions, track)
            above[k].set(title=title, xlabel="y (m)", xticks=(-1.0, -0.5, 0.0, 0.5, 1.0))
            below[k].set_xlabel("Time (s)")
        above[0].set_ylabel("z (m)")
        below[0].set_ylabel("f_a,z (g)")
        below[0].legend(fontsize=8, ncols=3, loc="lower right", bbox_to_anchor=(1.0, 1.0))
        figure.supxlabel(
            "Dashed: planned, or the bounds of the forces. Solid: tracked by a PID in the air that "
            "the model knows. Discs: the robots half way. Arrows: velocity every second.",
            fontsize=9,
        )


def _paths(axis: Axes, plan: SwarmPlan, motions: Trajectories, track: Track | None) -> None:
    times = np.arange(0.0, motions.duration, _FINE_S)
    planned, _, _ = plan_at(motions, times)
    when, flown = (times, planned) if track is None else (track.time, track.position)
    speed = plan_at(motions, times)[1] if track is None else track.velocity
    for i, vehicle in enumerate(plan.team):
        color = _COLORS[i % len(_COLORS)]
        if track is not None:
            axis.plot(planned[:, i, 1], planned[:, i, 2], "--", color=color, linewidth=1.0)
        axis.plot(flown[:, i, 1], flown[:, i, 2], color=color, linewidth=1.7, label=vehicle.token)
        seconds = np.searchsorted(when, np.arange(1.0, motions.duration))
        axis.quiver(flown[seconds, i, 1], flown[seconds, i, 2], speed[seconds, i, 1],
                    speed[seconds, i, 2], color=color, angles="xy", scale_units="xy", scale=4.0,
                    width=0.006, zorder=4)  # fmt: skip
        _body(axis, flown[np.searchsorted(when, 0.5 * motions.duration), i], vehicle.radius, color)
        axis.plot(*plan.starts[i, 1:], "o", color=color, markersize=4)
        axis.plot(*plan.goals[i, 1:], "s", color=color, markersize=5, markerfacecolor="white")
    axis.set_aspect("equal")
    axis.grid(True)


def _body(axis: Axes, place: FloatArray, radius: float, color: str) -> None:
    from matplotlib.patches import Circle

    circle = Circle((float(place[1]), float(place[2])), radius, facecolor=color, alpha=0.35)
    axis.add_patch(circle)


def _forces(axis: Axes, plan: SwarmPlan, motions: Trajectories, track: Track | None) -> None:
    time = motions.times if track is None else track.time
    force = motions.forces if track is None else track.force
    for i, vehicle in enumerate(plan.team):
        color, bound = _COLORS[i % len(_COLORS)], FORCE_BOUNDS_G[vehicle.token]
        name = "small" if vehicle.token == "S" else "large"
        axis.plot(time, force[:, i, 2] / GRAM_FORCE, color=color, label=name)
        for side in (-1.0, 1.0):
            axis.axhline(side * bound, color=color, linestyle="--", linewidth=0.9)
    axis.axhline(0.0, color=GREY, linewidth=0.8)
    axis.grid(True)
