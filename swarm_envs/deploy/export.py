"""What fitted trajectories ask of the drones, whether they may be flown, and a flight's files."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from itertools import combinations
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

import numpy as np
from tqdm import tqdm

from swarm_envs.arguments import POSITIVE_M, Range, typed
from swarm_envs.deploy.flight import AT_REST, Flight
from swarm_envs.deploy.pieces import (
    MOST_PIECES,
    PIECE_BYTES,
    Pieces,
    deviations,
    evaluate,
    fit_pieces,
    largest_jump,
    write_csv,
    write_pieces,
)
from swarm_envs.files import claimed, write_json
from swarm_envs.state import FloatArray
from swarm_envs.vehicles import GRAM_FORCE, GRAVITY, Vehicle
from swarm_envs.viewing.record import Solid
from swarm_envs.viewing.style import GREY, INK, drone_colors, picture

if TYPE_CHECKING:
    from matplotlib.axes import Axes

__all__ = ["export_flight", "report_content", "report_lines"]


@dataclass(frozen=True)
class DroneReport:
    """What the trajectory of one drone is, and asks for."""

    name: str  # As in the environment: `drone_0`
    vehicle: str  # Its type
    pieces: int  # How many it takes
    memory_bytes: int  # Of the firmware's 4096
    max_deviation_m: float  # From the flight, in single precision
    rms_deviation_m: float  # The same in the mean square
    max_jump_m: float  # Of position at a knot, from rounding
    max_speed_m_s: float  # Largest speed
    max_acceleration_m_s2: float  # Largest acceleration, gravity apart
    max_thrust_share: float
    """Largest thrust over what the vehicle has, the force of the air included."""
    max_tilt_deg: float  # Largest angle of the thrust from the vertical
    max_force_g: float  # Largest force of the air in the flight, grams; 0 if it is not known
    start: tuple[float, float, float, float]  # x, y, z (m) and yaw (rad) at its start
    end: tuple[float, float, float, float]  # The same at its end


class Separation(NamedTuple):
    """How close drones come to each other."""

    distance_m: float  # Least distance of two centres; infinite for a single drone
    clearance_m: float  # Least distance less both radii; negative if they collide
    pair: tuple[int, int]  # Who comes closest
    time_s: float  # When


@dataclass(frozen=True)
class TeamReport:
    """All drones of a flight."""

    drones: tuple[DroneReport, ...]  # In their order
    duration_s: float  # Of every trajectory
    tolerance_m: float  # Largest deviation that was allowed
    flown: Separation  # In the flight
    fitted: Separation  # Of the pieces
    problems: tuple[str, ...]  # Why this must not be flown; empty if nothing speaks against it
    notes: tuple[str, ...]  # What is worth a look before it is flown


def separation(positions: FloatArray, time: FloatArray, team: Sequence[Vehicle]) -> Separation:
    """Who comes closest to whom, relative to their sizes; (D, N, 3), m, at times (D,), s."""
    distance, found = np.inf, Separation(np.inf, np.inf, (0, 0), 0.0)
    for i, j in combinations(range(len(team)), 2):
        gap = np.linalg.norm(positions[:, i] - positions[:, j], axis=1)
        k = int(gap.argmin())
        distance = min(distance, float(gap[k]))
        clearance = float(gap[k]) - team[i].radius - team[j].radius
        if clearance < found.clearance_m:
            found = Separation(np.inf, clearance, (i, j), float(time[k]))
    return found._replace(distance_m=distance)


def report(flight: Flight, fitted: Sequence[Pieces], tolerance: float) -> TeamReport:
    """Compare fitted pieces with their flight, and judge them.

    Args:
        flight: what was fitted.
        fitted: the N trajectories.
        tolerance: largest deviation that was allowed, m.
    """
    time, team = flight.dense_time, flight.team
    drones = tuple(_drone(flight, i, pieces) for i, pieces in enumerate(fitted))
    flown = separation(flight.dense_position, time, team)
    positions = np.stack([evaluate(p, time, single=True)[:, :3] for p in fitted], axis=1)
    now = separation(positions, time, team)
    problems = [*_collisions(flight, flown, now, tolerance), *_around(flight, positions)]
    for drone, pieces in zip(drones, fitted, strict=True):
        problems += _beyond_limits(drone, pieces)
    return TeamReport(
        drones,
        max(pieces.total_s for pieces in fitted),
        tolerance,
        flown,
        now,
        tuple(problems),
        tuple(_notes(flight, drones)),
    )


def _drone(flight: Flight, drone: int, pieces: Pieces) -> DroneReport:
    time, rows, vehicle = flight.dense_time, flight.rows(drone), flight.team[drone]
    distance, _ = deviations(pieces, time, rows)
    velocity, acceleration = (evaluate(pieces, time, order)[:, :3] for order in (1, 2))
    force = flight.forces(drone)
    thrust = vehicle.mass * (acceleration + np.array([0.0, 0.0, GRAVITY])) - force
    size = np.linalg.norm(thrust, axis=1)
    first, last = (tuple(map(float, evaluate(pieces, t))) for t in (0.0, pieces.total_s))
    return DroneReport(
        name=flight.names[drone],
        vehicle=vehicle.token,
        pieces=len(pieces),
        memory_bytes=PIECE_BYTES * len(pieces),
        max_deviation_m=float(distance.max()),
        rms_deviation_m=float(np.sqrt(np.mean(distance**2))),
        max_jump_m=largest_jump(pieces),
        max_speed_m_s=float(np.linalg.norm(velocity, axis=1).max()),
        max_acceleration_m_s2=float(np.linalg.norm(acceleration, axis=1).max()),
        max_thrust_share=float(size.max() / vehicle.max_thrust),
        max_tilt_deg=float(np.degrees(np.arccos(np.clip(thrust[:, 2] / size, -1.0, 1.0)).max())),
        max_force_g=float(np.linalg.norm(force, axis=1).max() / GRAM_FORCE),
        start=(first[0], first[1], first[2], first[3]),
        end=(last[0], last[1], last[2], last[3]),
    )


def _collisions(
    flight: Flight, flown: Separation, fitted: Separation, tolerance: float
) -> list[str]:
    problems, names = [], flight.names
    for what, found in (("in the flight itself", flown), ("on the fitted paths", fitted)):
        if found.clearance_m < 0.0:
            i, j = found.pair
            problems.append(
                f"{names[i]} and {names[j]} collide {what}: at {found.time_s:.2f} s their hulls "
                f"overlap by {-found.clearance_m * 1e3:.0f} mm"
            )
    if fitted.clearance_m < flown.clearance_m - 2.0 * tolerance:
        i, j = fitted.pair
        problems.append(
            f"{names[i]} and {names[j]} come {(flown.clearance_m - fitted.clearance_m) * 1e3:.0f} "
            f"mm closer than in the flight, more than twice the tolerance"
        )
    return problems


def _around(flight: Flight, positions: FloatArray) -> list[str]:
    """Drones that touch the floor or an obstacle."""
    problems = []
    for i, vehicle in enumerate(flight.team):
        low = float(positions[:, i, 2].min())
        if low < vehicle.radius:
            problems.append(f"{flight.names[i]} comes within {low:.3f} m of the floor, or below it")
        for k, solid in enumerate(flight.about.solids if flight.about else ()):
            gap = float(_distance(positions[:, i], solid).min()) - vehicle.radius
            if gap < 0.0:
                problems.append(f"{flight.names[i]} hits obstacle {k} by {-gap * 1e3:.0f} mm")
    return problems


def _distance(points: FloatArray, solid: Solid) -> FloatArray:
    """Distance (D,) of points (D, 3) from a box or an upright cylinder, m; 0 inside."""
    low, high = np.array(solid.low), np.array(solid.high)
    out = np.maximum(np.maximum(low - points, points - high), 0.0)
    if not solid.round:
        return np.asarray(np.linalg.norm(out, axis=1))
    centre, radius = 0.5 * (low + high)[:2], 0.5 * (high[0] - low[0])
    beside = np.maximum(np.linalg.norm(points[:, :2] - centre, axis=1) - radius, 0.0)
    return np.asarray(np.hypot(beside, out[:, 2]))


def _beyond_limits(drone: DroneReport, pieces: Pieces) -> list[str]:
    problems = []
    if drone.max_thrust_share > 1.0:
        problems.append(
            f"{drone.name} needs {drone.max_thrust_share:.0%} of the thrust of {drone.vehicle!r}"
        )
    if drone.pieces > MOST_PIECES:
        problems.append(f"{drone.name} takes {drone.pieces} pieces; {MOST_PIECES} fit into memory")
    for when, t in (("starts", 0.0), ("ends", pieces.total_s)):
        speed = float(np.linalg.norm(evaluate(pieces, t, 1)[:3]))
        if speed > AT_REST:
            problems.append(
                f"{drone.name} {when} at {speed:.2f} m/s, but the firmware stands still before and "
                "after a trajectory; add ramps (--settle-s 1)"
            )
    return problems


def _notes(flight: Flight, drones: Sequence[DroneReport]) -> list[str]:
    notes = []
    for when in ("start", "end"):
        for a, b in combinations(range(len(drones)), 2):
            first, second = (np.array(getattr(drones[k], when)) for k in (a, b))
            gap = float(np.linalg.norm((first - second)[:2]))
            if gap < 2.0 * (flight.team[a].radius + flight.team[b].radius):
                notes.append(
                    f"{drones[a].name} and {drones[b].name} {when} {gap:.2f} m apart seen from "
                    "above: let them take off and land one after the other"
                )
    for drone in drones:
        if drone.max_thrust_share > 0.9:
            notes.append(f"{drone.name} needs {drone.max_thrust_share:.0%} of its thrust")
        if drone.max_force_g > 5.0:
            notes.append(
                f"{drone.name} flew through {drone.max_force_g:.0f} g of downwash, for which stock "
                "firmware does not compensate"
            )
    return notes


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
    """Pieces for every drone, all of one duration; who hovers at an end is held at rest there."""
    fitted = []
    for i, name in enumerate(tqdm(flight.names, "fit", unit="drone", disable=not progress)):
        first, last = flight.end_speeds[:, i] <= AT_REST
        try:
            fitted.append(
                fit_pieces(
                    flight.dense_time, flight.rows(i), tolerance, most, (bool(first), bool(last))
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
        _plot(out / "paths.png", flight, fitted, found)
        write_json(out / "report.json", {"source": dict(source or {}), **report_content(found)})
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
    write_csv(path, SAMPLE_COLUMNS, [[f"{value:.6g}" for value in row] for row in rows])


_MOST_COMPARED = 64  # Of more drones distances over time are not drawn


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
