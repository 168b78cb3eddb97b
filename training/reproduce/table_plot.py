"""Table III as a picture: our error beside the paper's, and where a sum over pairs falls short."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from swarm_envs.training.reproduce.style import GREY, INK, picture

if TYPE_CHECKING:
    from matplotlib.axes import Axes

OURS, PAPER, SUM = "#0072B2", "#B8BEC5", "#D55E00"
"""Colours of our values, of the paper's, and of sums."""


def plot_table(path: Path, table: Mapping[str, Any]) -> None:
    """Draw the bars of a table that `ablation.run_ablation` made; rows without runs are left out.

    Args:
        path: the picture to write.
        table: the table; with the cells `H=20,L=4` and `pairwise` their scenarios are drawn too.
    """
    rows = [row for row in table["rows"] if row["ours_g2"] is not None]
    named = {row["cell"]: row for row in rows}
    both = [named[name] for name in ("H=20,L=4", "pairwise") if name in named]
    parts = 1 + (len(both) == 2)
    height = 1.4 + max(0.52 * len(rows), 0.34 * len(both[0]["scenarios_g2"]) if parts > 1 else 0.0)
    with picture(path, 6.6 * parts, height, "Validation error of f_a,z: ablations") as figure:
        axes = figure.subplots(1, parts, squeeze=False)[0]
        _cells(axes[0], rows)
        if parts > 1:
            _scenarios(axes[1], both)


def _cells(axis: Axes, rows: Sequence[Mapping[str, Any]]) -> None:
    place = np.arange(len(rows))
    drawn = (-0.19, "ours", OURS, "ours"), (0.19, "paper", PAPER, "Neural-Swarm2")
    for offset, kind, color, label in drawn:
        values = [row[f"{kind}_g2"] for row in rows]
        spread = [row[f"{kind}_deviation_g2"] or np.nan for row in rows]
        shown = [k for k, value in enumerate(values) if value is not None]
        width = [values[k] for k in shown]
        axis.barh(
            place[shown] + offset, width, 0.36, xerr=[spread[k] for k in shown], color=color,
            label=label, error_kw={"ecolor": INK, "elinewidth": 1.0, "capsize": 2.0},
        )  # fmt: skip
        for k, value in zip(shown, width, strict=True):
            end = value + np.nan_to_num(spread[k])
            axis.annotate(f"{value:.2f}", (end, place[k] + offset), xytext=(4, 0), fontsize=8,
                          textcoords="offset points", va="center", color=INK)  # fmt: skip
    axis.set_yticks(place, [row["cell"] for row in rows])
    axis.invert_yaxis()
    axis.set_xlabel("Mean squared error (g²); whiskers: one standard deviation of single runs")
    axis.margins(x=0.12)
    _legend(axis)
    axis.set_title("Cells of Table III and beside it")
    axis.grid(True, axis="x")


def _scenarios(axis: Axes, both: Sequence[Mapping[str, Any]]) -> None:
    names = sorted(both[0]["scenarios_g2"], key=_order)
    place = np.arange(len(names))
    for offset, row, color, label in zip(
        (-0.19, 0.19), both, (OURS, SUM), ("deep set", "sum over pairs"), strict=True
    ):
        values = [row["scenarios_g2"][name] for name in names]
        axis.barh(place + offset, values, 0.36, color=color, label=label)
    axis.set_yticks(place, names)
    axis.invert_yaxis()
    three = [k for k, name in enumerate(names) if is_three_drones(name)]
    if three:
        axis.axhspan(three[0] - 0.5, three[-1] + 0.5, color="#F4F1E6", zorder=0)
        axis.text(0.99, three[-1] + 0.4, "three drones", ha="right", va="bottom", color=GREY,
                  transform=axis.get_yaxis_transform())  # fmt: skip
    axis.set_xlabel("Mean squared error (g²)")
    _legend(axis)
    axis.set_title("By scenario")
    axis.grid(True, axis="x")


def _legend(axis: Axes) -> None:
    """Beside the title, where no bar can be."""
    axis.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=2, fontsize=9, borderpad=0.0)


def _order(scenario: str) -> tuple[bool, bool, str]:
    """Lone drones first, then pairs, then three."""
    return is_three_drones(scenario), not scenario.startswith("Ge"), scenario


def is_three_drones(scenario: str) -> bool:
    """Whether a scenario such as `SL2S` has two neighbours."""
    above = scenario.partition("2")[0]
    return above != "Ge" and len(above) == 2
