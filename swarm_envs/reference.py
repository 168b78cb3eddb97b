"""The equations of the simulator in NumPy, torch or JAX: to read, differentiate and compile.

Tests compare both engines with this file, to 1e-9. Equation numbers, and most symbols, are those of
Neural-Swarm2 (version 1):

    p, v    position and velocity, m, m/s, in the world frame: x and y horizontal, z up
    R, q    attitude, from body to world: the rotation, and its quaternion (x, y, z, w)
    w       angular velocity (omega), rad/s, in the world frame; in `held` in the body frame
    u, u_c  thrust and commanded thrust of each rotor, N
    T, tau  total thrust of the rotors, N, and their torque, N m, in the body frame
    lambda  motor rate, 1/s: the time constant of rotors is 1/lambda, 62.5 ms at 16 1/s
    f_a     aerodynamic force on a drone besides its thrust: downwash, ground effect, drag; N
    p_ij    downwash on drone i by the jet of drone j, N, at depth dz and distance r from its axis
    x_d, x_r, x~, x'  desired, reference, error (actual minus desired), derivative; f^: predicted

Arrays are (..., N, 3) for N drones; leading axes count independent flights. Parameters of vehicles,
forces and controller are arguments, see `swarm_envs.reference_numbers`. Functions change no
argument, and no value decides which line runs, so that flights can be differentiated and compiled:

    body, air, gains = bodies_of("LS"), aerodynamics_of("learned", "LS"), gains_of()
    p = np.array([[[0.0, 0.0, 1.3], [0.0, 0.0, 1.0]]])  # one flight of two drones
    state, setpoint = hovering(p, body), Setpoint.hold(p)
    for _ in range(240):
        state = step(state, setpoint, body, gains, forces=partial(learned, air=air))
        setpoint = moved_on(setpoint)
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, NamedTuple

from array_api_compat import array_namespace

from swarm_envs.interactions.composed import AXIS_RADIUS
from swarm_envs.interactions.field import LOWEST_HEIGHT, ONSET, UNITS_OF_OWN, UNITS_OF_PAIR
from swarm_envs.reference_numbers import Numbers
from swarm_envs.state import Parameters, Setpoint
from swarm_envs.vehicles import GRAM_FORCE, GRAVITY

__all__ = ["State", "deep_set", "hovering", "learned", "moved", "moved_on", "step", "wake"]

Array = Any  # of NumPy, torch or JAX
Forces = Callable[..., Array]  # f_a of positions and velocities: `partial(wake, air=air)`

DT = 1.0 / 240.0  # s, one step
ROTORS = ((1, -1), (-1, -1), (-1, 1), (1, 1))  # positions of rotors 1 to 4, in rotor offsets


class State(NamedTuple):
    """The state: that of the drones, then that of their controllers."""

    position: Array  # p (..., N, 3), m
    velocity: Array  # v (..., N, 3), m/s
    quaternion: Array  # q (..., N, 4), (x, y, z, w), of unit length
    angular_velocity: Array  # w (..., N, 3), rad/s, in the world frame
    rotor_thrust: Array  # u (..., N, 4), N
    velocity_integral: Array  # integral of the velocity error (..., N, 3), m
    thrust: Array  # T_d of the last step (..., N), N
    thrust_rate: Array  # its derivative, low-passed, N/s
    tilt: Array  # desired attitude of the last step, before yaw (..., N, 4)
    tilt_rate: Array  # its angular velocity in its own frame, low-passed (..., N, 3), rad/s
    rate_error: Array  # w - w_r of the last step, in the body frame (..., N, 3), rad/s
    rate_error_rate: Array  # its derivative, low-passed, rad/s^2
    rate_integral: Array  # its integral, rad
    started: Array  # 0 before the first step, then 1 (..., N)


# Vectors and quaternions
def along_z(length: Array) -> Array:
    """Return the vectors (0, 0, length)."""
    return array_namespace(length).stack([0.0 * length, 0.0 * length, length], axis=-1)


def components(a: Array) -> tuple[Array, ...]:
    """Return the components of vectors or quaternions, each as an array."""
    return tuple(a[..., k] for k in range(a.shape[-1]))


def dot(a: Array, b: Array) -> Array:
    """Return the scalar product."""
    return sum(x * y for x, y in zip(components(a), components(b), strict=True))


def cross(a: Array, b: Array) -> Array:
    """Return the vector product a x b."""
    ax, ay, az, bx, by, bz = *components(a), *components(b)
    product = [ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx]
    return array_namespace(a, b).stack(product, axis=-1)


def root(x: Array, n: float = 2.0) -> Array:
    """Return the n-th root of x >= 0; its derivative at 0 is 0, not infinite."""
    xp = array_namespace(x)
    above = xp.where(x > 0.0, x, 1.0)
    return xp.where(x > 0.0, above ** (1.0 / n), 0.0)


def multiply(a: Array, b: Array) -> Array:
    """Return the quaternion a b: the rotation b, then a."""
    scalar = a[..., 3] * b[..., 3] - dot(a[..., :3], b[..., :3])
    vector = a[..., 3:] * b[..., :3] + b[..., 3:] * a[..., :3] + cross(a[..., :3], b[..., :3])
    return array_namespace(a, b).concat([vector, scalar[..., None]], axis=-1)


def inverse(q: Array) -> Array:
    """Return the inverse rotation."""
    return array_namespace(q).concat([-q[..., :3], q[..., 3:]], axis=-1)


def rotate(q: Array, a: Array) -> Array:
    """Return R a: a vector of the body frame in the world frame."""
    twice = 2.0 * cross(q[..., :3], a)
    return a + q[..., 3:] * twice + cross(q[..., :3], twice)


def turn_by(angle: Array) -> Array:
    """Return the quaternion of a rotation vector, rad."""
    xp, half = array_namespace(angle), 0.5 * root(dot(angle, angle))
    sinc = xp.where(half > 0.0, xp.sin(half) / xp.where(half > 0.0, half, 1.0), 1.0)
    return xp.concat([(0.5 * sinc)[..., None] * angle, xp.cos(half)[..., None]], axis=-1)


def from_to(a: Array, b: Array) -> Array:
    """Return the shortest rotation from attitude a to b: a^-1 b, with a scalar part >= 0."""
    q = multiply(inverse(a), b)
    return array_namespace(q).where(q[..., 3:] < 0.0, -q, q)


# Rotors and bodies, eq. (1)
def lagged(thrust: Array, command: Array, body: Parameters, dt: float = DT) -> Array:
    """Return rotor thrusts after dt, eq. (1c): u' = lambda (u_c - u), solved exactly."""
    xp = array_namespace(thrust)
    reachable = xp.clip(command, 0.0, body.max_rotor_thrust[..., None])
    return reachable + (thrust - reachable) * xp.exp(-body.motor_rate * dt)[..., None]


