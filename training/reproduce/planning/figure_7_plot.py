"""Fig. 7 as a picture: tracking errors and forces of every trial, by scenario and planner."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from swarm_envs.baselines.neural_swarm.planner.problem import FORCE_BOUNDS_G
from swarm_envs.training.reproduce.style import INK, picture
from swarm_envs.vehicles import parse_team

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_LOOK = {"unaware": ("#D55E00", -0.17, "not knowing the forces (BL)"),
         "aware": ("#0072B2", 0.17, "knowing the forces (NN)")}  # fmt: skip
_NAMES = {"S": "small", "L": "large"}


def plot_figure_7(
    path: Path, cells: Sequence[Mapping[str, Any]], headline: str, plant: str = "model_plant"
) -> None:
    """Draw worst error and worst force of each trial; bars reach to the worst of all.

    Args:
        path: the picture to write.
        cells: as `fly_trial` returns them.
        headline: stands above all.
        plant: whose measures: the key in the cells.
    """
    scenarios = list(dict.fromkeys(cell["scenario"] for cell in cells))
    with picture(path, 12.0, 4.6, headline) as figure:
        axes = figure.subplots(1, 3)
        for planner in _LOOK:
            own = [cell for cell in cells if cell["planner"] == planner]
            _errors(axes[0], scenarios, planner, own, plant)
            for axis, token in zip(axes[1:], "SL", strict=True):
                _forces(axis, scenarios, planner, own, plant, token)
        axes[0].set(title="Worst tracking error", ylabel="Error (cm)")
        for axis, token in zip(axes[1:], "SL", strict=True):
            bound = FORCE_BOUNDS_G[token]
            axis.axhline(bound, color="#C0202A", linewidth=1.4)
            axis.set_title(f"Worst force on {_NAMES[token]} ones, bound {bound:g} g")
            axis.set_ylabel("|f_a,z| (g)")
        axes[0].margins(y=0.2)
        axes[0].legend(fontsize=9, loc="upper right")


def _errors(
    axis: Axes,
    scenarios: Sequence[str],
    planner: str,
    cells: Sequence[Mapping[str, Any]],
    plant: str,
) -> None:
    values = {s: [max(c[plant]["error_cm"]) for c in cells if c["scenario"] == s]
              for s in scenarios}  # fmt: skip
    _dots(axis, values, planner)


def _forces(
    axis: Axes,
    scenarios: Sequence[str],
    planner: str,
    cells: Sequence[Mapping[str, Any]],
    plant: str,
    token: str,
) -> None:
    values: dict[str, list[float]] = {}
    for s in scenarios:
        own = [i for i, vehicle in enumerate(parse_team(s)) if vehicle.token == token]
        if own:
            values[s] = [
                max(c[plant]["force_g"][i] for i in own) for c in cells if c["scenario"] == s
            ]
    _dots(axis, values, planner)


def _dots(axis: Axes, values: Mapping[str, Sequence[float]], planner: str) -> None:
    color, offset, label = _LOOK[planner]
    place = np.arange(len(values)) + offset
    highest = [max(own) for own in values.values()]
    axis.bar(place, highest, 0.3, color=color, alpha=0.35, label=label)
    for x, own in zip(place, values.values(), strict=True):
        spread = x + np.linspace(-0.1, 0.1, len(own)) * (len(own) > 1)
        axis.plot(spread, own, "o", color=color, markersize=4, markeredgecolor="white",
                  markeredgewidth=0.4)  # fmt: skip
    axis.set_xticks(range(len(values)), list(values), color=INK)
    axis.grid(True, axis="y")
