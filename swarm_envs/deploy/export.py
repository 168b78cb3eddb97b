"""A flight's files: for each drone its pieces and its samples, a report, and a picture."""

from __future__ import annotations

import csv
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
from tqdm import tqdm

from swarm_envs.arguments import POSITIVE_M, Range, typed
from swarm_envs.deploy.flight import AT_REST, Flight
from swarm_envs.deploy.pieces import (
    MOST_PIECES,
    Pieces,
    deviations,
    evaluate,
    fit_pieces,
    write_pieces,
)
from swarm_envs.deploy.report import TeamReport, report
from swarm_envs.files import claimed, write_json, written_whole
from swarm_envs.viewing.style import GREY, INK, drone_colors, picture

if TYPE_CHECKING:
    from matplotlib.axes import Axes

__all__ = ["export_flight", "report_content", "report_lines"]

REPORT = "report.json"
"""Name of the file with everything but the trajectories."""
PICTURE = "paths.png"
"""Name of the picture."""
SAMPLE_COLUMNS = ("time", *"xyz", "vx", "vy", "vz", "ax", "ay", "az", "yaw")
"""Of the sampled files: s, m, m/s, m/s^2, rad."""
Tolerance = Annotated[float, POSITIVE_M]
"""Largest distance of a trajectory from the path that was flown, m."""
PieceCount = Annotated[int, Range(1, MOST_PIECES)]
"""Pieces that each drone may take: more do not fit into its memory."""


@typed
def fit_flight(
    flight: Flight,
    tolerance: Tolerance = 0.01,
    most: PieceCount = MOST_PIECES,
    progress: bool = False,
) -> tuple[Pieces, ...]:
    """Pieces for every drone of a flight, all of the same duration.

    Drones that hover at an end of the flight are held at rest there.

    Args:
        flight: of N drones.
        tolerance: largest distance from its path, m.
        most: pieces that each drone may take.
        progress: show a bar.

    Raises:
        ValueError: a tolerance or number that cannot be, or a path that so many pieces do not
            follow; the message names the drone.
    """
    fitted = []
    for i, name in enumerate(tqdm(flight.names, "fit", unit="drone", disable=not progress)):
        first, last = flight.end_speeds[:, i] <= AT_REST
        try:
            fitted.append(
                fit_pieces(
                    flight.dense_time,
                    flight.rows(i),
                    tolerance,
                    most,
                    (bool(first), bool(last)),
                )
            )
        except ValueError as error:
            raise ValueError(f"{name}: {error}") from error
    return tuple(fitted)


@typed
def export_flight(
    flight: Flight,
    folder: str | Path,
    tolerance: Tolerance = 0.01,
    most: PieceCount = MOST_PIECES,
    rate: Annotated[float, Range(0.0, 1000.0, above=True, unit="Hz")] = 100.0,
    source: Mapping[str, Any] | None = None,
    progress: bool = False,
) -> TeamReport:
    """Fit a flight and check it; write its trajectories, samples, `report.json` and `paths.png`.

    Args:
        flight: of N drones.
        folder: made if missing.
        tolerance: largest distance from its path, m.
        most: pieces that each drone may take.
        rate: samples a second.
        source: where the flight comes from, for the report.
        progress: show a bar.

    Raises:
        ValueError: the flight cannot be fitted, or must not be flown; nothing was written.
        OSError: the folder cannot be written.
    """
    fitted = fit_flight(flight, tolerance, most, progress)
    found = report(flight, fitted, tolerance)
    if found.problems:
        raise ValueError("this must not be flown: " + "; ".join(found.problems))
    out = Path(folder)
    with claimed(out):
        for name, pieces in zip(flight.names, fitted, strict=True):
            write_pieces(out / f"{name}.csv", pieces)
            _write_samples(out / f"{name}_samples.csv", pieces, rate)
        _plot(out / PICTURE, flight, fitted, found)
        write_json(out / REPORT, {"source": dict(source or {}), **report_content(found)})
    return found


def report_content(found: TeamReport) -> dict[str, Any]:
    """A report as JSON; distances that are infinite, as those of a single drone, are null."""
    content: dict[str, Any] = asdict(found)
    for name in ("flown", "fitted"):
        measured = getattr(found, name)._asdict()
        content[name] = {
            key: None if isinstance(value, float) and math.isinf(value) else value
            for key, value in measured.items()
        }
    return content


def report_lines(found: TeamReport) -> Sequence[str]:
    """The report as a table to look at."""
    head = "drone      type  pieces  bytes  worst mm  rms mm  speed m/s  acc m/s^2  thrust  tilt"
    lines = [head]
    for drone in found.drones:
        lines.append(
            f"{drone.name:10} {drone.vehicle:4}  {drone.pieces:6}  {drone.memory_bytes:5}  "
            f"{drone.max_deviation_m * 1e3:8.1f}  {drone.rms_deviation_m * 1e3:6.1f}  "
            f"{drone.max_speed_m_s:9.2f}  {drone.max_acceleration_m_s2:9.2f}  "
            f"{drone.max_thrust_share:6.0%}  {drone.max_tilt_deg:3.0f}°"
        )
    if len(found.drones) > 1:
        i, j = found.fitted.pair
        lines.append(
            f"closest: {found.fitted.distance_m:.3f} m (flown {found.flown.distance_m:.3f} m); "
            f"hulls of drone_{i} and drone_{j} {found.fitted.clearance_m:.3f} m apart at "
            f"{found.fitted.time_s:.2f} s"
        )
    return [*lines, *(f"note: {note}" for note in found.notes)]


def _write_samples(path: Path, pieces: Pieces, rate: float) -> None:
    """Position, velocity, acceleration and yaw at a rate, and at the end."""
    time = np.append(np.arange(0.0, pieces.total_s - 0.5 / rate, 1.0 / rate), pieces.total_s)
    parts = [evaluate(pieces, time, order) for order in range(3)]
    rows = np.column_stack([time, *(part[:, :3] for part in parts), parts[0][:, 3]])
    with written_whole(path) as partial, partial.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(SAMPLE_COLUMNS)
        writer.writerows([[f"{value:.6g}" for value in row] for row in rows])


_MOST_COMPARED = 64
"""Of more drones distances over time are not drawn."""


def _plot(path: Path, flight: Flight, fitted: Sequence[Pieces], found: TeamReport) -> None:
    """Draw paths from above, heights, deviations and the least clearance over time."""
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
    first = (float(place[0, 0]), float(place[0, 1]))
    above.plot(*first, "o", color=color, markersize=6)
    above.plot(*place[-1, :2], "s", color=color, markersize=6)
    above.annotate(str(i), first, xytext=(5, 5), textcoords="offset points", color=color)
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