def wrench(rotors: Array, body: Parameters) -> tuple[Array, Array]:
    """Return thrust and torque of the rotors, (T, tau) = B_0 u."""
    u1, u2, u3, u4 = components(rotors)
    arm, yaw = body.rotor_offset, body.thrust_to_torque
    tau = [arm * (-u1 - u2 + u3 + u4), arm * (-u1 + u2 + u3 - u4), yaw * (-u1 + u2 - u3 + u4)]
    return u1 + u2 + u3 + u4, array_namespace(rotors).stack(tau, axis=-1)


def turned(q: Array, w: Array, tau: Array, inertia: Array, dt: float) -> tuple[Array, Array]:
    """Rotate bodies by eq. (1b), J w' = J w x w + tau in the body frame, as both engines do.

    The step is semi-implicit: the attitude changes by the new angular velocity. A free spin thereby
    gains energy, unlike in `turned_exactly`.
    """
    w_b = rotate(inverse(q), w)
    w = rotate(q, w_b + dt * (tau - cross(w_b, inertia * w_b)) / inertia)
    q = multiply(turn_by(w * dt), q)
    return q / root(dot(q, q))[..., None], w


def turned_exactly(q: Array, w: Array, tau: Array, inertia: Array, dt: float) -> Any:
    """Rotate bodies so that only the torque changes their angular momentum R J R^T w.

    The attitude changes by the angular velocity in the middle of the step. No engine does this.
    """
    momentum = rotate(q, inertia * rotate(inverse(q), w))
    middle = multiply(turn_by(0.5 * dt * w), q)
    gained = dt * rotate(middle, tau)
    w = rotate(middle, rotate(inverse(middle), momentum + 0.5 * gained) / inertia)
    q = multiply(turn_by(w * dt), q)
    return q, rotate(q, rotate(inverse(q), momentum + gained) / inertia)


