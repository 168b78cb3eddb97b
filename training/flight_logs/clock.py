"""Resampling of a flight's drones, the interaction force, and the filter of entries.

The force is m a / g - T R[:, 2] (Neural-Swarm2, Sec. VII-B); the filter is that of the Neural-Swarm
authors.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from scipy.interpolate import CubicSpline

from swarm_envs.motors import FULL_VOLTAGE, rotor_force_g
from swarm_envs.state import BoolArray, FloatArray
from swarm_envs.training.collection.log import force_from_motion
from swarm_envs.training.flight_logs.checks import PWM_SPAN, RUNNING, DroneLog
from swarm_envs.training.interaction_rows.drone_rows import near_any
from swarm_envs.vehicles import GRAM_FORCE, Team


class ClockedFlight(NamedTuple):
    """A flight of N drones at T evenly spaced times. World frame, SI units; 0 where not `known`."""

    names: tuple[str, ...]  # Names of the physical vehicles
    team: Team  # Their types
    rate_hz: float  # Samples per second
    time: FloatArray  # (T,) s since the first common sample
    known: BoolArray  # (T,) True outside gaps of the logs of all drones
    running: BoolArray  # (T,) True if the motors of all drones run
    position: FloatArray  # (T, N, 3)
    velocity: FloatArray  # (T, N, 3)
    quaternion: FloatArray  # (T, N, 4) of unit length
    acceleration: FloatArray | None  # (T, N, 3) with gravity; None unless logged for all drones
    pwm: FloatArray  # (T, N, 4)
    voltage: FloatArray  # (T, N)


GAP_S = 0.05  # Least duration of a gap of a log, which is not filled, s; at least three steps


def common_clock(drones: Sequence[DroneLog], rate_hz: float) -> ClockedFlight:
    """Resample drones to common times over the period that all of them logged.

    The rate is `rate_hz`, or that of the slowest log if it is lower. Motion and attitude are
    interpolated by cubic splines, motor signals and voltage linearly, but not across gaps.

    Raises:
        ValueError: the drones have less than a second in common.
    """
    begin = max(float(drone.time[0]) for drone in drones)
    end = min(float(drone.time[-1]) for drone in drones)
    if end - begin < 1.0:
        spans = ", ".join(f"{d.name}: {d.time[0]:g} to {d.time[-1]:g} s" for d in drones)
        raise ValueError(
            f"the drones' logs have {max(end - begin, 0.0):.2f} s in common ({spans}), but must "
            "have 1 s; use one clock for all drones, and one file per flight"
        )
    rate = min(rate_hz, *(1.0 / drone.step_s for drone in drones))
    time = np.arange(int((end - begin) * rate + 1e-6) + 1) / rate
    logged = all(drone.acceleration is not None for drone in drones)
    parts = [_resample(drone, begin + time, logged) for drone in drones]
    smooth, held, known = (np.stack(part, axis=1) for part in zip(*parts, strict=True))
    length = np.linalg.norm(smooth[..., 6:10], axis=-1, keepdims=True)
    return ClockedFlight(
        names=tuple(drone.name for drone in drones),
        team=tuple(drone.vehicle for drone in drones),
        rate_hz=rate,
        time=time,
        known=np.asarray(known.all(axis=1)),
        running=(held[..., :4].mean(axis=-1) > RUNNING * PWM_SPAN).all(axis=1),
        position=smooth[..., 0:3],
        velocity=smooth[..., 3:6],
        quaternion=smooth[..., 6:10] / np.where(length > 0.0, length, 1.0),
        acceleration=smooth[..., 10:13] if logged else None,
        pwm=held[..., :4],
        voltage=held[..., 4],
    )


def pieces(mask: BoolArray) -> list[slice]:
    """Return the runs of True in a mask (T,)."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], mask, [False]]).astype(np.int8)))
    return [slice(int(a), int(b)) for a, b in zip(edges[::2], edges[1::2], strict=True)]


