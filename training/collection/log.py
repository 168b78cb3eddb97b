"""The log of a flight, its sensor noise, and the interaction force computed from it.

Noise is added to the log only, with the magnitudes of a motion-capture system, its estimator and an
accelerometer; motor commands are logged without noise. The label is computed from the log as in
Neural-Swarm2 (Sec. VII-B, with the lag of eq. 1c):

    f_a = m a + m g k - R T k

The acceleration a is differentiated from the logged velocity over five points, or is that of the
accelerometer; the thrust T is computed from the logged commands with the motor lag, R is the logged
attitude, and m the mass of the vehicle type.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np
from scipy.signal import lfilter

from swarm_envs.errors import check_number
from swarm_envs.files import read_npz, written_whole
from swarm_envs.physics.rigid_body import PHYSICS_RATE
from swarm_envs.reference import multiply, rotate
from swarm_envs.state import FloatArray
from swarm_envs.vehicles import GRAM_FORCE, GRAVITY, Team

__all__ = ["Label", "SensorNoise", "force_from_motion", "thrust_direction"]

LOG_RATE = 120  # Log entries per second: every second physics step

STEPS_PER_ENTRY = PHYSICS_RATE // LOG_RATE  # Physics steps between log entries


class FlightLog(NamedTuple):
    """The log of one flight of N drones, T entries. World frame unless noted, SI units."""

    position: FloatArray  # (T, N, 3) m
    velocity: FloatArray  # (T, N, 3) m/s
    quaternion: FloatArray  # (T, N, 4) attitude (x, y, z, w), body to world
    specific_force: FloatArray
    """(T, N, 3) accelerometer reading, body frame, m/s^2: (0, 0, 9.81) in hover."""
    setpoint: FloatArray
    """(T, N, 3) position set-point, m."""
    commands: FloatArray
    """(T, N, 4) commanded rotor thrusts from this entry on, N, before the motor lag."""

    def cut(self, count: int) -> FlightLog:
        """Return the first `count` entries."""
        return FlightLog(*(array[:count] for array in self))


def save_log(path: Path, log: FlightLog) -> None:
    """Write a log atomically as npz in single precision, without pickle."""
    arrays = {name: array.astype(np.float32) for name, array in log._asdict().items()}
    with written_whole(path) as partial:
        np.savez(partial, allow_pickle=False, **arrays)


def read_log(path: Path) -> FlightLog:
    """Read a file that `save_log` wrote.

    Raises:
        FileNotFoundError: there is no such file.
        ValueError: it is damaged.
    """
    arrays = read_npz(path)
    return FlightLog(*(arrays[name].astype(np.float64) for name in FlightLog._fields))


@dataclass(frozen=True)
class SensorNoise:
    """Sensor noise: standard deviations per component of white noise and of biases.

    White noise is drawn for each log entry, a bias once for each vehicle and flight.
    """

    position_m: float = 2e-4
    """Position noise, m. Motion-capture systems have tenths of a millimeter in rooms of a few
    meters."""
    velocity: float = 0.01
    """Velocity noise, m/s: that of positions with 0.2 mm at 100 Hz, filtered over a few samples."""
    attitude_rad: float = 3e-3
    """Attitude noise, rad: 0.2 degrees."""
    accelerometer: float = 0.2
    """Accelerometer noise, m/s^2. It is due to the vibration of the rotors; the chip's 0.175 mg per
    root of Hz (BMI088) give only 0.02 m/s^2 over 100 Hz. 0.2 m/s^2 correspond to 0.7 g of force on
    a small drone, about the residual of models fitted to measured flights."""
    accelerometer_bias: float = 0.05
    """Accelerometer bias, m/s^2: 5 mg, the part of the chip's 20 mg that remains after the firmware
    has zeroed it before take-off."""

    def __post_init__(self) -> None:
        """Raise ValueError if a value is invalid."""
        for option in fields(self):
            check_number(option.name, getattr(self, option.name), at_least=0.0)


def with_noise(log: FlightLog, noise: SensorNoise, rng: np.random.Generator) -> FlightLog:
    """Return the log with sensor noise."""
    shape = log.position.shape
    turn = noise.attitude_rad * rng.standard_normal(shape)
    position = log.position + noise.position_m * rng.standard_normal(shape)
    velocity = log.velocity + noise.velocity * rng.standard_normal(shape)
    reading = noise.accelerometer * rng.standard_normal(shape)
    reading += noise.accelerometer_bias * rng.standard_normal(shape[1:])
    small = np.concatenate([0.5 * turn, np.ones((*shape[:-1], 1))], axis=-1)
    quaternion = multiply(small, log.quaternion)
    return log._replace(
        position=position,
        velocity=velocity,
        quaternion=quaternion / np.linalg.norm(quaternion, axis=-1, keepdims=True),
        specific_force=log.specific_force + reading,
    )


SMOOTHING_S = 0.1
"""Width of the window that averages labels from differentiated velocities, in which a drone moves a
few centimeters."""

Label = Literal["differentiated", "imu"]
"""Source of the acceleration in a label: differentiated velocities, or the accelerometer."""


def derivative(values: FloatArray, step: float) -> FloatArray:
    """Return the five-point derivative along the first axis (T, ...); NaN for two at each end."""
    result = np.full(values.shape, np.nan)
    outer, inner = values[4:] - values[:-4], values[3:-1] - values[1:-3]
    result[2:-2] = (8.0 * inner - outer) / (12.0 * step)
    return result


def lagged_thrust(commands: FloatArray, team: Team, step: float) -> FloatArray:
    """Return the total thrust (T, N), N, for commands (T, N, 4), N: eq. (1c), from hover.

    The command between two entries is their mean.
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
    """Return the direction R k (..., 3) of the thrust at attitudes (..., 4)."""
    x, y, z, w = np.moveaxis(quaternion, -1, 0)
    parts = (2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y))
    return np.stack(parts, axis=-1)