def moved(
    state: State, command: Array, force: Array, torque: Array, body: Parameters, dt: float = DT
) -> State:
    """Advance rotors and bodies: eqs. (1c), (1b), and (1a), m v' = m g + R (0, 0, T) + f_a.

    `force` is f_a, `torque` that of `aerodynamic_torque`. The step is semi-implicit: p follows the
    new v.
    """
    rotors = lagged(state.rotor_thrust, command, body, dt)
    thrust, tau = wrench(rotors, body)
    push = rotate(state.quaternion, along_z(thrust)) + force
    v = state.velocity + dt * (push / body.mass[..., None] - along_z(GRAVITY + 0.0 * thrust))
    q, w = turned(state.quaternion, state.angular_velocity, tau + torque, body.inertia, dt)
    return State(state.position + dt * v, v, q, w, rotors, *state[5:])


# Aerodynamic forces f_a. Arrays of pairs are (..., N, N-1): on drone i, the row, by another drone j
def of_others(x: Array, air: Numbers) -> Array:
    """Return positions or velocities of the other drones for each drone: (..., N, N-1, 3)."""
    xp, shape = array_namespace(x), (*x.shape[:-1], x.shape[-2] - 1, x.shape[-1])
    return xp.reshape(xp.take(x, air["others"], axis=-2), shape)


def fade(distance: Array, full: float, end: float) -> Array:
    """Return a smooth weight by a distance, m: 1 up to `full`, 0 from `end` on."""
    xp = array_namespace(distance)
    u = xp.clip((distance - full) / max(end - full, 1e-12), 0.0, 1.0)
    return xp.maximum(1.0 - u * u * u * (10.0 + u * (6.0 * u - 15.0)), 0.0)  # 0 despite rounding


def fade_in_box(offset: Array, air: Numbers) -> Array:
    """Return the weight w_ij of pairs in the interaction volume, along x, y and z."""
    x, y, z = components(array_namespace(offset).abs(offset))
    return fade(x, *air["sides"]) * fade(y, *air["sides"]) * fade(z, *air["depth"])


def axis_offset(offset: Array, velocity: Array, air: Numbers) -> tuple[Array, Array]:
    """Return the horizontal offset, m, from drone i to the axis of j's jet, which trails behind j.

    The air at depth dz below j left it at j's position of `delay` (s/m) times dz earlier.
    """
    late = air["delay"] * array_namespace(offset).maximum(offset[..., 2], 0.0)
    return offset[..., 0] - velocity[..., 0] * late, offset[..., 1] - velocity[..., 1] * late


def jet(square: Array, dz: Array, air: Numbers) -> Array:
    """Return the downwash of a single jet, N, without its weight, at r^2 = `square` from its axis.

    strength (width / wide)^decay exp(-(r / wide)^2 / 2) s(dz / 3 cm), wide = width + spread dz, in
    N and m: a jet widens and weakens. s is the logistic function: the jet fades above the rotors.
    """
    xp = array_namespace(square)
    wide = air["width"] + air["spread"] * xp.maximum(dz, 0.0)
    below = 0.5 * (1.0 + xp.tanh(0.5 * dz / ONSET))  # s
    thinner = air["decay"] * xp.log(wide / air["width"])  # exp(-thinner) is (width / wide)^decay
    return air["strength"] * xp.exp(-thinner - 0.5 * square / wide**2) * below


def combined_downwash(push: Array, height: Array, air: Numbers) -> Array:
    """Return the downwash of all neighbors, N: (1 - share exp(-h / fading)) (sum_j p_ij^q)^(1/q).

    The exponent q is 1.13 in `wake` and 1.07 in `learned`; q = 1 would be a sum. Since wakes
    overlap, the downwash of two equal jets is 2^(1/q) times that of one, 1.85 or 1.91 instead of 2.
    Near the ground, at height h, a share of the downwash is lost.
    """
    xp, q = array_namespace(push), air["combine"]
    together = root(xp.sum(push**q, axis=-1), q)
    share, fading = air["mitigation"]
    return (1.0 - share * xp.exp(-xp.maximum(height, LOWEST_HEIGHT) / fading)) * together


