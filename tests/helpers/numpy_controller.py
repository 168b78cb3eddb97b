"""The tracking controller of Neural-Swarm2, Sec. VI, in NumPy: one drone, one step, to read.

Written from the equations of the paper (numbers of version 1) in the order in which it derives
them, with rotation matrices. The loop that environments run, `swarm_envs.control.loop`, agrees with
it to rounding; a test holds them together. How rotors share thrust and torque, `mix_rotors`, is no
equation of the paper, and the loop's own.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from swarm_envs.control.config import ControllerConfig
from swarm_envs.control.loop import mix_rotors
from swarm_envs.state import FloatArray
from swarm_envs.vehicles import GRAVITY, Vehicle

UP = np.array([0.0, 0.0, 1.0])
"""The world's vertical, and the direction of thrust in the body frame."""


class TrackingTarget(NamedTuple):
    """The set-point of one drone at one instant. World frame, SI units."""

    position: FloatArray  # (3,) desired position p_d, m
    velocity: FloatArray = np.zeros(3)  # (3,) its derivative, m/s
    acceleration: FloatArray = np.zeros(3)  # (3,) its second derivative, m/s^2
    yaw: float = 0.0  # desired turn about the thrust axis, rad
    yaw_rate: float = 0.0  # its derivative, rad/s


class LowPassDerivative:
    """Derivative of a sampled signal through a first-order low-pass; zero at the first sample."""

    def __init__(self, cutoff_hz: float, step: float) -> None:
        self.step = step
        self.blend = 1.0 - math.exp(-2.0 * math.pi * cutoff_hz * step)
        self.last: FloatArray | None = None
        self.value: FloatArray = np.zeros(())

    def update(self, signal: FloatArray) -> FloatArray:
        """Take the next sample and return the derivative, per second."""
        if self.last is None:
            self.value = np.zeros_like(signal)
        else:
            self.value = self.value + self.blend * ((signal - self.last) / self.step - self.value)
        self.last = signal
        return self.value


def quaternion_parts(rotation: FloatArray) -> tuple[float, FloatArray]:
    """Scalar q_0 >= 0 and vector part q_v (3,) of the quaternion of a rotation matrix."""
    *vector, scalar = Rotation.from_matrix(rotation).as_quat(canonical=True)
    return float(scalar), np.array(vector)


def rotation_between(direction: FloatArray) -> FloatArray:
    """Shortest rotation (3, 3) that turns the z axis to a unit vector that points upwards."""
    axis = np.cross(UP, direction)
    cross = np.cross(axis, np.eye(3)).T  # cross @ a = axis x a
    return np.asarray(np.eye(3) + cross + cross @ cross / (1.0 + direction[2]))


