"""The limit study as a picture: error with and without compensation in every sweep."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from swarm_envs.training.reproduce.studies.sweeps import Sweep
from swarm_envs.training.reproduce.style import GREY, picture

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_COLORS = ("#0072B2", "#D55E00")
_BELIEFS = {"exact": ("-", "o"), "shipped": (":", "s")}
_HARM = "#C0202A"
_STRETCHED = ("delay",)
"""Sweeps whose values spread over orders of magnitude."""


def plot_limits(path: Path, sweeps: Sequence[Sweep], rows: Sequence[Mapping[str, Any]]) -> None:
    """Draw one panel a sweep; where compensation hurts, points are red.

    Args:
        path: the picture to write.
        sweeps: what was varied.
        rows: as `reproduce_limits` returns them.
    """
    columns = min(3, len(sweeps))
    lines = -(-len(sweeps) // columns)
    headline = "Limits of compensation: worst height error of the lowest drone (cm)"
    with picture(path, 4.5 * columns, 3.1 * lines + 0.9, headline) as figure:
        axes = figure.subplots(lines, columns, squeeze=False).ravel()
        for axis, sweep in zip(axes, sweeps):
            _panel(axis, sweep, [row for row in rows if row["sweep"] == sweep.name])
        for axis in axes[len(sweeps) :]:
            axis.set_axis_off()
        figure.supxlabel(
            "Medians. Dashed: without compensation. Solid: belief exact but for what is varied; "
            "dotted: the belief that ships. Red ring: compensation made the median worse; "
            "red cross: it made drones crash.",
            fontsize=9,
        )


def _panel(axis: Axes, sweep: Sweep, rows: Sequence[Mapping[str, Any]]) -> None:
    cases = list(dict.fromkeys(row["case"] for row in rows))
    for color, case in zip(_COLORS, cases, strict=False):
        for belief, (dashes, marker) in _BELIEFS.items():
            own = [row for row in rows if (row["case"], row["belief"]) == (case, belief)]
            if not own:
                continue
            x = [row["value"] for row in own]
            label = case if belief == "exact" else None
            axis.plot(x, [row["compensated_cm"] for row in own], dashes, color=color,
                      marker=marker, markersize=3.5, label=label)  # fmt: skip
            _mark_harm(axis, own)
            if belief == "exact":
                axis.plot(x, [row["without_cm"] for row in own], "--", color=color)
    axis.set_yscale("log")
    axis.set_ylim(0.02, 120.0)
    axis.set_yticks([0.1, 1.0, 10.0, 100.0], ["0.1", "1", "10", "100"])
    if sweep.name in _STRETCHED:
        axis.set_xscale("symlog", linthresh=10.0, linscale=0.5)
        axis.set_xlim(-0.5, 750.0)
        shown = (0, 10, 40, 160, 640)
        axis.set_xticks(shown, [str(value) for value in shown])
        axis.minorticks_off()
    axis.set_xlabel(sweep.label)
    axis.legend(fontsize=8, loc="best")
    axis.grid(True)
    axis.tick_params(axis="y", colors=GREY)


def _mark_harm(axis: Axes, rows: Sequence[Mapping[str, Any]]) -> None:
    """Ring the points at which compensation made the median worse, cross those with collisions."""
    worse = [row for row in rows if row["ratio"] > 1.0]
    axis.plot([row["value"] for row in worse], [row["compensated_cm"] for row in worse], "o",
              markersize=10, markerfacecolor="none", markeredgecolor=_HARM,
              markeredgewidth=1.6)  # fmt: skip
    crashed = [row for row in rows if row["crashed"] > row["crashed_without"]]
    axis.plot([row["value"] for row in crashed], [row["compensated_cm"] for row in crashed], "x",
              markersize=9, color=_HARM, markeredgewidth=1.8, zorder=5)  # fmt: skip