def wake(position: Array, velocity: Array, air: Numbers, points: Array | None = None) -> Array:
    """Return f_a of the `wake` model, N: jets in closed form, ground effect and drag -c v.

    `points` are the points of the drones at which the force is evaluated; by default their centers.
    """
    xp, points = array_namespace(position), position if points is None else points
    p_j, height = of_others(position, air), points[..., 2]
    offset = p_j - points[..., None, :]
    x, y = axis_offset(offset, of_others(velocity, air), air)
    weight = fade_in_box(p_j - position[..., None, :], air)
    down = combined_downwash(weight * jet(x * x + y * y, offset[..., 2], air), height, air)
    lift = air["lift"] * xp.exp(-xp.maximum(height - LOWEST_HEIGHT, 0.0) / air["cushion"])
    return along_z(lift - down) - air["drag"] * velocity


def network(layers: list[tuple[Array, Array]], x: Array) -> Array:
    """Apply the ReLU network of each drone or pair: (..., N, inputs) or (..., N, N-1, inputs)."""
    xp, own = array_namespace(x), layers[0][0].ndim - 1  # number of axes without those of flights
    rows = xp.reshape(x, (math.prod(x.shape[:-own]), *x.shape[-own:]))
    rows = xp.moveaxis(rows, 0, -2)  # one matrix product for each network, with flights as rows
    for k, (weight, bias) in enumerate(layers):
        rows = xp.matmul(xp.maximum(rows, 0.0) if k else rows, weight) + bias[..., None, :]
    return xp.reshape(xp.moveaxis(rows, -2, 0), (*x.shape[:-1], rows.shape[-1]))


def learned(position: Array, velocity: Array, air: Numbers, points: Array | None = None) -> Array:
    """Return f_a of `learned`: p_ij = weight max(0, jet + n) with a network n, and a lateral force.

    The inputs of n are invariant under rotation about the vertical and reflection: distance r from
    the jet's axis, depth dz, and relative velocity toward the axis, across, and upward.
    """
    xp, at = array_namespace(position), position if points is None else points
    p_j, v_j, (low, high) = of_others(position, air), of_others(velocity, air), air["pair_range"]
    offset, v = p_j - at[..., None, :], v_j - velocity[..., None, :]
    x, y = axis_offset(offset, v_j, air)
    square = x * x + y * y
    per_r = 1.0 / xp.sqrt(
        square + AXIS_RADIUS**2
    )  # (x, y) per_r: unit vector, shorter near the axis
    toward = (x * v[..., 0] + y * v[..., 1]) * per_r
    across = root(xp.maximum(v[..., 0] ** 2 + v[..., 1] ** 2 - toward**2, 0.0))
    r = xp.minimum(root(square), (high[0] ** 2 + high[1] ** 2) ** 0.5)
    dz, rise = xp.clip(offset[..., 2], low[2], high[2]), xp.clip(v[..., 2], low[5], high[5])
    motion = (r, dz, xp.clip(toward, low[3], high[3]), xp.minimum(across, high[3]), rise)
    inputs = [value / unit for value, unit in zip(motion, UNITS_OF_PAIR, strict=True)]
    n = network(air["pair"], xp.stack(inputs, axis=-1))  # downwash, g, and ratio of lateral force

    beside = root(offset[..., 0] ** 2 + offset[..., 1] ** 2)
    weight = fade(beside, *air["sides"]) * fade(xp.abs(offset[..., 2]), *air["depth"])
    if points is not None:  # the centers decide which pairs interact
        weight = xp.where(fade_in_box(p_j - position[..., None, :], air) > 0.0, weight, 0.0)
    push = weight * xp.maximum(jet(r * r, dz, air) + GRAM_FORCE * n[..., 0], 0.0)
    down, total = combined_downwash(push, at[..., 2], air), xp.sum(push, axis=-1)
    share = down / xp.where(total > 0.0, total, 1.0)
    lean = push * xp.clip(n[..., 1], -1.0, 1.0) * per_r
    lateral = [share * xp.sum(lean * x, axis=-1), share * xp.sum(lean * y, axis=-1)]
    lift = ground_effect(at[..., 2], velocity, air)
    return xp.stack([*lateral, lift - down], axis=-1) - air["drag"] * velocity


