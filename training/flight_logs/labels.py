"""Interaction force of a flight on one clock, m a / g - T R[:, 2] (Neural-Swarm2, Sec. VII-B)."""

from __future__ import annotations

import numpy as np

from swarm_envs.state import FloatArray
from swarm_envs.training.collection.labels import (
    derivative,
    lagged_thrust,
    smooth,
    thrust_direction,
)
from swarm_envs.training.collection.signals import commanded_thrust
from swarm_envs.training.flight_logs.clock import ClockedFlight, pieces
from swarm_envs.vehicles import GRAM_FORCE, GRAVITY

SETTLED = 5.0
"""Time constants of the motors after which nothing is left of an unknown thrust at the start."""


def interaction_force_g(flight: ClockedFlight, smoothing_s: float) -> FloatArray:
    """Interaction force on every drone at every time of a flight.

    Args:
        flight: N drones at T times.
        smoothing_s: width of the Hann window over labels from differentiated velocity, s.

    Returns:
        (T, N, 3) gram-force, world frame; NaN where it is unknown: in gaps, while a motor stands,
        five motor time constants after either, and where derivative or window would reach out.
    """
    force = np.full(flight.position.shape, np.nan)
    slowest = min(vehicle.motor_rate for vehicle in flight.team)
    settling = int(np.ceil(SETTLED / slowest * flight.rate_hz))
    for piece in pieces(flight.known & flight.running):
        if piece.stop - piece.start > settling + 5:
            force[piece] = _piece(flight, piece, smoothing_s)
            force[piece.start : piece.start + settling] = np.nan
    return force


def _piece(flight: ClockedFlight, piece: slice, smoothing_s: float) -> FloatArray:
    step = 1.0 / flight.rate_hz
    commands = commanded_thrust(flight.pwm[piece], flight.voltage[piece], flight.team)
    thrust = lagged_thrust(commands, flight.team, step)[..., None]
    if flight.acceleration is not None:
        acceleration = flight.acceleration[piece]
    else:
        acceleration = derivative(flight.velocity[piece], step)
        acceleration[..., 2] += GRAVITY
    mass = np.array([vehicle.mass for vehicle in flight.team])[:, None]
    force = mass * acceleration - thrust * thrust_direction(flight.quaternion[piece])
    width = 2 * round(0.5 * smoothing_s * flight.rate_hz) + 1
    if flight.acceleration is None and width > 1:
        force = smooth(force, width)
    return np.asarray(force / GRAM_FORCE)
