"""The attitude loop of Neural-Swarm2, eqs. (20) and (21), in scalars, for one drone at a time."""

from __future__ import annotations

import math

from swarm_envs.compiled import borrowing_kernel
from swarm_envs.control.config import ControlGains
from swarm_envs.control.state import ControllerState
from swarm_envs.state import FloatArray

Vector = tuple[float, float, float]
"""x, y, z."""
Quaternion = tuple[float, float, float, float]
"""x, y, z, w: scalar last, body to world."""


@borrowing_kernel
def rotate_back(q: Quaternion, v: Vector) -> Vector:
    """Components, in a frame of attitude q = (x, y, z, w), of a vector given outside it: R^T v."""
    tx = 2.0 * (q[1] * v[2] - q[2] * v[1])
    ty = 2.0 * (q[2] * v[0] - q[0] * v[2])
    tz = 2.0 * (q[0] * v[1] - q[1] * v[0])
    return (
        v[0] - q[3] * tx + q[1] * tz - q[2] * ty,
        v[1] - q[3] * ty + q[2] * tx - q[0] * tz,
        v[2] - q[3] * tz + q[0] * ty - q[1] * tx,
    )


@borrowing_kernel
def relative_rotation(a: Quaternion, b: Quaternion) -> Quaternion:
    """Rotation from frame a to frame b, conj(a) b, with its scalar part not negative."""
    x = a[3] * b[0] - a[0] * b[3] - a[1] * b[2] + a[2] * b[1]
    y = a[3] * b[1] - a[1] * b[3] - a[2] * b[0] + a[0] * b[2]
    z = a[3] * b[2] - a[2] * b[3] - a[0] * b[1] + a[1] * b[0]
    w = a[3] * b[3] + a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
    if w < 0.0:
        return -x, -y, -z, -w
    return x, y, z, w


@borrowing_kernel
def tilt_towards(fx: float, fy: float, fz: float) -> Quaternion:
    """Shortest rotation that turns the world z axis to a force, whose z component is positive."""
    length = math.sqrt(fx * fx + fy * fy + fz * fz)
    w = math.sqrt(0.5 * (1.0 + fz / length))
    scale = 0.5 / (w * length)
    return -fy * scale, fx * scale, 0.0, w


@borrowing_kernel
def desired_rate(
    e: int,
    i: int,
    tilt: Quaternion,
    yaw_sin: float,
    yaw_cos: float,
    yaw_rate: float,
    memory: ControllerState,
    gains: ControlGains,
) -> Vector:
    """Angular velocity omega_d of the desired attitude, in its own frame, rad/s.

    The tilt's part is differentiated and low-passed; the set-point gives the yaw's part exactly.
    `yaw_sin` and `yaw_cos` are those of half the yaw angle.
    """
    last = memory.desired_attitude[e, i]
    rate = memory.desired_rate[e, i]
    if memory.started[e, i]:
        change = relative_rotation((last[0], last[1], last[2], last[3]), tilt)
        for axis in range(3):
            raw = 2.0 * change[axis] / gains.step
            rate[axis] += gains.desired_rate_blend * (raw - rate[axis])
    for axis in range(4):
        last[axis] = tilt[axis]
    x, y, z = rotate_back((0.0, 0.0, yaw_sin, yaw_cos), (rate[0], rate[1], rate[2]))
    return x, y, z + yaw_rate


