"""One physics step of a quadrotor, compiled: rotor lag, wrench, semi-implicit Euler.

The rule is that of Bullet's multibody solver for a free body, so that the compiled engine is its
twin. One step of dt, design "Physics":

1. rotor lag, exactly: f <- f_c + (f - f_c) exp(-lambda dt), f_c limited to [0, f_max];
2. wrench: T and tau from the rotors; F = R (0, 0, T) + f with f the force of air and disturbance;
3. w_b += dt J^-1 (tau - w_b x J w_b), w = R w_b, v += dt (F / m + g), p += dt v, q <- exp(w dt) q.
"""

from __future__ import annotations

import math

from swarm_envs.compiled import borrowing_kernel
from swarm_envs.state import FloatArray, Parameters, SwarmState
from swarm_envs.vehicles import GRAVITY

TIME_STEP = 1.0 / 240.0
"""Duration of one physics step, s."""
PHYSICS_RATE = 240
"""Physics steps per second."""
TUMBLING_RATE = 150.0
"""Angular speed above which a drone counts as tumbling, rad/s."""
LARGEST_RATE = 1000.0
"""Limit of each body rate, rad/s: far past tumbling, where the explicit gyroscopic term would grow
without bound, it keeps numbers finite until the episode is ended."""


@borrowing_kernel
def rotation_entries(
    x: float, y: float, z: float, w: float
) -> tuple[float, float, float, float, float, float, float, float, float]:
    """Rotation matrix, row by row, of a unit quaternion (x, y, z, w)."""
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


@borrowing_kernel
def lag_rotors(
    e: int,
    thrust: FloatArray,
    parameters: Parameters,
    limit: FloatArray,
    commands: FloatArray,
    dt: float,
) -> None:
    """Move the rotor thrusts of environment `e` towards their commands (eq. 1c), in place.

    Args:
        e: the environment.
        thrust: (E, N, 4) rotor thrusts, N.
        parameters: of the drones.
        limit: (E, N) largest thrust of one rotor now, N.
        commands: (E, N, 4) commanded rotor thrusts u_c, N; limited to [0, limit].
        dt: s.
    """
    motor_rate = parameters.motor_rate
    decay = 0.0
    for i in range(thrust.shape[1]):
        if i == 0 or motor_rate[e, i] != motor_rate[e, i - 1]:
            decay = math.exp(-motor_rate[e, i] * dt)
        for r in range(4):
            command = min(max(commands[e, i, r], 0.0), limit[e, i])
            thrust[e, i, r] = command + (thrust[e, i, r] - command) * decay


@borrowing_kernel
def rotor_wrench(
    f1: float, f2: float, f3: float, f4: float, offset: float, thrust_to_torque: float
) -> tuple[float, float, float, float]:
    """Total thrust T (N) and body torque tau (N m) of four rotor thrusts (N): eta = B_0 u."""
    return (
        f1 + f2 + f3 + f4,
        offset * (-f1 - f2 + f3 + f4),
        offset * (-f1 + f2 + f3 - f4),
        thrust_to_torque * (-f1 + f2 - f3 + f4),
    )


@borrowing_kernel
def integrate(
    e: int, state: SwarmState, parameters: Parameters, force: FloatArray, dt: float
) -> None:
    """Advance the bodies of environment `e` by one step of `dt`, in place.

    Args:
        e: the environment.
        state: of the swarm; its rotor thrusts act.
        parameters: of the drones.
        force: (E, N, 3) force f_a and disturbance, N, world frame.
        dt: s.
    """
    for i in range(force.shape[1]):
        turn_body(e, i, state, parameters, dt)
        move_body(e, i, state, parameters, force, dt)
        turn_attitude(e, i, state, dt)


