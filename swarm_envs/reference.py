"""The equations of the simulator, to be read, differentiated and compiled: NumPy, torch, JAX.

The tests hold both engines to this file, to 1e-9. Equation numbers, and most symbols, are those of
Neural-Swarm2 (version 1):

    p, v    position and velocity, m, m/s, in the world: x and y horizontal, z up
    R, q    attitude, from the body to the world: the rotation, and its quaternion (x, y, z, w)
    w       angular velocity (omega), rad/s, in the world frame; in `held` in the body frame
    u, u_c  thrust of each rotor, and what it is commanded to give, N
    T, tau  thrust of all rotors, N, and their torque, N m, in the body frame
    lambda  motor rate, 1/s: rotors respond late by 1/lambda, 62.5 ms at 16 1/s
    f_a     force of the air on a drone apart from its thrust: downwash, ground effect, drag; N
    p_ij    push down on drone i by the jet of drone j, N, at depth dz and distance r from its axis
    x_d, x_r, x~, x'  desired, reference, error (actual minus desired), derivative; f^: predicted

Arrays are (..., N, 3) for N drones; leading axes count independent flights. Numbers of vehicles,
air and controller are arguments, see `swarm_envs.reference_numbers`. Nothing is changed in place,
and no value decides which line runs, so that gradients go through a flight, and it compiles whole:

    body, air, gains = bodies_of("LS"), air_of("learned", "LS"), gains_of()
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
ROTORS = ((1, -1), (-1, -1), (-1, 1), (1, 1))  # places 1 to 4, in rotor offsets: x forward, y left


class State(NamedTuple):
    """The state passed between steps: the drones, then the memory of their controllers."""

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
    started: Array  # 0 before the first step, then 1 (..., N): at first there is no last step


# Vectors and quaternions: nothing of drones yet
def along_z(length: Array) -> Array:
    """Return the vectors (0, 0, length)."""
    return array_namespace(length).stack([0.0 * length, 0.0 * length, length], axis=-1)


def components(a: Array) -> tuple[Array, ...]:
    """Return the numbers of vectors or quaternions, each as an array."""
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
    """Return the rotation back."""
    return array_namespace(q).concat([-q[..., :3], q[..., 3:]], axis=-1)


def rotate(q: Array, a: Array) -> Array:
    """Return R a: a vector of the body, in the world frame."""
    twice = 2.0 * cross(q[..., :3], a)
    return a + q[..., 3:] * twice + cross(q[..., :3], twice)


def turn_by(angle: Array) -> Array:
    """Return the quaternion of a turn about the axis `angle` by the angle of its length, rad."""
    xp, half = array_namespace(angle), 0.5 * root(dot(angle, angle))
    sinc = xp.where(half > 0.0, xp.sin(half) / xp.where(half > 0.0, half, 1.0), 1.0)
    return xp.concat([(0.5 * sinc)[..., None] * angle, xp.cos(half)[..., None]], axis=-1)


def from_to(a: Array, b: Array) -> Array:
    """Return the shortest rotation from attitude a to b: a^-1 b, its scalar not negative."""
    q = multiply(inverse(a), b)
    return array_namespace(q).where(q[..., 3:] < 0.0, -q, q)


# Rotors and bodies, eq. (1)
def lagged(thrust: Array, command: Array, body: Parameters, dt: float = DT) -> Array:
    """Return rotor thrusts after dt, eq. (1c): u' = lambda (u_c - u), solved exactly."""
    xp = array_namespace(thrust)
    reachable = xp.clip(command, 0.0, body.max_rotor_thrust[..., None])
    return reachable + (thrust - reachable) * xp.exp(-body.motor_rate * dt)[..., None]


def wrench(rotors: Array, body: Parameters) -> tuple[Array, Array]:
    """Return thrust and torque of the rotors, (T, tau) = B_0 u; tau = sum r_k x (0, 0, u_k)."""
    u1, u2, u3, u4 = components(rotors)
    arm, yaw = body.rotor_offset, body.thrust_to_torque
    tau = [arm * (-u1 - u2 + u3 + u4), arm * (-u1 + u2 + u3 - u4), yaw * (-u1 + u2 - u3 + u4)]
    return u1 + u2 + u3 + u4, array_namespace(rotors).stack(tau, axis=-1)


