"""Interaction force from a log, as Neural-Swarm2 computes it (Sec. VII-B, with the lag of eq. 1c).

    f_a = m a + m g k - R T k

The acceleration a is differentiated from the logged velocity over five points, or is what the
accelerometer read; the thrust T is what the motor lag makes of the logged commands, the attitude R
is as logged, the mass m is the type's. A log is all that these functions are given.
"""

from __future__ import annotations

from typing import Literal

import numpy as np
from scipy.signal import lfilter

from swarm_envs.arguments import typed
from swarm_envs.state import FloatArray
from swarm_envs.training.collection.log import LOG_RATE, FlightLog, world_acceleration
from swarm_envs.vehicles import GRAM_FORCE, GRAVITY, Team

SMOOTHING_S = 0.1
"""Width of the window that labels of differentiated velocity are averaged over: a drone moves some
centimetres meanwhile."""

Label = Literal["differentiated", "imu"]
"""Where the acceleration of a label comes from."""


def derivative(values: FloatArray, step: float) -> FloatArray:
    """Five-point derivative along the first axis (T, ...); NaN for the two entries at each end."""
    result = np.full(values.shape, np.nan)
    outer, inner = values[4:] - values[:-4], values[3:-1] - values[1:-3]
    result[2:-2] = (8.0 * inner - outer) / (12.0 * step)
    return result


def lagged_thrust(commands: FloatArray, team: Team, step: float) -> FloatArray:
    """Total thrust (T, N), N, that commands (T, N, 4), N, lead to: eq. (1c), from hover.

    Between two entries the command is taken as their mean.
    """
    command = commands.sum(axis=-1)
    held = 0.5 * (command[1:] + command[:-1])
    thrust = np.empty_like(command)
    for i, vehicle in enumerate(team):
        thrust[:1, i] = hover = 4.0 * vehicle.hover_rotor_thrust
        keep = np.exp(-vehicle.motor_rate * step)
        thrust[1:, i], _ = lfilter([1.0 - keep], [1.0, -keep], held[:, i], zi=[keep * hover])
    return thrust


def thrust_direction(quaternion: FloatArray) -> FloatArray:
    """Direction R k (..., 3) of the thrust at attitudes (..., 4)."""
    x, y, z, w = np.moveaxis(quaternion, -1, 0)
    parts = (2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y))
    return np.stack(parts, axis=-1)


def smooth(values: FloatArray, width: int) -> FloatArray:
    """Average along the first axis with a Hann window of `width` entries; NaN where it is cut."""
    window = np.hanning(width + 2)[1:-1]
    window /= window.sum()
    result = np.full(values.shape, np.nan)
    half, count = width // 2, max(len(values) - width + 1, 0)
    total = np.zeros((count, *values.shape[1:]))
    for offset, weight in enumerate(window):
        total += weight * values[offset : offset + count]
    result[half : half + count] = total
    return result


@typed
def interaction_force(
    log: FlightLog,
    team: Team,
    smoothing_s: float = SMOOTHING_S,
    rate_hz: float = LOG_RATE,
    label: Label = "differentiated",
) -> FloatArray:
    """Interaction force on every drone at every entry of a log.

    Args:
        log: T entries of N drones.
        team: the N vehicles.
        smoothing_s: width of the Hann window over which a differentiated label is averaged, s;
            less than two log entries for none. One from the accelerometer is taken as it is.
        rate_hz: log entries per second.
        label: where the acceleration comes from.

    Returns:
        (T, N, 3) force in gram-force, world frame; NaN near both ends, where it is unknown.
    """
    mass = np.array([vehicle.mass for vehicle in team])[:, None]
    thrust = lagged_thrust(log.commands, team, 1.0 / rate_hz)[..., None]
    if label == "imu":
        acceleration = world_acceleration(log)
    else:
        acceleration = derivative(log.velocity, 1.0 / rate_hz)
        acceleration[..., 2] += GRAVITY
    force = mass * acceleration - thrust * thrust_direction(log.quaternion)
    width = 2 * round(0.5 * smoothing_s * rate_hz) + 1
    averaged = label == "differentiated" and width > 1
    return np.asarray((smooth(force, width) if averaged else force) / GRAM_FORCE)
