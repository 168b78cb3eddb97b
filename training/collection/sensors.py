"""What sensors add to the state: a motion-capture system, its estimator, an accelerometer.

The pilot flies with the true state; only the log is noisy. What a drone logs of its motors are
commands, which no sensor touches.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

from swarm_envs.arguments import typed
from swarm_envs.state import FloatArray
from swarm_envs.training.collection.log import FlightLog


@typed
@dataclass(frozen=True)
class SensorNoise:
    """White noise on every log entry, and biases; standard deviations per component.

    White noise is drawn for each entry, a bias once for each vehicle and flight.
    """

    position_m: float = 2e-4
    """of a motion-capture system, m: makers and users state tenths of a millimetre for markers in
    a room of some metres"""
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
        """Check every number.

        Raises:
            ValueError: a standard deviation is negative or not finite.
        """
        for entry in fields(self):
            value = getattr(self, entry.name)
            if not 0.0 <= value < np.inf:
                raise ValueError(f"{entry.name} is {value}, but must be finite and not negative")


NO_NOISE = SensorNoise(0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
"""Perfect sensors."""


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
