"""One physics step of quadrotors, in lanes: motor lag, wrench, semi-implicit Euler.

The method is that of Bullet's multibody solver for a free body, so that both engines agree. One
step of dt:

1. motor lag, exactly: f <- f_c + (f - f_c) exp(-lambda dt), f_c limited to [0, f_max];
2. wrench: T and tau of the rotors; F = R (0, 0, T) + f with aerodynamic and external forces f;
3. w_b += dt J^-1 (tau - w_b x J w_b), w = R w_b, v += dt (F / m + g), p += dt v, q <- exp(w dt) q.
"""

from __future__ import annotations

import math

import numpy as np

from swarm_envs.compiled import equation, part
from swarm_envs.control.loop import four, three
from swarm_envs.noise import normal
from swarm_envs.tables import LANES, Record, Records
from swarm_envs.vehicles import GRAVITY

__all__ = ["PHYSICS_RATE", "TIME_STEP"]

PHYSICS_RATE = 240
"""Physics steps per second."""
TIME_STEP = 1.0 / PHYSICS_RATE
"""Duration of one physics step, s."""
TUMBLING_RATE = 150.0  # Angular speed above which a drone counts as tumbling, rad/s
LARGEST_RATE = 1000.0
"""Limit of each body rate, rad/s, far beyond tumbling: it keeps numbers finite until the episode
ends, since the explicit gyroscopic term would grow without bound."""


@equation
def rotation_entries(
    x: float, y: float, z: float, w: float
) -> tuple[float, float, float, float, float, float, float, float, float]:
    """Return the rotation matrix, row by row, of a unit quaternion (x, y, z, w)."""
    return (
        1.0 - 2.0 * (y * y + z * z),
        2.0 * (x * y - z * w),
        2.0 * (x * z + y * w),
        2.0 * (x * y + z * w),
        1.0 - 2.0 * (x * x + z * z),
        2.0 * (y * z - x * w),
        2.0 * (x * z - y * w),
        2.0 * (y * z + x * w),
        1.0 - 2.0 * (x * x + y * y),
    )


@equation
def rotor_wrench(
    rotors: tuple[float, float, float, float], offset: float, thrust_to_torque: float
) -> tuple[float, float, float, float]:
    """Return total thrust T (N) and torque tau (N m, body frame) of rotor thrusts (N): B_0 u."""
    f1, f2, f3, f4 = rotors
    return (
        f1 + f2 + f3 + f4,
        offset * (-f1 - f2 + f3 + f4),
        offset * (-f1 + f2 + f3 - f4),
        thrust_to_torque * (-f1 + f2 - f3 + f4),
    )


@equation
def sinc_cos(angle: float) -> tuple[float, float]:
    """Return sin(angle) / angle and cos(angle), within 1e-13 for angles of up to 8 rad.

    Library functions would prevent vectorization. Taylor's series at an eighth of the angle, where
    eight terms are exact, is doubled three times: sin 2a = 2 sin a cos a and
    1 - cos 2a = 2 (sin a)^2. 1 - cos is used instead of cos, which loses digits near 1.
    """
    a = 0.125 * angle
    x = a * a
    sinc = 1.0 - x * (
        1 / 6
        - x
        * (
            1 / 120
            - x
            * (
                1 / 5040
                - x * (1 / 362880 - x * (1 / 39916800 - x * (1 / 6227020800 - x / 1307674368000)))
            )
        )
    )
    less = x * (
        1 / 2
        - x
        * (
            1 / 24
            - x
            * (
                1 / 720
                - x * (1 / 40320 - x * (1 / 3628800 - x * (1 / 479001600 - x / 87178291200)))
            )
        )
    )
    for _ in range(3):
        sinc, less, a = sinc * (1.0 - less), 2.0 * (sinc * a) * (sinc * a), 2.0 * a
    return sinc, 1.0 - less


@part
def spin_rotors(blocks: Records, count: int) -> None:
    """Update the metrics of `count` blocks, and advance the rotors to their commands, eq. 1c."""
    for n in range(count):
        b = blocks[n]
        for lane in range(LANES):
            x, y, z = three(b.force, lane)
            b.worst_force[lane] = max(b.worst_force[lane], math.sqrt(x * x + y * y + z * z))
            b.outside_steps[lane] += b.outside[lane]
            b.steps[lane] += 1.0
            b.over_bound[lane] += 1.0 if abs(z) > b.force_bound[lane] else 0.0
            power = 0.0
            limit, decay = b.rotor_limit[lane], b.motor_decay[lane]
            for r in range(4):
                thrust = b.rotor_thrust[r, lane]
                power += thrust * math.sqrt(max(thrust, 0.0))
                command = min(max(b.commands[r, lane], 0.0), limit)
                b.rotor_thrust[r, lane] = command + (thrust - command) * decay
            b.energy[lane] += power * b.energy_scale[lane]


