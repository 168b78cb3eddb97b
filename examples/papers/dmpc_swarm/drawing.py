"""Pictures of DMPC-Swarm's figures."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from examples.papers.common import Array
from examples.papers.dmpc_swarm.flights import CRASH_M, ReferenceFlight
from swarm_envs.baselines.mlr_dmpc import MlrDmpcConfig
from swarm_envs.viewing.style import GREY, picture

COLORS = ("#0072B2", "#D55E00", "#009E73")
PALE, CRASH = "#C9CED4", "#B00020"


def draw_formations(path: Path, places: Mapping[str, Array], box: Any) -> None:
    """Draw the places (N, 3), m, of each formation in the box that drones fly in."""
    with picture(path, 12.0, 3.6, "Fig. 3a: the formations") as figure:
        for k, (name, points) in enumerate(places.items()):
            axis: Any = figure.add_subplot(1, len(places), k + 1, projection="3d")
            axis.scatter(*points.T, s=30, c=points[:, 2], cmap="viridis", depthshade=False)
            for x, y, z in points:
                axis.plot([x, x], [y, y], [0.0, z], color=GREY, linewidth=0.5)
            low, high = box
            axis.set(title=name, xlabel="x (m)", ylabel="y (m)")
            axis.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), zlim=(0.0, high[2]))
            axis.set_box_aspect((1, 1, 0.75))


def draw_sequence(
    path: Path,
    headline: str,
    flights: Mapping[str, ReferenceFlight],
    totals: Mapping[str, tuple[float, float]],
) -> None:
    """Draw the mean distance to the targets over time, and bars of the times to the last arrival.

    Args:
        path: of the PNG file.
        headline: above the picture.
        flights: a flight of each case.
        totals: our median and the public simulation's time, s, by case.
    """
    with picture(path, 11.0, 4.2, headline) as canvas:
        left, right = canvas.subplots(1, 2, width_ratios=(2.2, 1.0))
        for (name, flight), color in zip(flights.items(), COLORS, strict=True):
            away = np.linalg.norm(flight.position - flight.target, axis=-1).mean(axis=-1)
            left.plot(flight.time, away, color=color, label=name)
            for arrival in flight.arrivals_s:
                left.axvline(arrival, color=color, linewidth=0.7, linestyle=":")
        left.set(xlabel="Time (s)", ylabel="Mean distance to the targets (m)")
        left.set_title("Dotted: all have arrived")
        left.legend(fontsize=10)
        left.grid(True)
        place = np.arange(len(totals))
        ours, public = np.nan_to_num(np.array(list(totals.values()))).T
        right.bar(place - 0.2, ours, 0.4, color=COLORS, label="swarm-envs")
        right.bar(place + 0.2, public, 0.4, color=PALE, label="public simulation")
        right.set_xticks(place, list(totals))
        right.set_ylabel("Time to the last arrival (s)")
        right.legend(fontsize=8)
        right.grid(True, axis="y")


def draw_jam(path: Path, flights: Mapping[str, ReferenceFlight], jam_s: float) -> None:
    """Draw the paths seen from above by recovery, and the least distance of any two references."""
    headline = "Fig. 4: no compute unit receives anything for two seconds"
    with picture(path, 12.0, 4.2, headline) as figure:
        *paths, last = figure.subplots(
            1, len(flights) + 1, width_ratios=(*[1.0] * len(flights), 1.5)
        )
        for axis, (name, flight) in zip(paths, flights.items(), strict=True):
            axis.plot(flight.position[..., 0], flight.position[..., 1], linewidth=0.8)
            axis.plot(*flight.target[0, :, :2].T, "s", markersize=4, color=GREY)
            axis.set_aspect("equal")
            ended = "not all arrive" if flight.total_s is None else f"{flight.total_s:.1f} s"
            outcome = "crash" if flight.scaled_distance.min() < CRASH_M else ended
            axis.set(title=f"{name}: {outcome}", xlabel="x (m)")
        for (name, flight), color in zip(flights.items(), COLORS, strict=True):
            last.plot(flight.time, flight.scaled_distance, color=color, label=name)
        last.axvspan(0.0, jam_s, color="#F1E3D3", label="jammed")
        last.axhline(MlrDmpcConfig().distance_m, color=GREY, linestyle="--", linewidth=0.9)
        last.axhline(CRASH_M, color=CRASH, linestyle="--", linewidth=0.9)
        last.set(xlabel="Time (s)", ylabel="Least scaled distance (m)", ylim=(0.0, 0.5))
        last.legend(fontsize=8, title="recovery")
        last.grid(True)