@borrowing_kernel
def turn_body(e: int, i: int, state: SwarmState, parameters: Parameters, dt: float) -> None:
    """Advance the angular velocity of drone `i` by Euler's equations in the body frame."""
    q, w, f = state.quaternion, state.angular_velocity, state.rotor_thrust
    inertia = parameters.inertia
    r = rotation_entries(q[e, i, 0], q[e, i, 1], q[e, i, 2], q[e, i, 3])
    _, torque_x, torque_y, torque_z = rotor_wrench(
        f[e, i, 0],
        f[e, i, 1],
        f[e, i, 2],
        f[e, i, 3],
        parameters.rotor_offset[e, i],
        parameters.thrust_to_torque[e, i],
    )
    jx, jy, jz = inertia[e, i, 0], inertia[e, i, 1], inertia[e, i, 2]
    x, y, z = w[e, i, 0], w[e, i, 1], w[e, i, 2]
    bx = r[0] * x + r[3] * y + r[6] * z
    by = r[1] * x + r[4] * y + r[7] * z
    bz = r[2] * x + r[5] * y + r[8] * z
    cx = bx + dt * (torque_x - (by * jz * bz - bz * jy * by)) / jx
    cy = by + dt * (torque_y - (bz * jx * bx - bx * jz * bz)) / jy
    cz = bz + dt * (torque_z - (bx * jy * by - by * jx * bx)) / jz
    cx = min(max(cx, -LARGEST_RATE), LARGEST_RATE)
    cy = min(max(cy, -LARGEST_RATE), LARGEST_RATE)
    cz = min(max(cz, -LARGEST_RATE), LARGEST_RATE)
    w[e, i, 0] = r[0] * cx + r[1] * cy + r[2] * cz
    w[e, i, 1] = r[3] * cx + r[4] * cy + r[5] * cz
    w[e, i, 2] = r[6] * cx + r[7] * cy + r[8] * cz


@borrowing_kernel
def move_body(
    e: int, i: int, state: SwarmState, parameters: Parameters, force: FloatArray, dt: float
) -> None:
    """Advance velocity, then position, of drone `i`; thrust acts along its attitude."""
    q, v, p, f = state.quaternion, state.velocity, state.position, state.rotor_thrust
    r = rotation_entries(q[e, i, 0], q[e, i, 1], q[e, i, 2], q[e, i, 3])
    thrust = f[e, i, 0] + f[e, i, 1] + f[e, i, 2] + f[e, i, 3]
    mass = parameters.mass[e, i]
    v[e, i, 0] += dt * (r[2] * thrust + force[e, i, 0]) / mass
    v[e, i, 1] += dt * (r[5] * thrust + force[e, i, 1]) / mass
    v[e, i, 2] += dt * ((r[8] * thrust + force[e, i, 2]) / mass - GRAVITY)
    for k in range(3):
        p[e, i, k] += dt * v[e, i, k]


@borrowing_kernel
def turn_attitude(e: int, i: int, state: SwarmState, dt: float) -> None:
    """Turn the attitude of drone `i` by its angular velocity over `dt`: q <- exp(w dt) q."""
    q, w = state.quaternion, state.angular_velocity
    x, y, z = w[e, i, 0], w[e, i, 1], w[e, i, 2]
    rate = math.sqrt(x * x + y * y + z * z)
    half = 0.5 * rate * dt
    scale = 0.5 * dt * (1.0 - half * half / 6.0) if half < 1e-4 else math.sin(half) / rate
    ax, ay, az, aw = x * scale, y * scale, z * scale, math.cos(half)
    bx, by, bz, bw = q[e, i, 0], q[e, i, 1], q[e, i, 2], q[e, i, 3]
    cx = aw * bx + ax * bw + ay * bz - az * by
    cy = aw * by - ax * bz + ay * bw + az * bx
    cz = aw * bz + ax * by - ay * bx + az * bw
    cw = aw * bw - ax * bx - ay * by - az * bz
    norm = math.sqrt(cx * cx + cy * cy + cz * cz + cw * cw)
    q[e, i, 0] = cx / norm
    q[e, i, 1] = cy / norm
    q[e, i, 2] = cz / norm
    q[e, i, 3] = cw / norm
