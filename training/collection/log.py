"""The log of a flight, the noise that sensors add to it, and the interaction force it shows.

The pilot flies with the true state; only the log is noisy, as a motion-capture system, its
estimator and an accelerometer are. What a drone logs of its motors are commands, which no sensor
touches. The label is computed as in Neural-Swarm2 (Sec. VII-B, with the lag of eq. 1c):

    f_a = m a + m g k - R T k

The acceleration a is differentiated from the logged velocity over five points, or is what the
accelerometer read; the thrust T is what the motor lag makes of the logged commands, the attitude R
is as logged, the mass m is the type's. A log is all that these functions are given.
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
from swarm_envs.state import FloatArray
from swarm_envs.vehicles import GRAM_FORCE, GRAVITY, Team

__all__ = ["Label", "SensorNoise", "force_from_motion", "thrust_direction"]

LOG_RATE = 120  # Log entries per second as flown: every second physics step

STEPS_PER_ENTRY = PHYSICS_RATE // LOG_RATE  # Physics steps between log entries


class FlightLog(NamedTuple):
    """The record of one flight of N drones, T entries. World frame unless said, SI units."""

    position: FloatArray  # (T, N, 3) m
    velocity: FloatArray  # (T, N, 3) m/s
    quaternion: FloatArray  # (T, N, 4) attitude (x, y, z, w), body to world
    specific_force: FloatArray
    """(T, N, 3) what an accelerometer reads, body frame, m/s^2: (0, 0, 9.81) in hover."""
    setpoint: FloatArray
    """(T, N, 3) position that the pilot was to hold, m."""
    commands: FloatArray
    """(T, N, 4) rotor thrusts as commanded from this entry on, N; never those that act."""

    def cut(self, count: int) -> FlightLog:
        """Return the first `count` entries."""
        return FlightLog(*(array[:count] for array in self))


def save_log(path: Path, log: FlightLog) -> None:
    """Write a log, atomically: npz without pickle, in single precision."""
    arrays = {name: array.astype(np.float32) for name, array in log._asdict().items()}
    with written_whole(path) as partial:
        np.savez(partial, allow_pickle=False, **arrays)


def read_log(path: Path) -> FlightLog:
    """Read a file that `save_log` wrote.

    Raises:
        FileNotFoundError: there is none.
        ValueError: it is damaged.
    """
    arrays = read_npz(path)
    return FlightLog(*(arrays[name].astype(np.float64) for name in FlightLog._fields))


def rotate(quaternion: FloatArray, vector: FloatArray) -> FloatArray:
    """Turn body vectors (..., 3) into the world by attitudes (..., 4)."""
    axis, scalar = quaternion[..., :3], quaternion[..., 3:]
    twice = 2.0 * np.cross(axis, vector)
    return np.asarray(vector + scalar * twice + np.cross(axis, twice))


def rotate_to_body(quaternion: FloatArray, vector: FloatArray) -> FloatArray:
    """Turn world vectors (..., 3) into the body frame of attitudes (..., 4)."""
    return rotate(quaternion * [-1.0, -1.0, -1.0, 1.0], vector)


@dataclass(frozen=True)
class SensorNoise:
    """White noise on every log entry, and biases; standard deviations per component.

    White noise is drawn for each entry, a bias once for each vehicle and flight.
    """

    position_m: float = 2e-4
    """of a motion-capture system, m: makers and users state tenths of a millimeter for markers in
    a room of some meters"""
    velocity: float = 0.01
    """of the state estimator, m/s: positions of 0.2 mm at 100 Hz, filtered over a few samples"""
    attitude_rad: float = 3e-3
    """of the state estimator, rad: 0.2 degrees"""
    accelerometer: float = 0.2
    """of the accelerometer, m/s^2: vibration of the rotors, not the chip, whose 0.175 mg per root
    of Hz (BMI088) make 0.02 m/s^2 over 100 Hz; 0.2 m/s^2 are 0.7 g of force on a small drone,
    about what is left over when models are fitted to measured flights"""
    accelerometer_bias: float = 0.05
    """constant error of the accelerometer, m/s^2: 5 mg, what is left of the chip's 20 mg once the
    firmware has zeroed it before take-off"""
    attitude_bias_rad: float = 0.0
    """constant error of the attitude, rad: markers glued askew. It leans the thrust, 0.03 g of
    sideways force on a small drone per milliradian"""

    def __post_init__(self) -> None:
        """Refuse values that an option cannot have."""
        for option in fields(self):
            check_number(option.name, getattr(self, option.name), at_least=0.0)


def with_noise(log: FlightLog, noise: SensorNoise, rng: np.random.Generator) -> FlightLog:
    """Return the log as noisy sensors would have written it."""
    shape = log.position.shape
    turn = noise.attitude_rad * rng.standard_normal(shape)
    position = log.position + noise.position_m * rng.standard_normal(shape)
    velocity = log.velocity + noise.velocity * rng.standard_normal(shape)
    reading = noise.accelerometer * rng.standard_normal(shape)
    reading += noise.accelerometer_bias * rng.standard_normal(shape[1:])
    turn += noise.attitude_bias_rad * rng.standard_normal(shape[1:])
    small = np.concatenate([0.5 * turn, np.ones((*shape[:-1], 1))], axis=-1)
    quaternion = multiply(small, log.quaternion)
    return log._replace(
        position=position,
        velocity=velocity,
        quaternion=quaternion / np.linalg.norm(quaternion, axis=-1, keepdims=True),
        specific_force=log.specific_force + reading,
    )


def multiply(p: FloatArray, q: FloatArray) -> FloatArray:
    """Product p q of quaternions (..., 4) in the order (x, y, z, w)."""
    a, b = p[..., :3], q[..., :3]
    s, t = p[..., 3:], q[..., 3:]
    vector = s * b + t * a + np.cross(a, b)
    return np.concatenate([vector, s * t - (a * b).sum(axis=-1, keepdims=True)], axis=-1)


SMOOTHING_S = 0.1
"""Width of the window that labels of differentiated velocity are averaged over: a drone moves some
centimeters meanwhile."""

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


def hann_average(values: FloatArray, width: int) -> FloatArray:
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


def interaction_force(
    log: FlightLog,
    team: Team,
    smoothing_s: float = SMOOTHING_S,
    label: Label = "differentiated",
) -> FloatArray:
    """Interaction force (T, N, 3), gram-force, world frame, on every drone at every entry of a log.

    NaN near both ends, where it is unknown. A differentiated label is averaged over a Hann window
    of `smoothing_s`, less than two entries for none; an accelerometer's is taken as it is.
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
    """Interaction force f_a (T, N, 3), gram-force, m a + m g k - R T k; see the module.

    World frame, SI units. The acceleration is with gravity; None differentiates the velocity and
    averages the force over a Hann window of `smoothing_s`, less than two entries for none. Commands
    (T, N, 4) are rotor thrusts. NaN where derivative or window would reach out.
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
