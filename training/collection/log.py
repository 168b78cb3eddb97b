"""The log of a flight: what was measured and commanded, and when."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.interpolate import CubicSpline, make_interp_spline

from swarm_envs.physics.rigid_body import PHYSICS_RATE
from swarm_envs.state import FloatArray

LOG_RATE = 120
"""Log entries per second as flown: every second physics step."""

STEPS_PER_ENTRY = PHYSICS_RATE // LOG_RATE
"""Physics steps between log entries."""


class FlightLog(NamedTuple):
    """What one flight of N drones recorded, T entries. World frame unless said, SI units."""

    position: FloatArray
    """(T, N, 3) m."""
    velocity: FloatArray
    """(T, N, 3) m/s."""
    quaternion: FloatArray
    """(T, N, 4) attitude (x, y, z, w), body to world."""
    specific_force: FloatArray
    """(T, N, 3) what an accelerometer reads, body frame, m/s^2: (0, 0, 9.81) in hover."""
    setpoint: FloatArray
    """(T, N, 3) position that the pilot was told to hold, m; NaN where a file has no place for it.
    """
    commands: FloatArray
    """(T, N, 4) rotor thrusts as commanded from this entry on, N; never those that act."""

    def cut(self, count: int) -> FlightLog:
        """Return the first `count` entries."""
        return FlightLog(*(array[:count] for array in self))


def resampled(log: FlightLog, rate_hz: int) -> FlightLog:
    """Return the log at another rate than `LOG_RATE`: splines, but commands linear.

    Resample before noise is added: a sensor that is read less often is no less noisy.
    """
    count = len(log.position)
    if rate_hz == LOG_RATE or count < 4:
        return log
    time = np.arange(count) / LOG_RATE
    wanted = np.arange(int(time[-1] * rate_hz + 1e-9) + 1) / rate_hz
    arrays = {name: CubicSpline(time, array)(wanted) for name, array in log._asdict().items()}
    arrays["commands"] = make_interp_spline(time, log.commands, k=1)(wanted)
    arrays["quaternion"] /= np.linalg.norm(arrays["quaternion"], axis=-1, keepdims=True)
    return FlightLog(**arrays)


def world_acceleration(log: FlightLog) -> FloatArray:
    """Specific force turned into the world by the logged attitude, (T, N, 3) m/s^2.

    With gravity: (0, 0, 9.81) in hover.
    """
    return rotate(log.quaternion, log.specific_force)


def rotate(quaternion: FloatArray, vector: FloatArray) -> FloatArray:
    """Turn body vectors (..., 3) into the world by attitudes (..., 4)."""
    axis, scalar = quaternion[..., :3], quaternion[..., 3:]
    twice = 2.0 * np.cross(axis, vector)
    return np.asarray(vector + scalar * twice + np.cross(axis, twice))


def rotate_back(quaternion: FloatArray, vector: FloatArray) -> FloatArray:
    """Turn world vectors (..., 3) into the body frame of attitudes (..., 4)."""
    return rotate(quaternion * [-1.0, -1.0, -1.0, 1.0], vector)