@part
def integrate(blocks: Records, count: int, varied: bool | None = None) -> None:
    """Advance the bodies of `count` blocks by 1/240 s.

    `varied` is True if there may be an interaction torque, else None.
    """
    dt = TIME_STEP
    for n in range(count):
        b = blocks[n]
        for lane in range(LANES):
            qx, qy, qz, qw = four(b.quaternion, lane)
            r = rotation_entries(qx, qy, qz, qw)
            rotors = four(b.rotor_thrust, lane)
            thrust, tx, ty, tz = rotor_wrench(
                rotors, b.rotor_offset[lane], b.thrust_to_torque[lane]
            )
            gain = b.thrust_gain[lane]
            thrust, tx, ty, tz = gain * thrust, gain * tx, gain * ty, gain * tz
            if varied is not None:
                x, y, z = three(b.interaction_torque, lane)
                tx, ty, tz = tx + x, ty + y, tz + z
            # Euler's equations in the body frame
            jx, jy, jz = three(b.inertia, lane)
            x, y, z = three(b.angular_velocity, lane)
            bx = r[0] * x + r[3] * y + r[6] * z
            by = r[1] * x + r[4] * y + r[7] * z
            bz = r[2] * x + r[5] * y + r[8] * z
            cx = bx + dt * (tx - (by * jz * bz - bz * jy * by)) / jx
            cy = by + dt * (ty - (bz * jx * bx - bx * jz * bz)) / jy
            cz = bz + dt * (tz - (bx * jy * by - by * jx * bx)) / jz
            cx = min(max(cx, -LARGEST_RATE), LARGEST_RATE)
            cy = min(max(cy, -LARGEST_RATE), LARGEST_RATE)
            cz = min(max(cz, -LARGEST_RATE), LARGEST_RATE)
            x = r[0] * cx + r[1] * cy + r[2] * cz
            y = r[3] * cx + r[4] * cy + r[5] * cz
            z = r[6] * cx + r[7] * cy + r[8] * cz
            w = b.angular_velocity
            w[0, lane], w[1, lane], w[2, lane] = x, y, z
            # Newton's equations, with the thrust along the old attitude
            per_mass = dt / b.mass[lane]
            (fx, fy, fz), (ex, ey, ez) = three(b.force, lane), three(b.external, lane)
            b.velocity[0, lane] += per_mass * (r[2] * thrust + (fx + ex))
            b.velocity[1, lane] += per_mass * (r[5] * thrust + (fy + ey))
            b.velocity[2, lane] += per_mass * (r[8] * thrust + (fz + ez)) - dt * GRAVITY
            for k in range(3):
                b.position[k, lane] += dt * b.velocity[k, lane]
            # Rotation of the attitude by the new angular velocity: q <- exp(w dt) q
            half = 0.5 * math.sqrt(x * x + y * y + z * z) * dt
            s, aw = sinc_cos(half)
            s *= 0.5 * dt
            ax, ay, az = x * s, y * s, z * s
            nx = aw * qx + ax * qw + ay * qz - az * qy
            ny = aw * qy - ax * qz + ay * qw + az * qx
            nz = aw * qz + ax * qy - ay * qx + az * qw
            nw = aw * qw - ax * qx - ay * qy - az * qz
            scale = 1.0 / math.sqrt(nx * nx + ny * ny + nz * nz + nw * nw)
            q = b.quaternion
            q[0, lane], q[1, lane] = nx * scale, ny * scale
            q[2, lane], q[3, lane] = nz * scale, nw * scale


@part
def gust(environment: Record, first: int, drones: int, settings: Records, blocks: Records) -> None:
    """Advance an environment's gusts by a step, and write the force on drones from slot `first`.

    The acceleration is an exactly discretized Ornstein-Uhlenbeck process.
    """
    kept, strength = settings[0].gust_kept, settings[0].gust_strength
    fresh = strength * math.sqrt(1.0 - kept * kept)
    for k in range(3):
        drawn = normal(environment.gust_key, np.uint64(3 * environment.age + k))
        environment.gust[k] = kept * environment.gust[k] + fresh * drawn
        for slot in range(first, first + drones):
            b, lane = blocks[slot // LANES], slot % LANES
            b.external[k, lane] = b.mass[lane] * environment.gust[k]