def hann_average(values: FloatArray, width: int) -> FloatArray:
    """Average along the first axis with a Hann window of `width` entries; NaN at both ends."""
    window = np.hanning(width + 2)[1:-1]
    window /= window.sum()
    result = np.full(values.shape, np.nan)
    half, count = width // 2, max(len(values) - width + 1, 0)
    total = np.zeros((count, *values.shape[1:]))
    for offset, weight in enumerate(window):
        total += weight * values[offset : offset + count]
    result[half : half + count] = total
    return result


def interaction_force(
    log: FlightLog,
    team: Team,
    smoothing_s: float = SMOOTHING_S,
    label: Label = "differentiated",
) -> FloatArray:
    """Return the interaction force (T, N, 3), gram-force, world frame, at every entry of a log.

    It is NaN near both ends, where it is unknown. A differentiated label is averaged over a Hann
    window of `smoothing_s` (no average below two entries); that of an accelerometer is not.
    """
    acceleration = rotate(log.quaternion, log.specific_force) if label == "imu" else None
    return force_from_motion(
        log.velocity, acceleration, log.quaternion, log.commands, team, LOG_RATE, smoothing_s
    )


def force_from_motion(
    velocity: FloatArray,
    acceleration: FloatArray | None,
    quaternion: FloatArray,
    commands: FloatArray,
    team: Team,
    rate_hz: float,
    smoothing_s: float,
) -> FloatArray:
    """Return the interaction force f_a = m a + m g k - R T k (T, N, 3), gram-force; see the module.

    World frame, SI units. The acceleration includes gravity; with None, the velocity is
    differentiated and the force averaged over a Hann window of `smoothing_s` (no average below two
    entries). Commands (T, N, 4) are rotor thrusts. The result is NaN where the derivative or the
    window is incomplete.
    """
    mass = np.array([vehicle.mass for vehicle in team])[:, None]
    thrust = lagged_thrust(commands, team, 1.0 / rate_hz)[..., None]
    measured = acceleration is not None
    if acceleration is None:
        acceleration = derivative(velocity, 1.0 / rate_hz)
        acceleration[..., 2] += GRAVITY
    force = mass * acceleration - thrust * thrust_direction(quaternion)
    width = 2 * round(0.5 * smoothing_s * rate_hz) + 1
    averaged = width > 1 and not measured
    return np.asarray((hann_average(force, width) if averaged else force) / GRAM_FORCE)
