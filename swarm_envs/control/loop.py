"""The tracking controller of Neural-Swarm2, Sec. VI (version 1), from set-points to rotor thrusts.

It consists of the position loop, eqs. (18) and (19), the attitude loop, eqs. (20) and (21), the
delay compensation of the motors, eq. (22), and the mixer. Delay compensation adds to the desired
thrust its low-passed derivative over lambda, and to the torque the derivative of the rate error.
For blocks of drones, `track` makes a step of the outer loops, and `hold_rates` one of the rate loop
and the mixer.

Rotors: 1 front right, 2 back right, 3 back left, 4 front left; body x forward, y left, z up.
"""

from __future__ import annotations

import math

from swarm_envs.compiled import equation, part
from swarm_envs.tables import LANES, Record, Records
from swarm_envs.vehicles import GRAVITY

Vector = tuple[float, float, float]  # x, y, z
Quaternion = tuple[float, float, float, float]  # x, y, z, w; body to world


@equation
def three(field: Record, lane: int) -> Vector:
    """Return the three numbers of a block's field in a lane."""
    return field[0, lane], field[1, lane], field[2, lane]


@equation
def four(field: Record, lane: int) -> Quaternion:
    """Return the four numbers of a block's field in a lane."""
    return field[0, lane], field[1, lane], field[2, lane], field[3, lane]


@equation
def seen_state(b: Record, hall: bool | None) -> tuple[Record, Record, Record, Record]:
    """Return a block's position, velocity, attitude and angular velocity for the controller.

    They are the estimates if `hall` is True; else it is None.
    """
    if hall is None:
        return b.position, b.velocity, b.quaternion, b.angular_velocity
    return b.seen_position, b.seen_velocity, b.seen_quaternion, b.seen_angular_velocity


@equation
def rotate_back(q: Quaternion, v: Vector) -> Vector:
    """Return R^T v: a vector of the world frame in a frame of attitude q."""
    tx = 2.0 * (q[1] * v[2] - q[2] * v[1])
    ty = 2.0 * (q[2] * v[0] - q[0] * v[2])
    tz = 2.0 * (q[0] * v[1] - q[1] * v[0])
    return (
        v[0] - q[3] * tx + q[1] * tz - q[2] * ty,
        v[1] - q[3] * ty + q[2] * tx - q[0] * tz,
        v[2] - q[3] * tz + q[0] * ty - q[1] * tx,
    )


@equation
def relative_rotation(a: Quaternion, b: Quaternion) -> Quaternion:
    """Return the rotation from frame a to frame b, conj(a) b, with a scalar part >= 0."""
    x = a[3] * b[0] - a[0] * b[3] - a[1] * b[2] + a[2] * b[1]
    y = a[3] * b[1] - a[1] * b[3] - a[2] * b[0] + a[0] * b[2]
    z = a[3] * b[2] - a[2] * b[3] - a[0] * b[1] + a[1] * b[0]
    w = a[3] * b[3] + a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
    sign = -1.0 if w < 0.0 else 1.0
    return sign * x, sign * y, sign * z, sign * w


@equation
def mix_rotors(
    thrust: float,
    torque_x: float,
    torque_y: float,
    torque_z: float,
    max_rotor_thrust: float,
    rotor_offset: float,
    thrust_to_torque: float,
) -> tuple[float, float, float, float]:
    """Return rotor thrusts, N, for a thrust, N, and a body torque, N m, within the rotors' range.

    A feasible wrench is realized exactly. Otherwise, yaw is scaled down as far as necessary; if
    that is not enough, the thrust is shifted as little as possible; roll and pitch are scaled down,
    both by one factor, only if they alone exceed the range. `rotor_offset` (m) is the distance of
    each rotor from the body x and y axes, `thrust_to_torque` (m) the yaw torque per newton of rotor
    thrust.
    """
    # Rotors 1 and 3 have opposite shares of roll and pitch, and so do 2 and 4
    per_arm = 0.25 / rotor_offset
    diagonal_1 = -(torque_x + torque_y) * per_arm
    diagonal_2 = (torque_y - torque_x) * per_arm
    largest = max(abs(diagonal_1), abs(diagonal_2))
    too_much = 2.0 * largest > max_rotor_thrust
    scale = 0.5 * max_rotor_thrust / largest if too_much else 1.0
    diagonal_1 *= scale
    diagonal_2 *= scale
    largest = 0.5 * max_rotor_thrust if too_much else largest

    # Positive yaw shifts thrust from rotors 1 and 3 to 2 and 4, which reduces the range of feasible
    # thrusts on one side and may extend it on the other
    yaw = torque_z / (4.0 * thrust_to_torque)
    losing = abs(diagonal_2) if yaw < 0.0 else abs(diagonal_1)
    gaining = abs(diagonal_1) if yaw < 0.0 else abs(diagonal_2)
    size = abs(yaw)
    lowest = largest - min(max(0.5 * (gaining - losing), 0.0), size)
    highest = max_rotor_thrust - largest + min(max(0.5 * (losing - gaining), 0.0), size)
    base = min(max(0.25 * thrust, lowest), highest)
    size = max(min(size, base - losing, max_rotor_thrust - gaining - base), 0.0)
    yaw = -size if yaw < 0.0 else size
    return (
        min(max(base + diagonal_1 - yaw, 0.0), max_rotor_thrust),
        min(max(base + diagonal_2 + yaw, 0.0), max_rotor_thrust),
        min(max(base - diagonal_1 - yaw, 0.0), max_rotor_thrust),
        min(max(base - diagonal_2 + yaw, 0.0), max_rotor_thrust),
    )


