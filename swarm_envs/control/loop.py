"""The tracking controller of Neural-Swarm2, Sec. VI (version 1): from set-points to rotor thrusts.

Position loop, eqs. (18) and (19); attitude loop, eqs. (20) and (21); compensation of the motors'
lag, eq. (22), which adds to the desired thrust its low-passed derivative over lambda, and to the
torque the derivative of the rate error; the mixer. `track` makes one step at 240 Hz for blocks of
drones, and `hold_rates` one step of the inner loop alone.

Rotors: 1 front right, 2 back right, 3 back left, 4 front left; body x forward, y left, z up.
"""

from __future__ import annotations

import math

from swarm_envs.compiled import equation, part
from swarm_envs.tables import LANES, Record, Records
from swarm_envs.vehicles import GRAVITY

Vector = tuple[float, float, float]
"""x, y, z."""
Quaternion = tuple[float, float, float, float]
"""x, y, z, w: scalar last, body to world."""


@equation
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


@equation
def relative_rotation(a: Quaternion, b: Quaternion) -> Quaternion:
    """Rotation from frame a to frame b, conj(a) b, with its scalar part not negative."""
    x = a[3] * b[0] - a[0] * b[3] - a[1] * b[2] + a[2] * b[1]
    y = a[3] * b[1] - a[1] * b[3] - a[2] * b[0] + a[0] * b[2]
    z = a[3] * b[2] - a[2] * b[3] - a[0] * b[1] + a[1] * b[0]
    w = a[3] * b[3] + a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
    sign = -1.0 if w < 0.0 else 1.0
    return sign * x, sign * y, sign * z, sign * w


@equation
def axis_acceleration(
    error: float,
    last_error: float,
    error_rate: float,
    integral: float,
    rate_gain: float,
    integral_gain: float,
    lead_time: float,
    step: float,
    blend: float,
    limit: float,
) -> Vector:
    """Feedback part of eq. (21) about one body axis, with the lead of eq. (22), over J.

    Args:
        error: body-rate error omega - omega_r, rad/s.
        last_error: that of the last step, rad/s.
        error_rate: its low-passed derivative until the last step, rad/s^2.
        integral: its integral until the last step, rad.
        rate_gain: K_omega / J, 1/s.
        integral_gain: Gamma_omega / J, 1/s^2.
        lead_time: 1 / lambda, s, or zero without lag compensation.
        step: length of a controller step, s.
        blend: of the low-pass on the derivative; zero on the first step, which has no last one.
        limit: of the integral, rad.

    Returns:
        The angular acceleration, rad/s^2, and the derivative and the integral with this step.
    """
    error_rate += blend * ((error - last_error) * (1.0 / step) - error_rate)
    integral = min(max(integral + error * step, -limit), limit)
    proportional = rate_gain * (error + lead_time * error_rate)
    return -proportional - integral_gain * integral, error_rate, integral


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
    """Rotor thrusts (N) of one drone that give a wrench, each in [0, max_rotor_thrust].

    A wrench that the rotors can give is given exactly. Otherwise parts of it are given up in the
    order yaw, thrust, roll and pitch: yaw is scaled down as far as the rest needs; if that is not
    enough the thrust is shifted, as little as possible; only when roll and pitch alone ask for
    more than the rotors' range are they scaled, both alike.

    Args:
        thrust: total thrust T, N.
        torque_x: roll torque in the body frame, N m.
        torque_y: pitch torque, N m.
        torque_z: yaw torque, N m.
        max_rotor_thrust: largest thrust of one rotor, N.
        rotor_offset: distance of each rotor from the body x and y axes, m.
        thrust_to_torque: yaw torque per newton of rotor thrust, m.
    """
    # Rotors 1 and 3 take opposite shares of roll and pitch, and so do 2 and 4.
    per_arm = 0.25 / rotor_offset
    diagonal_1 = -(torque_x + torque_y) * per_arm
    diagonal_2 = (torque_y - torque_x) * per_arm
    largest = max(abs(diagonal_1), abs(diagonal_2))
    too_much = 2.0 * largest > max_rotor_thrust
    scale = 0.5 * max_rotor_thrust / largest if too_much else 1.0
    diagonal_1 *= scale
    diagonal_2 *= scale
    largest = 0.5 * max_rotor_thrust if too_much else largest

    # Positive yaw takes thrust from rotors 1 and 3 and gives it to 2 and 4, so it narrows the range
    # of thrusts that fit on one side and may widen it on the other.
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


