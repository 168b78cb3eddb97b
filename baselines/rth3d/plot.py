"""A picture of a plan: how the robots come nearer to their goals, and where they are meanwhile."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from swarm_envs.baselines.rth3d.plan import GridPlan
from swarm_envs.files import written_whole

_MOMENTS = (0.0, 0.25, 0.5, 0.75, 1.0)
_MOST_DOTS = 6000


def plot_plan(path: Path, plan: GridPlan) -> None:
    """Draw a plan as .png: five moments seen from above, and the distances to the goals.

    A robot keeps the colour of its goal's place along the long side: at the end the colours are
    sorted.

    Raises:
        OSError: the file cannot be written.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11, 5.2), layout="constrained")
    FigureCanvasAgg(figure)
    grid = figure.add_gridspec(2, len(_MOMENTS), height_ratios=(1, 1.3))
    shown = np.linspace(0, len(plan.starts) - 1, min(_MOST_DOTS, len(plan.starts))).astype(int)
    for column, moment in enumerate(_MOMENTS):
        t = round(moment * plan.makespan)
        axes = figure.add_subplot(grid[0, column])
        x, y, _ = plan.paths[t, shown].T
        axes.scatter(x, y, c=plan.goals[shown, 0], s=2, cmap="viridis", linewidths=0)
        axes.set(title=f"step {t}", aspect="equal", xticks=[], yticks=[])
    _draw_distances(figure.add_subplot(grid[1, :]), plan)
    sides = " x ".join(map(str, plan.shape))
    figure.suptitle(
        f"{len(plan.starts):,} robots on {sides}, {plan.winner}: makespan {plan.makespan}, "
        f"lower bound {plan.lower_bound}, ratio {plan.ratio:.3f}"
    )
    with written_whole(path) as partial:
        figure.savefig(partial, dpi=110)


def _draw_distances(axes: object, plan: GridPlan) -> None:
    """Mean and largest distance to the goal over time, and the least possible for the farthest."""
    from matplotlib.axes import Axes

    assert isinstance(axes, Axes)
    left = np.array([np.abs(now - plan.goals).sum(axis=1) for now in plan.paths])
    steps = np.arange(len(left))
    axes.plot(steps, left.max(axis=1), color="tab:red", label="farthest robot")
    axes.plot(steps, left.mean(axis=1), color="tab:blue", label="mean")
    ideal = np.maximum(plan.lower_bound - steps, 0)
    axes.plot(steps, ideal, color="0.6", linestyle=":", label="no plan is faster")
    axes.set(
        xlabel="step", ylabel="Manhattan distance to the goal", xlim=(0, max(len(left) - 1, 1))
    )
    axes.legend(frameon=False)
