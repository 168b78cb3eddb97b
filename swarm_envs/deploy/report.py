"""What fitted trajectories ask of the drones, and whether they may be flown."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import NamedTuple

import numpy as np

from swarm_envs.deploy.flight import AT_REST, Flight
from swarm_envs.deploy.pieces import (
    MOST_PIECES,
    PIECE_BYTES,
    Pieces,
    deviations,
    evaluate,
    largest_jump,
)
from swarm_envs.state import FloatArray
from swarm_envs.vehicles import GRAM_FORCE, GRAVITY, Vehicle
from swarm_envs.viewing.record import Solid


@dataclass(frozen=True)
class DroneReport:
    """What the trajectory of one drone is, and asks for."""

    name: str
    """As in the environment: `drone_0`."""
    vehicle: str
    """Its type."""
    pieces: int
    """How many it takes."""
    memory_bytes: int
    """Of the firmware's 4096."""
    max_deviation_m: float
    """From the flight, in single precision."""
    rms_deviation_m: float
    """The same in the mean square."""
    max_jump_m: float
    """Of position at a knot, from rounding."""
    max_speed_m_s: float
    """Largest speed."""
    max_acceleration_m_s2: float
    """Largest acceleration, gravity apart."""
    max_thrust_share: float
    """Largest thrust over what the vehicle has, the force of the air included."""
    max_tilt_deg: float
    """Largest angle of the thrust from the vertical."""
    max_force_g: float
    """Largest force of the air in the flight, grams; 0 if it is not known."""
    start: tuple[float, float, float, float]
    """x, y, z (m) and yaw (rad) at its start."""
    end: tuple[float, float, float, float]
    """The same at its end."""


class Separation(NamedTuple):
    """How close drones come to each other."""

    distance_m: float
    """Least distance of two centres; infinite for a single drone."""
    clearance_m: float
    """Least distance less both radii; negative if they collide."""
    pair: tuple[int, int]
    """Who comes closest."""
    time_s: float
    """When."""


@dataclass(frozen=True)
class TeamReport:
    """All drones of a flight."""

    drones: tuple[DroneReport, ...]
    """In their order."""
    duration_s: float
    """Of every trajectory."""
    tolerance_m: float
    """Largest deviation that was allowed."""
    flown: Separation
    """In the flight."""
    fitted: Separation
    """Of the pieces."""
    problems: tuple[str, ...]
    """Why this must not be flown; empty if nothing speaks against it."""
    notes: tuple[str, ...]
    """What is worth a look before it is flown."""


def separation(positions: FloatArray, time: FloatArray, team: Sequence[Vehicle]) -> Separation:
    """Who comes closest to whom, relative to their sizes.

    Args:
        positions: (D, N, 3) m.
        time: (D,) s.
        team: the N vehicles.
    """
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