def ground_effect(height: Array, velocity: Array, air: Numbers) -> Array:
    """Return the lift of a lone drone in `learned`, N: g(z) - g(z_a), 0 above the height z_a."""
    xp, (low, high) = array_namespace(height), air["own_range"]
    speed = xp.minimum(root(velocity[..., 0] ** 2 + velocity[..., 1] ** 2), high[1])
    sinking = xp.clip(-velocity[..., 2], low[3], high[3])

    def g(z: Array) -> Array:
        motion = (xp.clip(-z, low[0], high[0]), speed, sinking)
        inputs = [value / unit for value, unit in zip(motion, UNITS_OF_OWN, strict=True)]
        return GRAM_FORCE * network(air["own"], xp.stack(inputs, axis=-1))[..., 0]

    return g(xp.minimum(height, air["anchor"])) - g(air["anchor"] + 0.0 * height)


def deep_set(position: Array, velocity: Array, air: Numbers, points: Array | None = None) -> Array:
    """Return f_a of `deep-set`, eq. (10): rho(phi_env + sum_j weight phi(x_ij)), anchored.

    Codes phi of neighbors are summed, not forces; rho maps their sum to a force. It is invariant
    under permutations of drones of one type (Theorem 4). The force on a lone drone at the anchor
    height is subtracted.
    """
    xp, points = array_namespace(position), position if points is None else points
    p_j, v = of_others(position, air), of_others(velocity, air) - velocity[..., None, :]
    x_ij = xp.clip(xp.concat([p_j - points[..., None, :], v], axis=-1), *air["pair_range"])
    weight = fade_in_box(p_j - position[..., None, :], air)
    codes = xp.sum(weight[..., None] * network(air["phi"], x_ij), axis=-2)

    def alone(z: Array) -> Array:
        own = xp.concat([-z[..., None], -velocity], axis=-1)
        return network(air["phi_env"], xp.clip(own, *air["own_range"]))

    here = alone(xp.minimum(points[..., 2], air["anchor"]))
    aloft = alone(air["anchor"] + 0.0 * points[..., 2])
    grams = network(air["rho"], here + codes) - network(air["rho"], aloft)
    return along_z(GRAM_FORCE * grams[..., 0]) - air["drag"] * velocity


def still_air(position: Array, velocity: Array, points: Array | None = None) -> Array:
    """Return f_a = 0, the force of the model `none`."""
    return 0.0 * velocity


def aerodynamic_torque(forces: Forces, state: State, body: Parameters) -> Array:
    """Return the aerodynamic torque in the body frame, N m: an assumption, not a measurement.

    Each rotor receives a quarter of the vertical force at its position:
    sum_k r_k x R^T (0, 0, f_z / 4).
    """
    p, q, total = state.position, state.quaternion, 0.0 * state.position
    arm = body.rotor_offset[..., None] + 0.0 * p[..., :1]
    for x, y in ROTORS:
        r_k = array_namespace(p).concat([x * arm, y * arm, 0.0 * arm], axis=-1)
        quarter = forces(p, state.velocity, points=p + rotate(q, r_k))[..., 2] / 4.0
        total = total + cross(r_k, rotate(inverse(q), along_z(quarter)))
    return total


# Contacts
def clearances(position: Array, body: Parameters) -> Array:
    """Return distances (..., N, N) over sums of radii, below 1 for a contact (off the diagonal)."""
    apart = position[..., None, :, :] - position[..., :, None, :]
    return root(dot(apart, apart)) / (body.radius[..., None, :] + body.radius[..., :, None])


def wall_gaps(position: Array, body: Parameters, low: Array, high: Array) -> Array:
    """Return distances (..., N, 6), m, to walls, floor and ceiling, below 0 for a contact."""
    gaps = [position - low - body.radius[..., None], high - position - body.radius[..., None]]
    return array_namespace(position).concat(gaps, axis=-1)


