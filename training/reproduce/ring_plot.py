"""Fig. 9 and 1 as pictures: the rings, every drone's error, predicted against true force."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from swarm_envs.training.reproduce.flight_cases import Case
from swarm_envs.training.reproduce.flown import Flown
from swarm_envs.training.reproduce.style import GREY, INK, picture
from swarm_envs.viewing.comparison import COMPENSATED_COLOR, WITHOUT_COLOR

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_OFFSET = 0.17


def plot_rings(
    path: Path,
    report: Mapping[str, Any],
    cases: Sequence[Sequence[Case]],
    flown: Sequence[Sequence[Flown]],
) -> None:
    """Draw one row for each force that blew: errors by drone, and of the worst one over time.

    Args:
        path: the picture to write.
        report: of the flights, as `flight_tests` makes it.
        cases: of each force, one each.
        flown: the flights of each.
    """
    drones = len(cases[0][0].test.task.team)
    headline = f"Intertwined rings of {drones} drones"
    with picture(path, 13.0, 0.9 + 3.4 * len(cases), headline) as figure:
        axes = figure.subplots(
            len(cases), 3, squeeze=False, width_ratios=[0.7 + 0.06 * drones, 1.0, 1.0]
        )
        for row, air, found in zip(axes, report["truths"], flown, strict=True):
            entry = air["cases"][0]
            worst = int(np.argmax([d["without"]["median"] for d in entry["drones"]]))
            _errors(row[0], entry, air["truth"]["name"])
            _height(row[1], found[0], worst, entry)
            _force(row[2], found[0], worst, entry)
        for axis in axes[-1, 1:]:
            axis.set_xlabel("time, s")


def _errors(axis: Axes, entry: Mapping[str, Any], truth: str) -> None:
    drones = entry["drones"]
    places = np.arange(len(drones))
    sides = (
        ("without", WITHOUT_COLOR, -_OFFSET, "without compensation"),
        ("compensated", COMPENSATED_COLOR, _OFFSET, "with compensation"),
    )
    for side, color, offset, label in sides:
        median = np.array([drone[side]["median"] for drone in drones])
        low = np.array([drone[side]["lower_quartile"] for drone in drones])
        high = np.array([drone[side]["upper_quartile"] for drone in drones])
        axis.bar(places + offset, median, 0.32, color=color, label=label)
        axis.errorbar(places + offset, median, [median - low, high - median], fmt="none",
                      ecolor=INK, elinewidth=0.9, capsize=2.0)  # fmt: skip
    axis.set_xticks(places, [d["drone"] for d in drones], rotation=90 if len(drones) > 8 else 0)
    axis.set_ylabel("worst height error, cm")
    axis.set_ylim(0.0, 1.32 * axis.get_ylim()[1])
    axis.set_title(f"Force model {truth!r}: every drone")
    axis.legend(fontsize=8, loc="upper right", ncols=2)
    axis.grid(True, axis="y")


def _height(axis: Axes, flown: Flown, drone: int, entry: Mapping[str, Any]) -> None:
    for k, color in enumerate((WITHOUT_COLOR, COMPENSATED_COLOR)):
        axis.plot(flown.time, flown.height_error_cm[k, :, drone], color=color, linewidth=1.4)
    axis.axhline(0.0, color=GREY, linewidth=0.8)
    axis.set_ylabel("height error, cm")
    axis.set_title(f"One flight, the worst drone ({entry['drones'][drone]['drone']})")
    axis.grid(True)


def _force(axis: Axes, flown: Flown, drone: int, entry: Mapping[str, Any]) -> None:
    axis.plot(flown.time, flown.force_g[1, :, drone], color=INK, linewidth=1.8, label="true")
    axis.plot(flown.time, flown.believed_g[:, drone], color=COMPENSATED_COLOR, linewidth=1.2,
              linestyle="--", label="predicted")  # fmt: skip
    axis.set_ylabel("vertical force, g")
    axis.set_title("The force on it, with compensation")
    low, high = axis.get_ylim()
    axis.set_ylim(low, high + 0.25 * (high - low))
    axis.legend(fontsize=8, loc="upper right", ncols=2, title_fontsize=8,
                title=f"{100 * entry['explained']:.1f} % predicted, of all drones")  # fmt: skip
    axis.grid(True)
