"""A picture of an exported flight: where drones fly, and how near each other they come."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from swarm_envs.deploy.fit import deviations
from swarm_envs.deploy.flight import Flight
from swarm_envs.deploy.pieces import Pieces, evaluate
from swarm_envs.deploy.report import TeamReport
from swarm_envs.viewing.palette import drone_colors
from swarm_envs.viewing.style import GREY, INK, picture

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_MOST_COMPARED = 64
"""Of more drones distances over time are not drawn."""


def plot_export(path: Path, flight: Flight, fitted: Sequence[Pieces], found: TeamReport) -> None:
    """Draw paths from above, heights, deviations and the least clearance over time.

    Args:
        path: PNG, PDF or SVG to write.
        flight: what was fitted.
        fitted: the N trajectories.
        found: the report on them.

    Raises:
        OSError: the file cannot be written.
    """
    headline = f"{len(fitted)} drones, {found.duration_s:.1f} s"
    with picture(path, 11.0, 6.4, headline) as figure:
        grid = figure.add_gridspec(3, 2, width_ratios=[1.1, 1.0])
        above = figure.add_subplot(grid[:, 0])
        beside = [figure.add_subplot(grid[k, 1]) for k in range(3)]
        for i, (pieces, color) in enumerate(zip(fitted, drone_colors(flight.team), strict=True)):
            _draw(above, beside, flight, i, pieces, color)
        above.set(xlabel="x (m)", ylabel="y (m)", title="From above: start ●, end ■, knots |")
        above.set_aspect("equal", adjustable="datalim")
        beside[0].set(ylabel="Height (m)")
        beside[1].set(ylabel="Deviation (mm)")
        beside[1].axhline(found.tolerance_m * 1e3, color=GREY, linestyle=":", linewidth=0.9)
        _clearance(beside[2], flight, fitted)
        beside[2].set(xlabel="Time (s)", ylabel="Nearest hulls (m)")


def _draw(
    above: Axes, beside: Sequence[Axes], flight: Flight, i: int, pieces: Pieces, color: str
) -> None:
    time = flight.dense_time
    place = evaluate(pieces, time)
    above.plot(place[:, 0], place[:, 1], color=color, linewidth=1.4)
    above.plot(*place[0, :2], "o", color=color, markersize=6)
    above.plot(*place[-1, :2], "s", color=color, markersize=6)
    above.annotate(str(i), place[0, :2], xytext=(5, 5), textcoords="offset points", color=color)
    knots = evaluate(pieces, pieces.knots[1:-1])
    above.plot(knots[:, 0], knots[:, 1], "|", color=INK, markersize=7)
    beside[0].plot(time, place[:, 2], color=color, linewidth=1.2)
    distance, _ = deviations(pieces, time, flight.rows(i))
    beside[1].plot(time, distance * 1e3, color=color, linewidth=0.9)


def _clearance(axis: Axes, flight: Flight, fitted: Sequence[Pieces]) -> None:
    """Distance of the two nearest hulls over time."""
    if not 1 < len(fitted) <= _MOST_COMPARED:
        return
    time, radius = flight.dense_time, np.array([vehicle.radius for vehicle in flight.team])
    place = np.stack([evaluate(pieces, time)[:, :3] for pieces in fitted], axis=1)
    nearest = np.full(len(time), np.inf)
    for i in range(len(fitted) - 1):
        gap = np.linalg.norm(place[:, i + 1 :] - place[:, i : i + 1], axis=-1)
        nearest = np.minimum(nearest, (gap - radius[i + 1 :] - radius[i]).min(axis=1))
    axis.plot(time, nearest, color=INK, linewidth=1.2)
    axis.axhline(0.0, color=GREY, linewidth=0.8)
