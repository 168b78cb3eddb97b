"""A flight's files: for each drone its pieces and its samples, and what they ask for."""

from __future__ import annotations

import csv
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from swarm_envs.deploy.fit import fit_pieces
from swarm_envs.deploy.flight import AT_REST, Flight
from swarm_envs.deploy.pieces import MOST_PIECES, Pieces, evaluate, write_pieces
from swarm_envs.deploy.plot import plot_export
from swarm_envs.deploy.report import TeamReport, report
from swarm_envs.files import claimed, write_json, written_whole

REPORT = "report.json"
"""Name of the file with everything but the trajectories."""
PICTURE = "paths.png"
"""Name of the picture."""
SAMPLE_COLUMNS = ("time", *"xyz", "vx", "vy", "vz", "ax", "ay", "az", "yaw")
"""Of the sampled files: s, m, m/s, m/s^2, rad."""


def fit_flight(
    flight: Flight, tolerance: float = 0.01, most: int = MOST_PIECES, progress: bool = False
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
    if not 0.0 < tolerance < np.inf:
        raise ValueError(f"tolerance is {tolerance}, but must be positive and finite")
    if not 1 <= most <= MOST_PIECES:
        raise ValueError(f"most is {most}, but must be from 1 to {MOST_PIECES}: memory ends there")
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


def export_flight(
    flight: Flight,
    folder: str | Path,
    tolerance: float = 0.01,
    most: int = MOST_PIECES,
    rate: float = 100.0,
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
    if not 0.0 < rate <= 1000.0:
        raise ValueError(f"rate is {rate}, but must be positive and at most 1000")
    fitted = fit_flight(flight, tolerance, most, progress)
    found = report(flight, fitted, tolerance)
    if found.problems:
        raise ValueError("this must not be flown: " + "; ".join(found.problems))
    out = Path(folder)
    with claimed(out):
        for name, pieces in zip(flight.names, fitted, strict=True):
            write_pieces(out / f"{name}.csv", pieces)
            _write_samples(out / f"{name}_samples.csv", pieces, rate)
        plot_export(out / PICTURE, flight, fitted, found)
        write_json(out / REPORT, {"source": dict(source or {}), **report_content(found)})
    return found


def report_content(found: TeamReport) -> dict[str, Any]:
    """A report as JSON has it; of a single drone, which is far from nobody, with null."""
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