def _resample(
    drone: DroneLog, time: FloatArray, logged: bool
) -> tuple[FloatArray, FloatArray, BoolArray]:
    """Return motion (T, 10 or 13), signals and voltage (T, 5), and a mask of known times (T,)."""
    columns = [drone.position, drone.velocity, continuous(drone.quaternion)]
    if logged and drone.acceleration is not None:
        columns.append(drone.acceleration)
    values, held = np.hstack(columns), np.column_stack([drone.pwm, drone.voltage])
    smooth, linear = (np.zeros((len(time), lines.shape[1])) for lines in (values, held))
    known = np.zeros(len(time), dtype=np.bool_)
    gaps = np.flatnonzero(np.diff(drone.time) > max(GAP_S, 3.0 * drone.step_s)) + 1
    for lines in np.split(np.arange(len(drone.time)), gaps):
        own = drone.time[lines]
        inside = (time >= own[0] - 1e-9) & (time <= own[-1] + 1e-9)
        if len(lines) < 4 or not inside.any():
            continue
        smooth[inside] = CubicSpline(own, values[lines])(time[inside])
        for column in range(held.shape[1]):
            linear[inside, column] = np.interp(time[inside], own, held[lines, column])
        known[inside] = True
    return smooth, linear, known


def continuous(quaternion: FloatArray) -> FloatArray:
    """Return quaternions (T, 4) without jumps of sign between consecutive ones."""
    dot = (quaternion[1:] * quaternion[:-1]).sum(axis=1)
    sign = np.concatenate([[1.0], np.cumprod(np.where(dot < 0.0, -1.0, 1.0))])
    return quaternion * sign[:, None]


def commanded_thrust(pwm: FloatArray, voltage: FloatArray, team: Team) -> FloatArray:
    """Return rotor thrusts (T, N, 4), N, by the thrust curve (psi1) at voltages (T, N), V."""
    thrust = np.empty_like(pwm)
    for i, vehicle in enumerate(team):
        volts = voltage[:, i, None] / FULL_VOLTAGE
        thrust[:, i] = GRAM_FORCE * rotor_force_g(vehicle, pwm[:, i] / PWM_SPAN, volts)
    return thrust


SETTLED = 5.0
"""Number of motor time constants after which an unknown initial thrust has no effect."""


def interaction_force_g(flight: ClockedFlight, smoothing_s: float) -> FloatArray:
    """Return the interaction force (T, N, 3), gram-force, world frame, at all times of a flight.

    It is NaN where it is unknown: in gaps, while motors do not run, for five motor time constants
    after either, and where the derivative or the Hann window of `smoothing_s` is incomplete.
    """
    force = np.full(flight.position.shape, np.nan)
    slowest = min(vehicle.motor_rate for vehicle in flight.team)
    settling = int(np.ceil(SETTLED / slowest * flight.rate_hz))
    for piece in pieces(flight.known & flight.running):
        if piece.stop - piece.start > settling + 5:
            force[piece] = force_from_motion(
                flight.velocity[piece],
                None if flight.acceleration is None else flight.acceleration[piece],
                flight.quaternion[piece],
                commanded_thrust(flight.pwm[piece], flight.voltage[piece], flight.team),
                flight.team,
                flight.rate_hz,
                smoothing_s,
            )
            force[piece.start : piece.start + settling] = np.nan
    return force


LOWEST_M = {"S": 0.07, "L": 0.085}
"""Least height of a drone in flight, by interaction type, m."""
LARGEST_G = 50.0  # Largest vertical force of a row, g; larger ones are impacts
LARGEST_UPWARD_G = 35.0  # Largest upward force of a row aloft, g
ALOFT_M = 0.25  # Height above which a drone is aloft, m


def kept_entries(
    flight: ClockedFlight, force_g: FloatArray, i: int, keep_every: int
) -> tuple[BoolArray, dict[str, int]]:
    """Apply the authors' filter to every `keep_every`-th entry of drone i.

    Returns:
        The mask (T,) of entries that become rows, and the numbers of the others by reason.
    """
    label, height = force_g[:, i, 2], flight.position[:, i, 2]
    has_neighbor = near_any(flight.position)[:, i] if len(flight.team) > 1 else True
    rules: dict[str, Any] = {
        "between kept entries": np.arange(len(label)) % keep_every == 0,
        "force unknown": np.isfinite(force_g[:, i]).all(axis=-1),
        "no neighbor in the volume": has_neighbor,
        "too low": height > LOWEST_M[flight.team[i].interaction_type],
        "force over 50 g": np.abs(label) <= LARGEST_G,
        "upward force over 35 g aloft": (label <= LARGEST_UPWARD_G) | (height <= ALOFT_M),
    }
    keep, dropped = np.ones(len(label), dtype=np.bool_), {}
    for reason, fair in rules.items():
        dropped[reason] = int((keep & ~np.asarray(fair)).sum())
        keep &= fair
    return keep, dropped