def turned(q: Array, w: Array, tau: Array, inertia: Array, dt: float) -> tuple[Array, Array]:
    """Turn bodies by eq. (1b), J w' = J w x w + tau in the body frame, as both engines do.

    Semi-implicit: first the angular velocity, by the torque as it was, then the attitude by the new
    angular velocity. A free spin gains energy by that; in `turned_exactly` it does not.
    """
    w_b = rotate(inverse(q), w)
    w = rotate(q, w_b + dt * (tau - cross(w_b, inertia * w_b)) / inertia)
    q = multiply(turn_by(w * dt), q)
    return q / root(dot(q, q))[..., None], w


def turned_exactly(q: Array, w: Array, tau: Array, inertia: Array, dt: float) -> Any:
    """Turn bodies so that their angular momentum R J R^T w changes by the torque alone.

    The attitude turns by the angular velocity of the middle of the step. No engine does this.
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
    """Move rotors, then bodies: eqs. (1c), (1b), and (1a), m v' = m g + R (0, 0, T) + f_a.

    `force` is f_a, `torque` the air's, in the body frame. Semi-implicit: p follows the new v.
    """
    rotors = lagged(state.rotor_thrust, command, body, dt)
    thrust, tau = wrench(rotors, body)
    push = rotate(state.quaternion, along_z(thrust)) + force
    v = state.velocity + dt * (push / body.mass[..., None] - along_z(GRAVITY + 0.0 * thrust))
    q, w = turned(state.quaternion, state.angular_velocity, tau + torque, body.inertia, dt)
    return State(state.position + dt * v, v, q, w, rotors, *state[5:])


# Forces of the air f_a. Arrays of pairs are (..., N, N-1): row i feels, column j is another drone
def of_others(x: Array, air: Numbers) -> Array:
    """Return positions or velocities of all others for each drone: (..., N, N-1, 3)."""
    xp, shape = array_namespace(x), (*x.shape[:-1], x.shape[-2] - 1, x.shape[-1])
    return xp.reshape(xp.take(x, air["others"], axis=-2), shape)


def fade(distance: Array, full: float, end: float) -> Array:
    """Weight by a distance, m: 1 up to `full`, 0 from `end` on, and no kink between."""
    xp = array_namespace(distance)
    u = xp.clip((distance - full) / max(end - full, 1e-12), 0.0, 1.0)
    return xp.maximum(1.0 - u * u * u * (10.0 + u * (6.0 * u - 15.0)), 0.0)  # rounding at the end


def fade_in_box(offset: Array, air: Numbers) -> Array:
    """Weight w_ij of a pair in the interaction volume, along x, y and z."""
    x, y, z = components(array_namespace(offset).abs(offset))
    return fade(x, *air["sides"]) * fade(y, *air["sides"]) * fade(z, *air["depth"])


def way_to_axis(offset: Array, velocity: Array, air: Numbers) -> tuple[Array, Array]:
    """Return the horizontal offset, m, from drone i to the axis of j's jet, which trails behind j.

    The air at depth dz under j has left it `delay` (s/m) times dz ago, from where j was then.
    """
    late = air["delay"] * array_namespace(offset).maximum(offset[..., 2], 0.0)
    return offset[..., 0] - velocity[..., 0] * late, offset[..., 1] - velocity[..., 1] * late


def jet(square: Array, dz: Array, air: Numbers) -> Array:
    """Return the push of one jet alone, N, before its weight, at r^2 = `square` from its axis.

    strength (width / wide)^decay exp(-(r / wide)^2 / 2) s(dz / 3 cm), wide = width + spread dz, in
    N and m: a jet widens and weakens. s is the logistic function, so it fades above the rotors.
    """
    xp = array_namespace(square)
    wide = air["width"] + air["spread"] * xp.maximum(dz, 0.0)
    below = 0.5 * (1.0 + xp.tanh(0.5 * dz / ONSET))  # s
    thinner = air["decay"] * xp.log(wide / air["width"])  # exp(-thinner) is (width / wide)^decay
    return air["strength"] * xp.exp(-thinner - 0.5 * square / wide**2) * below


def added_up(push: Array, height: Array, air: Numbers) -> Array:
    """Return the downwash of all neighbours, N: (1 - share exp(-h / fading)) (sum_j p_ij^q)^(1/q).

    The exponent q is 1.13 in `wake`, 1.07 in `learned` (with 1 it would be a sum): two equal jets
    push 2^(1/q) times as hard as one, 1.85 or 1.91 and not 2, as their wakes overlap. One jet
    pushes by p_ij whatever q is. Near the ground, at height h, a share of all is lost.
    """
    xp, q = array_namespace(push), air["combine"]
    together = root(xp.sum(push**q, axis=-1), q)
    share, fading = air["mitigation"]
    return (1.0 - share * xp.exp(-xp.maximum(height, LOWEST_HEIGHT) / fading)) * together


def wake(position: Array, velocity: Array, air: Numbers, felt: Array | None = None) -> Array:
    """Return f_a of the `wake` model, N: jets in closed form, ground effect and drag -c v.

    `felt`: where the force is felt, if not at the centres of drones; alike in all force models.
    """
    xp, felt = array_namespace(position), position if felt is None else felt
    p_j, height = of_others(position, air), felt[..., 2]
    offset = p_j - felt[..., None, :]
    x, y = way_to_axis(offset, of_others(velocity, air), air)
    weight = fade_in_box(p_j - position[..., None, :], air)
    down = added_up(weight * jet(x * x + y * y, offset[..., 2], air), height, air)
    lift = air["lift"] * xp.exp(-xp.maximum(height - LOWEST_HEIGHT, 0.0) / air["cushion"])
    return along_z(lift - down) - air["drag"] * velocity


def network(layers: list[tuple[Array, Array]], x: Array) -> Array:
    """Apply ReLU networks, each drone or pair its own: (..., N, inputs), (..., N, N-1, inputs)."""
    xp, own = array_namespace(x), layers[0][0].ndim - 1  # number of axes not of flights
    rows = xp.reshape(x, (math.prod(x.shape[:-own]), *x.shape[-own:]))
    rows = xp.moveaxis(rows, 0, -2)  # flights are rows of one matrix product for each network
    for k, (weight, bias) in enumerate(layers):
        rows = xp.matmul(xp.maximum(rows, 0.0) if k else rows, weight) + bias[..., None, :]
    return xp.reshape(xp.moveaxis(rows, -2, 0), (*x.shape[:-1], rows.shape[-1]))


def learned(position: Array, velocity: Array, air: Numbers, felt: Array | None = None) -> Array:
    """Return f_a of `learned`: p_ij = weight max(0, jet + n) with a network n, and a lean aside.

    Inputs of n stay the same when the swarm is turned about the vertical or mirrored: distance r
    from the jet's axis, depth dz, relative velocity along the way to the axis, across, and upwards.
    """
    xp, at = array_namespace(position), position if felt is None else felt
    p_j, v_j, (low, high) = of_others(position, air), of_others(velocity, air), air["pair_range"]
    offset, v = p_j - at[..., None, :], v_j - velocity[..., None, :]
    x, y = way_to_axis(offset, v_j, air)
    square = x * x + y * y
    way = 1.0 / xp.sqrt(square + AXIS_RADIUS**2)  # (x, y) way leads to the axis, by 1, less near it
    towards = (x * v[..., 0] + y * v[..., 1]) * way
    across = root(xp.maximum(v[..., 0] ** 2 + v[..., 1] ** 2 - towards**2, 0.0))
    r = xp.minimum(root(square), (high[0] ** 2 + high[1] ** 2) ** 0.5)
    dz, rise = xp.clip(offset[..., 2], low[2], high[2]), xp.clip(v[..., 2], low[5], high[5])
    motion = (r, dz, xp.clip(towards, low[3], high[3]), xp.minimum(across, high[3]), rise)
    inputs = [value / unit for value, unit in zip(motion, UNITS_OF_PAIR, strict=True)]
    n = network(air["pair"], xp.stack(inputs, axis=-1))  # a push, g, and its lean to the axis

    beside = root(offset[..., 0] ** 2 + offset[..., 1] ** 2)
    weight = fade(beside, *air["sides"]) * fade(xp.abs(offset[..., 2]), *air["depth"])
    if felt is not None:  # the distance of centres decides which are near
        weight = xp.where(fade_in_box(p_j - position[..., None, :], air) > 0.0, weight, 0.0)
    push = weight * xp.maximum(jet(r * r, dz, air) + GRAM_FORCE * n[..., 0], 0.0)
    down, total = added_up(push, at[..., 2], air), xp.sum(push, axis=-1)
    share = down / xp.where(total > 0.0, total, 1.0)
    lean = push * xp.clip(n[..., 1], -1.0, 1.0) * way
    aside = [share * xp.sum(lean * x, axis=-1), share * xp.sum(lean * y, axis=-1)]
    lift = ground_effect(at[..., 2], velocity, air)
    return xp.stack([*aside, lift - down], axis=-1) - air["drag"] * velocity


def ground_effect(height: Array, velocity: Array, air: Numbers) -> Array:
    """Return the lift of a lone drone in `learned`, N: g(z) - g(z_a), none above the height z_a."""
    xp, (low, high) = array_namespace(height), air["own_range"]
    speed = xp.minimum(root(velocity[..., 0] ** 2 + velocity[..., 1] ** 2), high[1])
    sinking = xp.clip(-velocity[..., 2], low[3], high[3])

    def g(z: Array) -> Array:
        motion = (xp.clip(-z, low[0], high[0]), speed, sinking)
        inputs = [value / unit for value, unit in zip(motion, UNITS_OF_OWN, strict=True)]
        return GRAM_FORCE * network(air["own"], xp.stack(inputs, axis=-1))[..., 0]

    return g(xp.minimum(height, air["anchor"])) - g(air["anchor"] + 0.0 * height)


def deep_set(position: Array, velocity: Array, air: Numbers, felt: Array | None = None) -> Array:
    """Return f_a of `deep-set`, eq. (10): rho(phi_env + sum_j weight phi(x_ij)), 0 alone aloft.

    Neighbours are added up as codes, not as forces: rho has learned what several do together. A sum
    knows no order, so drones of one type may change places (Theorem 4).
    """
    xp, felt = array_namespace(position), position if felt is None else felt
    p_j, v = of_others(position, air), of_others(velocity, air) - velocity[..., None, :]
    x_ij = xp.clip(xp.concat([p_j - felt[..., None, :], v], axis=-1), *air["pair_range"])
    weight = fade_in_box(p_j - position[..., None, :], air)
    codes = xp.sum(weight[..., None] * network(air["phi"], x_ij), axis=-2)

    def alone(z: Array) -> Array:
        own = xp.concat([-z[..., None], -velocity], axis=-1)
        return network(air["phi_env"], xp.clip(own, *air["own_range"]))

    here = alone(xp.minimum(felt[..., 2], air["anchor"]))
    aloft = alone(air["anchor"] + 0.0 * felt[..., 2])
    grams = network(air["rho"], here + codes) - network(air["rho"], aloft)
    return along_z(GRAM_FORCE * grams[..., 0]) - air["drag"] * velocity


def still_air(position: Array, velocity: Array, felt: Array | None = None) -> Array:
    """Return f_a = 0, of the model `none`."""
    return 0.0 * velocity


def air_torque(forces: Forces, state: State, body: Parameters) -> Array:
    """Return the torque of the air in the body frame, N m: an assumption, not a measurement.

    Each rotor feels a quarter of the vertical force at its place: sum_k r_k x R^T (0, 0, f_z / 4).
    """
    p, q, total = state.position, state.quaternion, 0.0 * state.position
    arm = body.rotor_offset[..., None] + 0.0 * p[..., :1]
    for x, y in ROTORS:
        r_k = array_namespace(p).concat([x * arm, y * arm, 0.0 * arm], axis=-1)
        quarter = forces(p, state.velocity, felt=p + rotate(q, r_k))[..., 2] / 4.0
        total = total + cross(r_k, rotate(inverse(q), along_z(quarter)))
    return total


# Contacts
def clearances(position: Array, body: Parameters) -> Array:
    """Return distances (..., N, N) over sums of radii: below 1 a pair touches, diagonal aside."""
    apart = position[..., None, :, :] - position[..., :, None, :]
    return root(dot(apart, apart)) / (body.radius[..., None, :] + body.radius[..., :, None])


def wall_gaps(position: Array, body: Parameters, low: Array, high: Array) -> Array:
    """Return distances (..., N, 6), m, to walls, floor and ceiling: below 0 a drone touches."""
    gaps = [position - low - body.radius[..., None], high - position - body.radius[..., None]]
    return array_namespace(position).concat(gaps, axis=-1)


# Tracking controller, Sec. VI; its gains k are those of `gains_of`
def desired_force(
    state: State, setpoint: Setpoint, predicted: Array, body: Parameters, k: Numbers, dt: float
) -> tuple[Array, Array]:
    """Return f_d of eqs. (18) and (19), N, with a least vertical part, and the integral of v~, m.

    v_r leads back to the desired path, the faster the farther. A force that a model predicts, f^_a,
    is compensated at once; the integral slowly finds the rest.
    """
    p_error = state.position - setpoint.position  # p~
    v_r = setpoint.velocity - k["position"] * p_error  # (18)
    v_r_rate = setpoint.acceleration - k["position"] * (state.velocity - setpoint.velocity)
    v_error, limit = state.velocity - v_r, k["velocity_integral_limit"]  # v~
    xp, least = array_namespace(p_error), k["min_vertical_thrust_fraction"]
    integral = xp.clip(state.velocity_integral + v_error * dt, -limit, limit)
    gain, rate = k["velocity"], k["integral"]  # K_v / m, Gamma_v
    wanted = v_r_rate - (gain + rate) * v_error - gain * rate * integral
    weight = body.mass * GRAVITY
    x, y, z = components(body.mass[..., None] * wanted + along_z(weight) - predicted)  # (19)
    return xp.stack([x, y, xp.maximum(z, least * weight)], axis=-1), integral


def followed(
    state: State, setpoint: Setpoint, predicted: Array, body: Parameters, k: Numbers, dt: float = DT
) -> tuple[State, tuple[Array, Array, Array]]:
    """Return the new memory of the position and attitude loops; commanded thrust, w_r and w_r'."""
    xp, q = array_namespace(state.position), state.quaternion
    f_d, integral = desired_force(state, setpoint, predicted, body, k, dt)
    # T_d = f_d . R e_z. Delay compensation, eq. (22): rotors respond late by 1 / lambda, (1c), so
    # T_d + T_d' / lambda is commanded. T_d' is low-passed, as a difference amplifies noise.
    thrust = dot(f_d, rotate(q, along_z(1.0 + 0.0 * f_d[..., 2])))
    change = (thrust - state.thrust) / dt - state.thrust_rate
    thrust_rate = state.thrust_rate + k["thrust_rate_blend"] * state.started * change  # low-passed
    asked = thrust + k["lead"] / body.motor_rate * thrust_rate

    # R_d is the shortest turn of the vertical to f_d, after the yaw about the vertical.
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
    # Only the error is differentiated, not w_d, which would need a third derivative of v.
    relative = rotate(inverse(q), state.angular_velocity) - fed
    w_r_rate = -0.5 * k["attitude"] * (error[..., 3:] * relative + cross(vector, relative))
    memory = (integral, thrust, thrust_rate, tilt, tilt_rate)
    return State(*state[:5], *memory, *state[10:]), (asked, w_r, w_r_rate)