@equation
def axis_force(
    position_error: float,
    velocity: float,
    setpoint_velocity: float,
    setpoint_acceleration: float,
    integral: float,
    mass: float,
    position_gain: float,
    velocity_gain: float,
    integral_gain: float,
    step: float,
    limit: float,
) -> tuple[float, float]:
    """Desired force along one world axis, N, without gravity and f_hat: eqs. (18) and (19).

    Args:
        position_error: p - p_d, m.
        velocity: v, m/s.
        setpoint_velocity: derivative of p_d, m/s.
        setpoint_acceleration: its second derivative, m/s^2.
        integral: integral of the velocity error until the last step, m.
        mass: m, kg.
        position_gain: Lambda, 1/s.
        velocity_gain: K_v / m, 1/s.
        integral_gain: Gamma_v, 1/s.
        step: length of a controller step, s.
        limit: of the integral, m.

    Returns:
        The force, and the integral with this step.
    """
    reference = setpoint_velocity - position_gain * position_error
    reference_rate = setpoint_acceleration - position_gain * (velocity - setpoint_velocity)
    error = velocity - reference
    integral = min(max(integral + error * step, -limit), limit)
    damping = (velocity_gain + integral_gain) * error
    return mass * (reference_rate - damping - velocity_gain * integral_gain * integral), integral