@part
def track(
    blocks: Records, count: int, settings: Records, varied: bool | None, hall: bool | None = None
) -> None:
    """Make one step of the position and attitude loops for the drones of the first `count` blocks.

    The commands for the rate loop are written, and set-points are extrapolated by one step with
    their jerk. `varied` is True if the force of `adapt`, which is 0 without adaptation, is also
    compensated, and `hall` in the world "hall"; else they are None.
    """
    s = settings[0]
    step, per_step, lead = s.step, 1.0 / s.step, s.lead  # divisions are slow
    kp, kv, ki = s.position_gain, s.velocity_gain, s.integral_gain
    limit, tilt_gain, yaw_gain = s.velocity_integral_limit, s.attitude_tilt, s.attitude_yaw
    thrust_blend, rate_blend = s.thrust_rate_blend, s.desired_rate_blend
    least = s.min_vertical_thrust_fraction
    for n in range(count):
        b = blocks[n]
        position, velocity, attitude, angular_velocity = seen_state(b, hall)
        # Trigonometric functions are not vectorized: skip them if all yaw angles are 0
        largest_yaw = 0.0
        for lane in range(LANES):
            largest_yaw = max(largest_yaw, abs(b.setpoint_yaw[lane]))
        for lane in range(LANES):
            b.yaw_sin[lane], b.yaw_cos[lane] = 0.0, 1.0
            if largest_yaw > 0.0:
                half = 0.5 * b.setpoint_yaw[lane]
                b.yaw_sin[lane], b.yaw_cos[lane] = math.sin(half), math.cos(half)

        for lane in range(LANES):
            # The desired force along each world axis without gravity and f_hat: eqs. (18) and (19)
            for k in range(3):
                v, v_d = velocity[k, lane], b.setpoint_velocity[k, lane]
                a_d, p_d = b.setpoint_acceleration[k, lane], b.setpoint_position[k, lane]
                error = v - (v_d - kp * (position[k, lane] - p_d))
                reference_rate = a_d - kp * (v - v_d)
                integral = b.velocity_integral[k, lane] + error * step
                integral = min(max(integral, -limit), limit)
                b.velocity_integral[k, lane] = integral
                feedback = reference_rate - (kv + ki) * error - kv * ki * integral
                b.desired_force[k, lane] = b.nominal_mass[lane] * feedback
            q = four(attitude, lane)
            omega = rotate_back(q, three(angular_velocity, lane))
            started, weight = b.started[lane], b.nominal_mass[lane] * GRAVITY

            # The vertical component of the desired force is kept positive
            (fx, fy, fz), known = three(b.desired_force, lane), three(b.feedforward_force, lane)
            if varied is not None:
                more = three(b.adaptive_force, lane)
                known = known[0] + more[0], known[1] + more[1], known[2] + more[2]
            fx, fy, fz = fx - known[0], fy - known[1], max(fz + weight - known[2], least * weight)

            # The thrust along the body's z axis, with the lead of eq. (22)
            thrust = (
                2.0 * (q[0] * q[2] + q[3] * q[1]) * fx
                + 2.0 * (q[1] * q[2] - q[3] * q[0]) * fy
                + (1.0 - 2.0 * (q[0] * q[0] + q[1] * q[1])) * fz
            )
            thrust_rate = b.thrust_rate[lane]
            raw = (thrust - b.desired_thrust[lane]) * per_step
            thrust_rate += started * thrust_blend * (raw - thrust_rate)
            b.desired_thrust[lane], b.thrust_rate[lane] = thrust, thrust_rate
            b.ctbr[0, lane] = thrust + lead / b.nominal_motor_rate[lane] * thrust_rate

            # The desired attitude, by the shortest rotation of the world's z axis to the force, and
            # the low-passed derivative of this tilt
            length = math.sqrt(fx * fx + fy * fy + fz * fz)
            half_cos = math.sqrt(0.5 * (1.0 + fz / length))
            tilt_scale = 0.5 / (half_cos * length)
            tilt = -fy * tilt_scale, fx * tilt_scale, 0.0, half_cos
            change = relative_rotation(four(b.desired_attitude, lane), tilt)
            dx, dy, dz = three(b.desired_rate, lane)
            dx += started * rate_blend * (2.0 * change[0] * per_step - dx)
            dy += started * rate_blend * (2.0 * change[1] * per_step - dy)
            dz += started * rate_blend * (2.0 * change[2] * per_step - dz)
            b.desired_rate[0, lane], b.desired_rate[1, lane], b.desired_rate[2, lane] = dx, dy, dz
            b.desired_attitude[0, lane], b.desired_attitude[1, lane] = tilt[0], tilt[1]
            b.desired_attitude[2, lane], b.desired_attitude[3, lane] = tilt[2], tilt[3]
            yaw_sin, yaw_cos = b.yaw_sin[lane], b.yaw_cos[lane]
            rate = rotate_back((0.0, 0.0, yaw_sin, yaw_cos), (dx, dy, dz))
            desired = (
                tilt[0] * yaw_cos + tilt[1] * yaw_sin,
                tilt[1] * yaw_cos - tilt[0] * yaw_sin,
                tilt[3] * yaw_sin,
                tilt[3] * yaw_cos,
            )

            # The body rates, eq. (20), and the part of their derivative due to the attitude error,
            # -Lambda_q d(q_v)/dt = -Lambda_q (q_0 a + q_v x a) / 2, with the measured rate a
            # relative to the desired frame. The derivative of omega_d is left out: it would be the
            # third difference of a measured velocity.
            e = relative_rotation(desired, q)
            feed = rotate_back(e, (rate[0], rate[1], rate[2] + b.setpoint_yaw_rate[lane]))
            ax, ay, az = omega[0] - feed[0], omega[1] - feed[1], omega[2] - feed[2]
            b.ctbr[1, lane] = feed[0] - tilt_gain * e[0]
            b.ctbr[2, lane] = feed[1] - tilt_gain * e[1]
            b.ctbr[3, lane] = feed[2] - yaw_gain * e[2]
            b.rate_derivative[0, lane] = -0.5 * tilt_gain * (e[3] * ax + e[1] * az - e[2] * ay)
            b.rate_derivative[1, lane] = -0.5 * tilt_gain * (e[3] * ay + e[2] * ax - e[0] * az)
            b.rate_derivative[2, lane] = -0.5 * yaw_gain * (e[3] * az + e[0] * ay - e[1] * ax)
            for k in range(3):
                v, a = b.setpoint_velocity[k, lane], b.setpoint_acceleration[k, lane]
                j = b.setpoint_jerk[k, lane]
                moved = step * (v + step * (0.5 * a + step * j * (1.0 / 6.0)))
                b.setpoint_position[k, lane] += moved
                b.setpoint_velocity[k, lane] = v + step * (a + 0.5 * step * j)
                b.setpoint_acceleration[k, lane] = a + step * j
            b.setpoint_yaw[lane] += step * b.setpoint_yaw_rate[lane]