def held(
    state: State, asked: tuple[Array, Array, Array], body: Parameters, k: Numbers, dt: float = DT
) -> tuple[State, Array]:
    """Return the memory and rotor commands u_c, N, of the rate loop (21), ahead of the lag (22)."""
    thrust, w_r, w_r_rate = asked
    w, limit = rotate(inverse(state.quaternion), state.angular_velocity), k["rate_integral_limit"]
    error = w - w_r  # w~
    change = (error - state.rate_error) / dt - state.rate_error_rate
    rate = state.rate_error_rate + k["rate_error_blend"] * state.started[..., None] * change
    integral = array_namespace(w).clip(state.rate_integral + error * dt, -limit, limit)
    ahead = error + k["lead"] / body.motor_rate[..., None] * rate  # (22)
    wanted = w_r_rate - k["rate"] * ahead - k["rate_integral"] * integral
    torque = body.inertia * wanted - cross(body.inertia * w, w_r)  # (21)
    memory = (error, rate, integral, 1.0 + 0.0 * state.started)
    return State(*state[:10], *memory), mixed(thrust, torque, body)


def mixed(thrust: Array, torque: Array, body: Parameters) -> Array:
    """u_c = B_0^-1 (T, tau) where the rotors can; else yaw is given up first, then thrust.

    Only where roll and pitch alone ask for more than there is are they made smaller, both alike.
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
    """Return the state after dt: the controller reads it, the air pushes, rotors and bodies move.

    `forces` are those of the air, f_a; `predicted` those that the controller compensates, f^_a.
    The air turns no bodies here: for that, call `moved` with the torque of `air_torque`.
    """
    believed = predicted(state.position, state.velocity)
    memory, asked = followed(state, setpoint, believed, body, gains, dt)
    memory, command = held(memory, asked, body, gains, dt)
    force = forces(state.position, state.velocity)
    return moved(memory, command, force, 0.0 * force, body, dt)


def moved_on(setpoint: Setpoint, dt: float = DT) -> Setpoint:
    """Return set-points a step later: each goes on by its derivatives, the jerk stays."""
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