@part
def track(blocks: Records, count: int, settings: Records) -> None:
    """Make one controller step for every drone of the first `count` blocks.

    Args:
        blocks: records of `LANES` drones; set-points, memory and commands are written. The
            set-points are then extrapolated by one step with their jerk.
        count: how many of them.
        settings: (1,) gains. They are read here, once: inside of the lane loop they would keep it
            from becoming vector instructions.
    """
    s = settings[0]
    step, per_step, lead = s.step, 1.0 / s.step, s.lead  # a division takes as long as ten sums
    kp, kv, ki, v_limit = (
        s.position_gain,
        s.velocity_gain,
        s.integral_gain,
        s.velocity_integral_limit,
    )
    tilt_gain, yaw_gain = s.attitude_tilt, s.attitude_yaw
    gains = (
        s.rate_tilt,
        s.rate_yaw,
        s.rate_integral_tilt,
        s.rate_integral_yaw,
        step,
        s.rate_integral_limit,
    )
    thrust_blend, error_blend = s.thrust_rate_blend, s.rate_error_blend
    rate_blend, least = s.desired_rate_blend, s.min_vertical_thrust_fraction
    for n in range(count):
        b = blocks[n]
        # Trigonometric functions are no vector instructions: they are left out where none yaws.
        largest_yaw = 0.0
        for lane in range(LANES):
            largest_yaw = max(largest_yaw, abs(b.setpoint_yaw[lane]))
        for lane in range(LANES):
            b.yaw_sin[lane], b.yaw_cos[lane] = 0.0, 1.0
            if largest_yaw > 0.0:
                half = 0.5 * b.setpoint_yaw[lane]
                b.yaw_sin[lane], b.yaw_cos[lane] = math.sin(half), math.cos(half)
        for lane in range(LANES):
            q = (
                b.quaternion[0, lane],
                b.quaternion[1, lane],
                b.quaternion[2, lane],
                b.quaternion[3, lane],
            )
            w = (
                b.angular_velocity[0, lane],
                b.angular_velocity[1, lane],
                b.angular_velocity[2, lane],
            )
            omega = rotate_back(q, w)
            mass, motor_rate = b.nominal_mass[lane], b.nominal_motor_rate[lane]
            started = b.started[lane]

            # The desired force, eq. (19). Its vertical part is kept positive: it always points up.
            fx, b.velocity_integral[0, lane] = axis_force(
                b.position[0, lane] - b.setpoint_position[0, lane],
                b.velocity[0, lane],
                b.setpoint_velocity[0, lane],
                b.setpoint_acceleration[0, lane],
                b.velocity_integral[0, lane],
                mass,
                kp,
                kv,
                ki,
                step,
                v_limit,
            )
            fy, b.velocity_integral[1, lane] = axis_force(
                b.position[1, lane] - b.setpoint_position[1, lane],
                b.velocity[1, lane],
                b.setpoint_velocity[1, lane],
                b.setpoint_acceleration[1, lane],
                b.velocity_integral[1, lane],
                mass,
                kp,
                kv,
                ki,
                step,
                v_limit,
            )
            fz, b.velocity_integral[2, lane] = axis_force(
                b.position[2, lane] - b.setpoint_position[2, lane],
                b.velocity[2, lane],
                b.setpoint_velocity[2, lane],
                b.setpoint_acceleration[2, lane],
                b.velocity_integral[2, lane],
                mass,
                kp,
                kv,
                ki,
                step,
                v_limit,
            )
            weight = mass * GRAVITY
            fx -= b.believed_force[0, lane]
            fy -= b.believed_force[1, lane]
            fz = max(fz + weight - b.believed_force[2, lane], least * weight)

            # The thrust along the body's axis, with the lead of eq. (22).
            thrust = (
                2.0 * (q[0] * q[2] + q[3] * q[1]) * fx
                + 2.0 * (q[1] * q[2] - q[3] * q[0]) * fy
                + (1.0 - 2.0 * (q[0] * q[0] + q[1] * q[1])) * fz
            )
            thrust_rate = b.thrust_rate[lane]
            raw = (thrust - b.desired_thrust[lane]) * per_step
            thrust_rate += started * thrust_blend * (raw - thrust_rate)
            b.desired_thrust[lane], b.thrust_rate[lane] = thrust, thrust_rate
            lead_time = lead / motor_rate
            thrust += lead_time * thrust_rate

            # The desired attitude: the shortest rotation of the world's z axis to the force; and
            # its rate: the tilt's is differentiated and low-passed.
            length = math.sqrt(fx * fx + fy * fy + fz * fz)
            half_cos = math.sqrt(0.5 * (1.0 + fz / length))
            tilt_scale = 0.5 / (half_cos * length)
            tilt = -fy * tilt_scale, fx * tilt_scale, 0.0, half_cos
            last = (
                b.desired_attitude[0, lane],
                b.desired_attitude[1, lane],
                b.desired_attitude[2, lane],
                b.desired_attitude[3, lane],
            )
            change = relative_rotation(last, tilt)
            dx, dy, dz = b.desired_rate[0, lane], b.desired_rate[1, lane], b.desired_rate[2, lane]
            dx += started * rate_blend * (2.0 * change[0] * per_step - dx)
            dy += started * rate_blend * (2.0 * change[1] * per_step - dy)
            dz += started * rate_blend * (2.0 * change[2] * per_step - dz)
            b.desired_rate[0, lane], b.desired_rate[1, lane], b.desired_rate[2, lane] = dx, dy, dz
            b.desired_attitude[0, lane], b.desired_attitude[1, lane] = tilt[0], tilt[1]
            b.desired_attitude[2, lane], b.desired_attitude[3, lane] = tilt[2], tilt[3]
            yaw_sin, yaw_cos = b.yaw_sin[lane], b.yaw_cos[lane]
            dx, dy, dz = rotate_back((0.0, 0.0, yaw_sin, yaw_cos), (dx, dy, dz))
            desired = (
                tilt[0] * yaw_cos + tilt[1] * yaw_sin,
                tilt[1] * yaw_cos - tilt[0] * yaw_sin,
                tilt[3] * yaw_sin,
                tilt[3] * yaw_cos,
            )

            # The torque, eqs. (20) and (21). Of the derivative of omega_r the part that the
            # attitude error brings, -Lambda_q d(q_v)/dt = -Lambda_q (q_0 a + q_v x a) / 2 with the
            # rate a against the desired frame, is included, from the measured rates. That of
            # omega_d is left out: it would be the third difference of a measured velocity.
            e = relative_rotation(desired, q)
            feed = rotate_back(e, (dx, dy, dz + b.setpoint_yaw_rate[lane]))
            ax, ay, az = omega[0] - feed[0], omega[1] - feed[1], omega[2] - feed[2]
            rx, ry = feed[0] - tilt_gain * e[0], feed[1] - tilt_gain * e[1]
            rz = feed[2] - yaw_gain * e[2]
            ux = -0.5 * tilt_gain * (e[3] * ax + e[1] * az - e[2] * ay)
            uy = -0.5 * tilt_gain * (e[3] * ay + e[2] * ax - e[0] * az)
            uz = -0.5 * yaw_gain * (e[3] * az + e[0] * ay - e[1] * ax)
            torque_x, torque_y, torque_z = rate_torque(
                b,
                lane,
                omega,
                (rx, ry, rz),
                (ux, uy, uz),
                lead_time,
                error_blend * started,
                gains,
            )
            b.started[lane] = 1.0
            (b.commands[0, lane], b.commands[1, lane], b.commands[2, lane], b.commands[3, lane]) = (
                mix_rotors(
                    thrust,
                    torque_x,
                    torque_y,
                    torque_z,
                    b.nominal_max_rotor_thrust[lane],
                    b.rotor_offset[lane],
                    b.thrust_to_torque[lane],
                )
            )
            for k in range(3):
                v, a = b.setpoint_velocity[k, lane], b.setpoint_acceleration[k, lane]
                j = b.setpoint_jerk[k, lane]
                b.setpoint_position[k, lane] += step * (
                    v + step * (0.5 * a + step * j * (1.0 / 6.0))
                )
                b.setpoint_velocity[k, lane] += step * (a + 0.5 * step * j)
                b.setpoint_acceleration[k, lane] += step * j
            b.setpoint_yaw[lane] += step * b.setpoint_yaw_rate[lane]