# Tracking controller, Sec. VI; its gains k are those of `gains_of`
def desired_force(
    state: State, setpoint: Setpoint, predicted: Array, body: Parameters, k: Numbers, dt: float
) -> tuple[Array, Array]:
    """Return f_d of eqs. (18) and (19), N, with a least vertical part, and the integral of v~, m.

    v_r leads back to the desired path. The predicted force f^_a is compensated at once; the
    integral slowly compensates the remaining force.
    """
    p_error = state.position - setpoint.position  # p~
    v_r = setpoint.velocity - k["position"] * p_error  # (18)
    v_r_rate = setpoint.acceleration - k["position"] * (state.velocity - setpoint.velocity)
    v_error, limit = state.velocity - v_r, k["velocity_integral_limit"]  # v~
    xp, least = array_namespace(p_error), k["min_vertical_thrust_fraction"]
    integral = xp.clip(state.velocity_integral + v_error * dt, -limit, limit)
    gain, rate = k["velocity"], k["integral"]  # K_v / m, Gamma_v
    acceleration = v_r_rate - (gain + rate) * v_error - gain * rate * integral
    weight = body.mass * GRAVITY
    x, y, z = components(body.mass[..., None] * acceleration + along_z(weight) - predicted)  # (19)
    return xp.stack([x, y, xp.maximum(z, least * weight)], axis=-1), integral


def followed(
    state: State, setpoint: Setpoint, predicted: Array, body: Parameters, k: Numbers, dt: float = DT
) -> tuple[State, tuple[Array, Array, Array]]:
    """Return the new state of the position and attitude loops; commanded thrust, w_r and w_r'."""
    xp, q = array_namespace(state.position), state.quaternion
    f_d, integral = desired_force(state, setpoint, predicted, body, k, dt)
    # T_d = f_d . R e_z. Delay compensation, eq. (22): rotors lag by 1 / lambda, (1c), so that
    # T_d + T_d' / lambda is commanded. T_d' is low-passed, since differences amplify noise.
    thrust = dot(f_d, rotate(q, along_z(1.0 + 0.0 * f_d[..., 2])))
    change = (thrust - state.thrust) / dt - state.thrust_rate
    thrust_rate = state.thrust_rate + k["thrust_rate_blend"] * state.started * change  # low-passed
    commanded = thrust + k["lead"] / body.motor_rate * thrust_rate

    # R_d is the yaw about the vertical, followed by the shortest rotation of the vertical to f_d.
    length = root(dot(f_d, f_d))
    half_cos = xp.sqrt(0.5 * (1.0 + f_d[..., 2] / length))
    scale = 0.5 / (half_cos * length)
    tilt = xp.stack([-f_d[..., 1] * scale, f_d[..., 0] * scale, 0.0 * scale, half_cos], axis=-1)
    change = 2.0 * from_to(state.tilt, tilt)[..., :3] / dt - state.tilt_rate
    tilt_rate = state.tilt_rate + k["desired_rate_blend"] * state.started[..., None] * change
    yaw = turn_by(along_z(setpoint.yaw))
    w_d = rotate(inverse(yaw), tilt_rate) + along_z(setpoint.yaw_rate)

    error = from_to(multiply(tilt, yaw), q)  # q~, of R~ = R_d^T R
    vector, fed = error[..., :3], rotate(inverse(error), w_d)
    w_r = fed - k["attitude"] * vector  # (20)
    # Only the error is differentiated; the derivative of w_d would need a third derivative of v.
    relative = rotate(inverse(q), state.angular_velocity) - fed
    w_r_rate = -0.5 * k["attitude"] * (error[..., 3:] * relative + cross(vector, relative))
    memory = (integral, thrust, thrust_rate, tilt, tilt_rate)
    return State(*state[:5], *memory, *state[10:]), (commanded, w_r, w_r_rate)


def held(
    state: State, commanded: tuple[Array, ...], body: Parameters, k: Numbers, dt: float = DT
) -> tuple[State, Array]:
    """Return the new state and rotor commands u_c, N, of the rate loop (21), with lead (22)."""
    thrust, w_r, w_r_rate = commanded
    w, limit = rotate(inverse(state.quaternion), state.angular_velocity), k["rate_integral_limit"]
    error = w - w_r  # w~
    change = (error - state.rate_error) / dt - state.rate_error_rate
    rate = state.rate_error_rate + k["rate_error_blend"] * state.started[..., None] * change
    integral = array_namespace(w).clip(state.rate_integral + error * dt, -limit, limit)
    ahead = error + k["lead"] / body.motor_rate[..., None] * rate  # (22)
    acceleration = w_r_rate - k["rate"] * ahead - k["rate_integral"] * integral
    torque = body.inertia * acceleration - cross(body.inertia * w, w_r)  # (21)
    memory = (error, rate, integral, 1.0 + 0.0 * state.started)
    return State(*state[:10], *memory), mixed(thrust, torque, body)