@borrowing_kernel
def axis_acceleration(
    error: float,
    last_error: float,
    error_rate: float,
    integral: float,
    rate_gain: float,
    integral_gain: float,
    lead_time: float,
    started: bool,
    gains: ControlGains,
) -> tuple[float, float, float]:
    """Feedback part of eq. (21) about one body axis, with the lead of eq. (22), over J.

    Args:
        error: body-rate error omega - omega_r, rad/s.
        last_error: that of the last step, rad/s.
        error_rate: its low-passed derivative until the last step, rad/s^2.
        integral: its integral until the last step, rad.
        rate_gain: K_omega / J, 1/s.
        integral_gain: Gamma_omega / J, 1/s^2.
        lead_time: 1 / lambda, s, or zero without lag compensation.
        started: whether `last_error` holds anything.
        gains: step, limit and filter.

    Returns:
        The angular acceleration, rad/s^2, and the derivative and the integral with this step.
    """
    if started:
        raw = (error - last_error) / gains.step
        error_rate += gains.rate_error_blend * (raw - error_rate)
    limit = gains.rate_integral_limit
    integral = min(max(integral + error * gains.step, -limit), limit)
    proportional = rate_gain * (error + lead_time * error_rate)
    return -proportional - integral_gain * integral, error_rate, integral


@borrowing_kernel
def desired_torque(
    attitude: Quaternion,
    omega: Vector,
    desired_attitude: Quaternion,
    omega_desired: Vector,
    inertia: FloatArray,
    motor_rate: float,
    integral: FloatArray,
    last_error: FloatArray,
    error_rate: FloatArray,
    started: bool,
    gains: ControlGains,
) -> Vector:
    """Desired torque tau_d in the body frame, N m, of eqs. (20) to (22).

    Of the derivative of omega_r the part that the attitude error brings, -Lambda_q d(q_v)/dt, is
    included, from the measured rates. The derivative of omega_d is left out: it would be the third
    difference of a measured velocity.

    Args:
        attitude: measured attitude, body to world.
        omega: measured angular velocity in the body frame, rad/s.
        desired_attitude: desired attitude, body to world.
        omega_desired: its angular velocity omega_d, in its own frame, rad/s.
        inertia: (3,) principal moments of inertia, kg m^2.
        motor_rate: lambda, 1/s.
        integral: (3,) integral of the rate error, updated here, rad.
        last_error: (3,) rate error of the last step, updated here, rad/s.
        error_rate: (3,) its low-passed derivative, updated here, rad/s^2.
        started: whether the memory holds a last step.
        gains: the controller's gains.
    """
    q = relative_rotation(desired_attitude, attitude)
    feed = rotate_back(q, omega_desired)
    ax, ay, az = omega[0] - feed[0], omega[1] - feed[1], omega[2] - feed[2]
    tilt, yaw = gains.attitude_tilt, gains.attitude_yaw
    rx, ry, rz = feed[0] - tilt * q[0], feed[1] - tilt * q[1], feed[2] - yaw * q[2]
    # d(q_v)/dt = (q_0 a + q_v x a) / 2, with a the rate of the body against the desired frame.
    dx = -0.5 * tilt * (q[3] * ax + q[1] * az - q[2] * ay)
    dy = -0.5 * tilt * (q[3] * ay + q[2] * ax - q[0] * az)
    dz = -0.5 * yaw * (q[3] * az + q[0] * ay - q[1] * ax)
    lx, ly, lz = inertia[0] * omega[0], inertia[1] * omega[1], inertia[2] * omega[2]
    kt, ky, lead = gains.rate_tilt, gains.rate_yaw, gains.lead / motor_rate
    it, iy = gains.rate_integral_tilt, gains.rate_integral_yaw
    ex, ey, ez = omega[0] - rx, omega[1] - ry, omega[2] - rz
    bx, error_rate[0], integral[0] = axis_acceleration(
        ex, last_error[0], error_rate[0], integral[0], kt, it, lead, started, gains
    )
    by, error_rate[1], integral[1] = axis_acceleration(
        ey, last_error[1], error_rate[1], integral[1], kt, it, lead, started, gains
    )
    bz, error_rate[2], integral[2] = axis_acceleration(
        ez, last_error[2], error_rate[2], integral[2], ky, iy, lead, started, gains
    )
    last_error[0], last_error[1], last_error[2] = ex, ey, ez
    return (
        inertia[0] * (dx + bx) - (ly * rz - lz * ry),
        inertia[1] * (dy + by) - (lz * rx - lx * rz),
        inertia[2] * (dz + bz) - (lx * ry - ly * rx),
    )