@equation
def rate_torque(
    b: Record,
    lane: int,
    omega: Vector,
    wanted: Vector,
    wanted_rate: Vector,
    lead: float,
    blend: float,
    gains: tuple[float, float, float, float, float, float],
) -> Vector:
    """Torque (N m) about the body axes that brings body rates to those wanted: eqs. (21), (22).

    Args:
        b: a block; the integrals, last errors and low-passed derivatives of lane lane are updated.
        lane: the lane.
        omega: body rates, rad/s.
        wanted: omega_r, rad/s.
        wanted_rate: its derivative, as far as it is known, rad/s^2.
        lead: 1 / lambda, s, or zero without lag compensation.
        blend: of the low-pass on the derivative; zero on the first step, which has no last one.
        gains: K_omega / J (1/s) of roll and pitch, of yaw, Gamma_omega / J (1/s^2) of both, the
            length of a step, s, and the limit of the integral, rad.
    """
    kt, ky, it, iy, step, limit = gains
    ex, ey, ez = omega[0] - wanted[0], omega[1] - wanted[1], omega[2] - wanted[2]
    bx, b.rate_error_rate[0, lane], b.rate_integral[0, lane] = axis_acceleration(
        ex,
        b.rate_error[0, lane],
        b.rate_error_rate[0, lane],
        b.rate_integral[0, lane],
        kt,
        it,
        lead,
        step,
        blend,
        limit,
    )
    by, b.rate_error_rate[1, lane], b.rate_integral[1, lane] = axis_acceleration(
        ey,
        b.rate_error[1, lane],
        b.rate_error_rate[1, lane],
        b.rate_integral[1, lane],
        kt,
        it,
        lead,
        step,
        blend,
        limit,
    )
    bz, b.rate_error_rate[2, lane], b.rate_integral[2, lane] = axis_acceleration(
        ez,
        b.rate_error[2, lane],
        b.rate_error_rate[2, lane],
        b.rate_integral[2, lane],
        ky,
        iy,
        lead,
        step,
        blend,
        limit,
    )
    b.rate_error[0, lane], b.rate_error[1, lane], b.rate_error[2, lane] = ex, ey, ez
    jx, jy, jz = b.nominal_inertia[0, lane], b.nominal_inertia[1, lane], b.nominal_inertia[2, lane]
    lx, ly, lz = jx * omega[0], jy * omega[1], jz * omega[2]
    return (
        jx * (wanted_rate[0] + bx) - (ly * wanted[2] - lz * wanted[1]),
        jy * (wanted_rate[1] + by) - (lz * wanted[0] - lx * wanted[2]),
        jz * (wanted_rate[2] + bz) - (lx * wanted[1] - ly * wanted[0]),
    )


@part
def hold_rates(blocks: Records, count: int, settings: Records) -> None:
    """Make one step of the rate loop for the first `count` blocks, towards `asked`."""
    s = settings[0]
    lead, blend, integral = s.lead, s.rate_error_blend, (s.rate_integral_tilt, s.rate_integral_yaw)
    gains = s.rate_tilt, s.rate_yaw, integral[0], integral[1], s.step, s.rate_integral_limit
    for n in range(count):
        b = blocks[n]
        for lane in range(LANES):
            q = (
                b.quaternion[0, lane],
                b.quaternion[1, lane],
                b.quaternion[2, lane],
                b.quaternion[3, lane],
            )
            w = (
                b.angular_velocity[0, lane],
                b.angular_velocity[1, lane],
                b.angular_velocity[2, lane],
            )
            torque_x, torque_y, torque_z = rate_torque(
                b,
                lane,
                rotate_back(q, w),
                (b.asked[1, lane], b.asked[2, lane], b.asked[3, lane]),
                (0.0, 0.0, 0.0),
                lead / b.nominal_motor_rate[lane],
                blend * b.started[lane],
                gains,
            )
            b.started[lane] = 1.0
            (b.commands[0, lane], b.commands[1, lane], b.commands[2, lane], b.commands[3, lane]) = (
                mix_rotors(
                    b.asked[0, lane],
                    torque_x,
                    torque_y,
                    torque_z,
                    b.nominal_max_rotor_thrust[lane],
                    b.rotor_offset[lane],
                    b.thrust_to_torque[lane],
                )
            )