class NumpyTrackingController:
    """The tracking controller of one drone, for reading and for checking the compiled one."""

    def __init__(
        self, vehicle: Vehicle, config: ControllerConfig | None = None, dt: float = 1.0 / 240.0
    ) -> None:
        self.vehicle = vehicle
        self.config = ControllerConfig() if config is None else config
        self.dt = dt
        self.reset()

    def reset(self) -> None:
        """Forget integrals, filters and the last attitude."""
        c = self.config
        self.velocity_integral = np.zeros(3)
        self.rate_integral = np.zeros(3)
        self.thrust_derivative = LowPassDerivative(c.thrust_rate_cutoff_hz, self.dt)
        self.rate_error_derivative = LowPassDerivative(c.rate_error_cutoff_hz, self.dt)
        self.last_tilt: FloatArray | None = None
        self.tilt_rate = np.zeros(3)

    def commands(
        self,
        position: FloatArray,
        velocity: FloatArray,
        quaternion: FloatArray,
        angular_velocity: FloatArray,
        target: TrackingTarget,
        feedforward: FloatArray | None = None,
    ) -> FloatArray:
        """Rotor thrust commands u_c (4,), N, for one step; vectors (3,) in the world frame, SI."""
        rotation = Rotation.from_quat(quaternion).as_matrix()
        body_rate = rotation.T @ angular_velocity
        compensated = np.zeros(3) if feedforward is None else feedforward
        force = self.desired_force(position, velocity, target, compensated)
        thrust = force @ rotation @ UP
        torque = self.desired_torque(rotation, body_rate, force, target)

        thrust_derivative = float(self.thrust_derivative.update(np.asarray(thrust)))
        if self.config.lag_compensation:  # eq. (22); the torque's share is in desired_torque
            thrust = thrust + thrust_derivative / self.vehicle.motor_rate
        x, y, z = torque.tolist()
        vehicle, offset = self.vehicle, self.vehicle.arm / math.sqrt(2.0)
        limits = (vehicle.max_rotor_thrust, offset, vehicle.thrust_to_torque)
        return np.array(list(mix_rotors(float(thrust), x, y, z, *limits)))

    def desired_force(
        self,
        position: FloatArray,
        velocity: FloatArray,
        target: TrackingTarget,
        compensated: FloatArray,
    ) -> FloatArray:
        """Desired thrust vector f_d (3,), world frame, N: eqs. (18) and (19)."""
        gains, mass = self.config.gains, self.vehicle.mass
        gravity = -GRAVITY * UP
        position_error = position - target.position
        reference = target.velocity - gains.position * position_error
        reference_rate = target.acceleration - gains.position * (velocity - target.velocity)
        velocity_error = velocity - reference

        limit = self.config.velocity_integral_limit
        integral = self.velocity_integral + velocity_error * self.dt
        self.velocity_integral = np.clip(integral, -limit, limit)

        velocity_gain = mass * gains.velocity
        force = (
            -mass * gravity
            + mass * reference_rate
            - compensated
            - (velocity_gain + mass * gains.integral) * velocity_error
            - velocity_gain * gains.integral * self.velocity_integral
        )
        force[2] = max(force[2], self.config.min_vertical_thrust_fraction * mass * GRAVITY)
        return np.asarray(force)

    def desired_attitude(
        self, force: FloatArray, target: TrackingTarget
    ) -> tuple[FloatArray, FloatArray]:
        """Desired attitude R_d (3, 3) and its angular velocity omega_d (3,) in its own frame.

        R_d turns z to the direction of the force on the shortest way, after a turn about z by the
        yaw. The tilt is differentiated and low-passed, the yaw's rate is given.
        """
        tilt = rotation_between(force / np.linalg.norm(force))
        if self.last_tilt is not None:
            _, half_turn = quaternion_parts(self.last_tilt.T @ tilt)
            blend = 1.0 - math.exp(-2.0 * math.pi * self.config.desired_rate_cutoff_hz * self.dt)
            self.tilt_rate = self.tilt_rate + blend * (2.0 * half_turn / self.dt - self.tilt_rate)
        self.last_tilt = tilt
        turn = Rotation.from_rotvec(target.yaw * UP).as_matrix()
        return tilt @ turn, turn.T @ self.tilt_rate + target.yaw_rate * UP

    def desired_torque(
        self, rotation: FloatArray, body_rate: FloatArray, force: FloatArray, target: TrackingTarget
    ) -> FloatArray:
        """Desired torque tau_d (3,), body frame, N m: eqs. (20) and (21) with the lead of (22)."""
        c = self.config
        inertia = np.array(self.vehicle.inertia)
        attitude_gain = np.array([c.attitude_tilt, c.attitude_tilt, c.attitude_yaw])
        rate_gain = inertia * np.array([c.rate_tilt, c.rate_tilt, c.rate_yaw])
        integral_gain = inertia * np.array(
            [c.rate_integral_tilt, c.rate_integral_tilt, c.rate_integral_yaw]
        )

        desired, desired_rate = self.desired_attitude(force, target)
        error_rotation = desired.T @ rotation
        scalar, vector = quaternion_parts(error_rotation)
        fed_rate = error_rotation.T @ desired_rate
        reference = fed_rate - attitude_gain * vector
        # Its derivative without that of omega_d, which would difference a measured velocity thrice.
        relative_rate = body_rate - fed_rate
        vector_rate = 0.5 * (scalar * relative_rate + np.cross(vector, relative_rate))
        reference_rate = -attitude_gain * vector_rate

        rate_error = body_rate - reference
        integral = self.rate_integral + rate_error * self.dt
        self.rate_integral = np.clip(integral, -c.rate_integral_limit, c.rate_integral_limit)
        torque = (
            inertia * reference_rate
            - np.cross(inertia * body_rate, reference)
            - rate_gain * rate_error
            - integral_gain * self.rate_integral
        )
        derivative = self.rate_error_derivative.update(rate_error)
        if c.lag_compensation:
            torque = torque - rate_gain / self.vehicle.motor_rate * derivative
        return np.asarray(torque)
