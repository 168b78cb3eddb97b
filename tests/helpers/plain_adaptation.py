"""The three adaptations for one drone in plain Python, from the equations of their papers.

Nothing of the compiled loop or of its settings is used: filters are discretised by SciPy, the
momentum observer integrates a momentum, Neural-Fly's covariance is a matrix.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.signal import butter, cont2discrete, tf2ss
from scipy.spatial.transform import Rotation

from swarm_envs.control.config import ControllerConfig, Indi, MomentumObserver, NeuralFly
from swarm_envs.state import FloatArray
from swarm_envs.vehicles import Vehicle

GRAVITY = np.array([0.0, 0.0, -9.80665])
DT = 1.0 / 240.0


class PlainAdaptation:
    """Estimates the force that nominal thrust and feed-forward leave over, step by step."""

    def __init__(self, vehicle: Vehicle, config: ControllerConfig) -> None:
        self.vehicle, self.config = vehicle, config
        kind = config.adaptation
        self.estimator: Any = {
            MomentumObserver: PlainMomentumObserver,
            Indi: PlainIndi,
            NeuralFly: PlainNeuralFly,
        }[type(kind)](vehicle, config)
        self.thrust = np.nan
        self.last: tuple[FloatArray, FloatArray, FloatArray] | None = None

    def force(
        self,
        position: FloatArray,
        velocity: FloatArray,
        quaternion: FloatArray,
        commands: FloatArray,
        feedforward: FloatArray,
        setpoint: tuple[FloatArray, FloatArray],
    ) -> FloatArray:
        """(3,) N at this step; commands (4,) are those of the last step, or of hover at first."""
        known = None
        if self.last is None:
            self.thrust = float(commands.sum())
        else:
            decay = np.exp(-self.vehicle.motor_rate * DT)
            self.thrust = commands.sum() + (self.thrust - commands.sum()) * decay
            known = self.thrust * self.last[0] + self.last[2]
        reference = setpoint[1] - self.config.gains.position * (position - setpoint[0])
        force = self.estimator.step(known, self.last, velocity, feedforward, velocity - reference)
        axis = Rotation.from_quat(quaternion).as_matrix()[:, 2]
        self.last = (axis, velocity.copy(), feedforward.copy())
        return np.asarray(force)


class PlainMomentumObserver:
    """f = w (m v - p), dp/dt = T z + m g + f_hat + f: De Luca and Mattone 2003, held over steps."""

    def __init__(self, vehicle: Vehicle, config: ControllerConfig) -> None:
        assert isinstance(config.adaptation, MomentumObserver)
        self.mass, self.weight = vehicle.mass, vehicle.mass * 9.80665
        bandwidth = 2.0 * np.pi * config.adaptation.bandwidth_hz
        self.gain = (1.0 - np.exp(-bandwidth * DT)) / DT
        self.momentum, self.estimate = np.zeros(3), np.zeros(3)

    def step(self, known: Any, last: Any, velocity: Any, feedforward: Any, error: Any) -> Any:
        """The next estimate."""
        momentum = self.mass * velocity
        if known is None:
            self.momentum = momentum
            return self.estimate
        self.momentum = self.momentum + DT * (known + self.mass * GRAVITY + self.estimate)
        free = self.gain * (momentum - self.momentum)
        self.estimate = np.clip(free, -self.weight, self.weight)
        self.momentum = momentum - self.estimate / self.gain  # a limited estimate does not wind up
        return self.estimate


class PlainIndi:
    """The same Butterworth low-pass of m a and of T z + m g + f_hat, and their difference."""

    def __init__(self, vehicle: Vehicle, config: ControllerConfig) -> None:
        assert isinstance(config.adaptation, Indi | NeuralFly)
        self.mass, self.weight = vehicle.mass, vehicle.mass * 9.80665
        analog = butter(2, 2.0 * np.pi * config.adaptation.cutoff_hz, analog=True)
        a, b, c, d = tf2ss(*analog)
        # In the output and its derivative, so that a limited output can go on from its limit.
        basis = np.concatenate([c, c @ a])
        inverse = np.linalg.inv(basis)
        self.a, self.b, *_ = cont2discrete((basis @ a @ inverse, basis @ b, c @ inverse, d), DT)
        self.state = np.zeros((2, 3))

    def step(self, known: Any, last: Any, velocity: Any, feedforward: Any, error: Any) -> Any:
        """The next estimate."""
        residual = np.zeros(3)
        if known is not None:
            acceleration = (velocity - last[1]) / DT
            residual = self.mass * acceleration - (known + self.mass * GRAVITY)
        self.state = self.a @ self.state + self.b @ residual[None]
        self.state[0] = np.clip(self.state[0], -self.weight, self.weight)
        return self.state[0].copy()


class PlainNeuralFly:
    """Adaptation of coefficients, O'Connell et al. 2022, each axis with a covariance of its own."""

    def __init__(self, vehicle: Vehicle, config: ControllerConfig) -> None:
        assert isinstance(config.adaptation, NeuralFly)
        law = config.adaptation
        self.mass, self.weight = vehicle.mass, vehicle.mass * 9.80665
        self.low_pass = PlainIndi(vehicle, config)
        self.drift = np.diag(np.square([law.scale_drift, law.drag_drift, law.force_drift])) * DT
        self.noise = law.measurement_noise**2 / DT
        self.kept = np.exp(-law.forgetting_rate * DT)
        self.coefficients, self.covariance = np.zeros((3, 3)), np.zeros((3, 3, 3))

    def step(self, known: Any, last: Any, velocity: Any, feedforward: Any, error: Any) -> Any:
        """The next estimate."""
        force = np.zeros(3)
        measured = self.low_pass.step(known, last, velocity, feedforward, error) / self.mass
        for k in range(3):
            a = self.kept * self.coefficients[k]
            covariance = self.kept**2 * self.covariance[k] + self.drift
            basis = np.array([0.0, 0.0, 1.0])
            if last is not None:
                basis = np.array([last[2][k] / self.mass, last[1][k], 1.0])
            gain = covariance @ basis / (basis @ covariance @ basis + self.noise)
            covariance = (np.eye(3) - np.outer(gain, basis)) @ covariance
            if last is not None:
                a = a + gain * (measured[k] - basis @ a)
            basis = np.array([feedforward[k] / self.mass, velocity[k], 1.0])
            a = a + DT * covariance @ basis * error[k]
            self.coefficients[k], self.covariance[k] = a, covariance
            force[k] = np.clip(self.mass * (basis @ a), -self.weight, self.weight)
        return force
