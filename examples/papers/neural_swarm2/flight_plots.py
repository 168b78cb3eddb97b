"""Pictures of Fig. 8, 9 and 1: errors with and without compensation."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from examples.papers.neural_swarm2.paired_flights import PLAIN_SWAPS, FlightCase, PairedFlights
from swarm_envs.viewing.comparison import COMPENSATED_COLOR, WITHOUT_COLOR
from swarm_envs.viewing.style import GREY, INK, picture

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

SWAP_OFFSET, BOX_WIDTH, RING_OFFSET = 0.19, 0.32, 0.17
APART = 0.7  # room between plain cases and those with stronger motors


def plot_swaps(
    path: Path,
    report: Mapping[str, Any],
    cases: Sequence[Sequence[FlightCase]],
    flown: Sequence[Sequence[PairedFlights]],
) -> None:
    """Draw one row of boxes for each true force model."""
    names = [case.name for case in cases[0]]
    width = max(6.0, 2.0 + 0.75 * len(names))
    headline = "Stacked swaps: worst height error of the lowest drone"
    with picture(path, width, 1.2 + 3.1 * len(cases), headline) as figure:
        axes = figure.subplots(len(cases), 1, sharex=True, squeeze=False)[:, 0]
        for axis, group, own, found in zip(axes, report["truths"], cases, flown, strict=True):
            _draw_boxes(axis, names, [c.errors(f) for c, f in zip(own, found, strict=True)])
            _mark_paper(axis, names, own)
            _mark_doubtful(axis, names, group["cases"])
            axis.set_title(f"Forces: {group['forces']}")
            axis.set_ylabel("worst height error, cm")
        _add_legend(figure, report["episodes"])


def _places(names: Sequence[str]) -> list[float]:
    return [k + APART * (name not in PLAIN_SWAPS) for k, name in enumerate(names)]


def _draw_boxes(axis: Axes, names: Sequence[str], errors: Sequence[np.ndarray]) -> None:
    places = np.array(_places(names))
    line = {"color": INK, "linewidth": 0.9}
    sides = (WITHOUT_COLOR, -SWAP_OFFSET), (COMPENSATED_COLOR, SWAP_OFFSET)
    for k, (color, offset) in enumerate(sides):
        axis.boxplot(
            [error[k] for error in errors],
            positions=list(places + offset),
            widths=BOX_WIDTH,
            patch_artist=True,
            manage_ticks=False,
            boxprops={"facecolor": color, "edgecolor": color, "linewidth": 1.2},
            medianprops={"color": INK, "linewidth": 1.6},
            whiskerprops=line,
            capprops=line,
            flierprops={"marker": "o", "markersize": 2.5, "markeredgecolor": GREY},
        )
    axis.set_xticks(places, names)
    axis.set_xlim(places[0] - 0.6, places[-1] + 0.6)
    axis.set_ylim(bottom=0.0)
    axis.grid(True, axis="y")


def _mark_paper(axis: Axes, names: Sequence[str], cases: Sequence[FlightCase]) -> None:
    """Mark the medians that the paper gives."""
    for place, case in zip(_places(names), cases, strict=True):
        if case.paper_cm:
            places = [place - SWAP_OFFSET, place + SWAP_OFFSET]
            axis.plot(places, case.paper_cm, "D", color="white", markeredgecolor=INK, zorder=6)


def _mark_doubtful(axis: Axes, names: Sequence[str], rows: Sequence[Mapping[str, Any]]) -> None:
    """Mark cases whose difference may be chance."""
    for place, row in zip(_places(names), rows, strict=True):
        if not row["significant"]:
            axis.annotate("n. s.", (place, 1.0), xycoords=("data", "axes fraction"), ha="center",
                          va="top", fontsize=8, color=GREY)  # fmt: skip


def _add_legend(figure: Figure, episodes: int) -> None:
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    handles = [
        Patch(facecolor=WITHOUT_COLOR, label="without compensation"),
        Patch(facecolor=COMPENSATED_COLOR, label="with compensation"),
        Line2D([], [], color="white", marker="D", markeredgecolor=INK, linestyle="",
               label="the paper's medians"),
    ]  # fmt: skip
    title = f"{episodes} swaps each: median, quartiles, whiskers of 1.5 quartile distances"
    figure.legend(handles=handles, loc="outside lower center", ncols=3, title=title,
                  title_fontsize=9)  # fmt: skip


def plot_rings(
    path: Path,
    report: Mapping[str, Any],
    cases: Sequence[Sequence[FlightCase]],
    flown: Sequence[Sequence[PairedFlights]],
) -> None:
    """Draw one row for each true force model: errors by drone, and of the worst one over time."""
    drones = len(cases[0][0].test.task.team)
    headline = f"Intertwined rings of {drones} drones"
    with picture(path, 13.0, 0.9 + 3.4 * len(cases), headline) as figure:
        axes = figure.subplots(
            len(cases), 3, squeeze=False, width_ratios=[0.7 + 0.06 * drones, 1.0, 1.0]
        )
        for row, group, found in zip(axes, report["truths"], flown, strict=True):
            entry = group["cases"][0]
            worst = int(np.argmax([d["without"]["median"] for d in entry["drones"]]))
            _plot_errors(row[0], entry, group["forces"])
            _plot_height(row[1], found[0], worst, entry)
            _plot_force(row[2], found[0], worst, entry)
        for axis in axes[-1, 1:]:
            axis.set_xlabel("time, s")


def _plot_errors(axis: Axes, entry: Mapping[str, Any], forces: str) -> None:
    drones = entry["drones"]
    places = np.arange(len(drones))
    sides = (
        ("without", WITHOUT_COLOR, -RING_OFFSET, "without compensation"),
        ("compensated", COMPENSATED_COLOR, RING_OFFSET, "with compensation"),
    )
    for side, color, offset, label in sides:
        median = np.array([drone[side]["median"] for drone in drones])
        low = np.array([drone[side]["lower_quartile"] for drone in drones])
        high = np.array([drone[side]["upper_quartile"] for drone in drones])
        axis.bar(places + offset, median, 0.32, color=color, label=label)
        axis.errorbar(places + offset, median, [median - low, high - median], fmt="none",
                      ecolor=INK, elinewidth=0.9, capsize=2.0)  # fmt: skip
    axis.set_xticks(places, [d["drone"] for d in drones], rotation=90 if len(drones) > 8 else 0)
    axis.legend(fontsize=8, loc="upper right", ncols=2)
    axis.set_ylim(0.0, 1.32 * axis.get_ylim()[1])
    axis.set(title=f"Forces: {forces}; every drone", ylabel="worst height error, cm")
    axis.grid(True, axis="y")


def _plot_height(axis: Axes, flown: PairedFlights, drone: int, entry: Mapping[str, Any]) -> None:
    for k, color in enumerate((WITHOUT_COLOR, COMPENSATED_COLOR)):
        axis.plot(flown["time"], flown["height_error_cm"][k, :, drone], color=color, linewidth=1.4)
    title = f"One flight, the worst drone ({entry['drones'][drone]['drone']})"
    axis.set(title=title, ylabel="height error, cm")
    axis.axhline(0.0, color=GREY, linewidth=0.8, zorder=0)
    axis.grid(True)


def _plot_force(axis: Axes, flown: PairedFlights, drone: int, entry: Mapping[str, Any]) -> None:
    axis.plot(flown["time"], flown["force_g"][1, :, drone], color=INK, linewidth=1.8, label="true")
    axis.plot(flown["time"], flown["predicted_g"][:, drone], color=COMPENSATED_COLOR, linewidth=1.2,
              linestyle="--", label="predicted")  # fmt: skip
    axis.set_ylabel("vertical force, g")
    axis.set_title("The force on it, with compensation")
    low, high = axis.get_ylim()
    axis.set_ylim(low, high + 0.25 * (high - low))
    axis.legend(fontsize=8, loc="upper right", ncols=2, title_fontsize=8,
                title=f"{100 * entry['explained']:.1f} % predicted, of all drones")  # fmt: skip
    axis.grid(True)