def mixed(thrust: Array, torque: Array, body: Parameters) -> Array:
    """Return rotor thrusts u_c = B_0^-1 (T, tau), N; beyond the limits, reduce yaw, then thrust.

    Roll and pitch are only scaled down, both by one factor, if they alone exceed the limits.
    """
    xp, most, (x, y, z) = array_namespace(thrust), body.max_rotor_thrust, components(torque)
    diagonal_1 = -0.25 * (x + y) / body.rotor_offset  # added to rotor 1, taken from rotor 3
    diagonal_2 = 0.25 * (y - x) / body.rotor_offset  # rotors 2 and 4
    largest = xp.maximum(xp.abs(diagonal_1), xp.abs(diagonal_2))
    scale = xp.minimum(0.5 * most / xp.maximum(largest, 1e-30), 1.0)
    diagonal_1, diagonal_2, largest = scale * diagonal_1, scale * diagonal_2, scale * largest
    yaw = z / (4.0 * body.thrust_to_torque)  # taken from one diagonal, given to the other
    losing = xp.abs(xp.where(yaw < 0.0, diagonal_2, diagonal_1))
    gaining = xp.abs(xp.where(yaw < 0.0, diagonal_1, diagonal_2))
    lowest = largest - xp.clip(0.5 * (gaining - losing), 0.0, xp.abs(yaw))
    highest = most - largest + xp.clip(0.5 * (losing - gaining), 0.0, xp.abs(yaw))
    base = xp.clip(0.25 * thrust, lowest, highest)
    room = xp.maximum(xp.minimum(base - losing, most - gaining - base), 0.0)
    yaw = xp.clip(yaw, -room, room)
    front_right, back_left = base + diagonal_1 - yaw, base - diagonal_1 - yaw
    back_right, front_left = base + diagonal_2 + yaw, base - diagonal_2 + yaw
    rotors = xp.stack([front_right, back_right, back_left, front_left], axis=-1)
    return xp.clip(rotors, 0.0, most[..., None])


# One step of everything
def step(
    state: State,
    setpoint: Setpoint,
    body: Parameters,
    gains: Numbers,
    forces: Forces = still_air,
    predicted: Forces = still_air,
    dt: float = DT,
) -> State:
    """Return the state after dt: controller, aerodynamic forces, rotors and bodies.

    `forces` are the aerodynamic forces f_a; `predicted` those that the controller compensates,
    f^_a. The aerodynamic torque is 0; otherwise call `moved` with that of `aerodynamic_torque`.
    """
    predicted_force = predicted(state.position, state.velocity)
    memory, commanded = followed(state, setpoint, predicted_force, body, gains, dt)
    memory, command = held(memory, commanded, body, gains, dt)
    force = forces(state.position, state.velocity)
    return moved(memory, command, force, 0.0 * force, body, dt)


def moved_on(setpoint: Setpoint, dt: float = DT) -> Setpoint:
    """Return set-points a step later: they are extrapolated by their derivatives."""
    p, v, a, j, yaw, yaw_rate = setpoint
    p, v = p + dt * (v + dt * (a / 2.0 + dt * j / 6.0)), v + dt * (a + dt * j / 2.0)
    return Setpoint(p, v, a + dt * j, j, yaw + dt * yaw_rate, yaw_rate)


def hovering(position: Array, body: Parameters) -> State:
    """Return the state of drones at rest at positions (..., N, 3), m, at the start of a flight."""
    xp, zero = array_namespace(position), 0.0 * position
    level, none = xp.concat([zero, 1.0 + zero[..., :1]], axis=-1), zero[..., 0]
    hover = (body.mass * GRAVITY / 4.0)[..., None] + 0.0 * level
    memory = (zero, none, none, level, zero, zero, zero, zero, none)
    return State(position, zero, level, zero, hover, *memory)
