"""Theorem 5 (Sec. VI-B, version 1) as functions: the ball of the position error.

The theorem is for a point mass with the desired force f_d without lag, m dv/dt = m g + f_d + f_a:
no attitude, no rotor lag, no limits of thrust and integral. With p~ = p - p_d, s1 = dp~/dt + Lambda
p~ and s2 = m ds1/dt + K_v s1, eqs. (18) and (19) leave

    dp~/dt = -Lambda p~ + s1,   m ds1/dt = -K_v s1 + s2,   ds2/dt = -Gamma s2 + d eps_f/dt

with the model error eps_f = f_a - f_hat. If it changes by at most d_f newton per second, each line
is a low-pass of the next one, so that p~ converges to a ball of radius d_f / (Lambda Gamma K_v):
eq. (23). With a steadily growing model error p~ converges to that radius.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.linalg import expm

from swarm_envs.control.config import ControllerConfig, PositionGains
from swarm_envs.state import FloatArray
from swarm_envs.vehicles import GRAVITY, Vehicle


class ErrorBall(NamedTuple):
    """The ball in which the position error ends, and how fast it gets there."""

    radius: float  # largest position error in the limit, m: eq. (23)
    rate: float  # rate at which a larger error decays, 1/s: the smallest of the three gains


def error_ball(gains: PositionGains, mass: float, error_rate: float) -> ErrorBall:
    """Return the ball of eq. (23) for a mass, kg, and the largest rate of its model error, N/s.

    Gains are the same in x, y and z.
    """
    force_gain = gains.position * gains.integral * mass * gains.velocity
    return ErrorBall(error_rate / force_gain, min(gains.position, gains.velocity, gains.integral))


def error_envelope(
    gains: PositionGains,
    mass: float,
    error_rate: float,
    time: npt.ArrayLike,
    position_error: npt.ArrayLike = (0.0, 0.0, 0.0),
    velocity_error: npt.ArrayLike = (0.0, 0.0, 0.0),
    force_error: npt.ArrayLike = (0.0, 0.0, 0.0),
) -> FloatArray:
    """Return the bound (T,) on the norm of the position error at times (T,), s, m.

    It solves the three lines of the theorem with norms in place of vectors, which bounds them: the
    transient is a sum of exponentials with the rates Lambda, K_v / m and Gamma. At the start the
    integral is zero, and p - p_d, its derivative and eps_f (3,) are as given, m, m/s and N.
    """
    p, v, f = (
        np.asarray(x, dtype=np.float64) for x in (position_error, velocity_error, force_error)
    )
    first = v + gains.position * p
    second = f - mass * gains.integral * first
    start = np.array([*(math.sqrt(x @ x) for x in (p, first, second)), 1.0])
    flow = np.array(
        [
            [-gains.position, 1.0, 0.0, 0.0],
            [0.0, -gains.velocity, 1.0 / mass, 0.0],
            [0.0, 0.0, -gains.integral, error_rate],
            [0.0, 0.0, 0.0, 0.0],
        ]
    )
    times = np.asarray(time, dtype=np.float64)
    return np.asarray((expm(times[:, None, None] * flow) @ start)[:, 0])


def clamped_radius(config: ControllerConfig, mass: float, error: float) -> float:
    """Return the largest position error of one axis where the integral is clamped, m.

    The controller's integral holds at most K_v Gamma `velocity_integral_limit` against a model
    error, N. A larger one is left to the proportional part, and eq. (23) is void; what the clamp
    and a bound on the error itself leave is (|eps_f| + that) / (Lambda (K_v + m Gamma)) for each
    axis.
    """
    gains = config.gains
    stiffness = gains.position * mass * (gains.velocity + gains.integral)
    return (error + integral_force(config, mass)) / stiffness


def integral_force(config: ControllerConfig, mass: float) -> float:
    """Return the largest force of the clamped integral along one axis, N."""
    gains = config.gains
    return mass * gains.velocity * gains.integral * config.velocity_integral_limit


# ---- The plant that the theorem assumes, under this package's position controller


def without_clamp(config: ControllerConfig) -> ControllerConfig:
    """Return the controller of the theorem: nothing limits the integral."""
    return replace(config, velocity_integral_limit=1e6)  # m


def fly_point_mass(
    vehicle: Vehicle,
    config: ControllerConfig,
    force_error: FloatArray,
    dt: float,
    position_error: npt.ArrayLike = (0.0, 0.0, 0.0),
    velocity_error: npt.ArrayLike = (0.0, 0.0, 0.0),
) -> FloatArray:
    """Return position errors (T + 1, 3), m, of a point mass at rest under model errors (T, 3), N.

    The mass feels the desired force f_d of eqs. (18) and (19) at once, and the unknown force eps_f
    of each step of dt, s. The law's errors do not depend on the reference: those at rest hold on
    any. See `without_clamp`.
    """
    gains, mass, limit = config.gains, vehicle.mass, config.velocity_integral_limit
    gravity, integral = np.array([0.0, 0.0, -GRAVITY]), np.zeros(3)
    position, velocity = (np.array(x, dtype=np.float64) for x in (position_error, velocity_error))
    errors = np.empty((len(force_error) + 1, 3))
    errors[0] = position
    for k, push in enumerate(force_error):
        composite = velocity + gains.position * position
        integral = np.clip(integral + composite * dt, -limit, limit)
        desired = -mass * (
            gravity
            + gains.position * velocity
            + (gains.velocity + gains.integral) * composite
            + gains.velocity * gains.integral * integral
        )
        desired[2] = max(desired[2], config.min_vertical_thrust_fraction * mass * GRAVITY)
        acceleration = (desired + push) / mass + gravity
        position = position + dt * velocity + 0.5 * dt**2 * acceleration
        velocity = velocity + dt * acceleration
        errors[k + 1] = position
    return errors