@part
def hold_rates(blocks: Records, count: int, settings: Records, hall: bool | None = None) -> None:
    """Make one step of the rate loop, eq. (21), and of the mixer for the first `count` blocks.

    Thrust and body rates are commanded by `ctbr`. The derivative of these rates, `rate_derivative`,
    is 0 unless `track` writes it. For the motor lag, eq. (22), the low-passed derivative of the
    rate error is added. Rotor commands and the state of the loop are written.
    """
    s = settings[0]
    step, per_step, lead, limit = s.step, 1.0 / s.step, s.lead, s.rate_integral_limit
    tilt, yaw, blend = s.rate_tilt, s.rate_yaw, s.rate_error_blend
    tilt_integral, yaw_integral = s.rate_integral_tilt, s.rate_integral_yaw
    for n in range(count):
        b = blocks[n]
        _, _, attitude, angular_velocity = seen_state(b, hall)
        for lane in range(LANES):
            q, w = four(attitude, lane), three(angular_velocity, lane)
            b.body_rate[0, lane], b.body_rate[1, lane], b.body_rate[2, lane] = rotate_back(q, w)
            for k in range(3):
                gain, integral_gain = (tilt, tilt_integral) if k < 2 else (yaw, yaw_integral)
                error, last = b.body_rate[k, lane] - b.ctbr[1 + k, lane], b.rate_error[k, lane]
                rate, integral = b.rate_error_rate[k, lane], b.rate_integral[k, lane]
                # The first step has no last error
                rate += blend * b.started[lane] * ((error - last) * per_step - rate)
                integral = min(max(integral + error * step, -limit), limit)
                b.rate_error[k, lane], b.rate_error_rate[k, lane] = error, rate
                b.rate_integral[k, lane] = integral
                proportional = gain * (error + lead / b.nominal_motor_rate[lane] * rate)
                change = b.rate_derivative[k, lane] + (-proportional - integral_gain * integral)
                b.torque[k, lane] = b.nominal_inertia[k, lane] * change
            j, w = three(b.nominal_inertia, lane), three(b.body_rate, lane)
            lx, ly, lz = j[0] * w[0], j[1] * w[1], j[2] * w[2]
            (thrust, x, y, z), torque = four(b.ctbr, lane), three(b.torque, lane)
            b.started[lane] = 1.0
            (b.commands[0, lane], b.commands[1, lane], b.commands[2, lane], b.commands[3, lane]) = (
                mix_rotors(
                    thrust,
                    torque[0] - (ly * z - lz * y),
                    torque[1] - (lz * x - lx * z),
                    torque[2] - (lx * y - ly * x),
                    b.nominal_max_rotor_thrust[lane],
                    b.rotor_offset[lane],
                    b.thrust_to_torque[lane],
                )
            )
