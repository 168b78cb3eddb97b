"""Adaptation of the tracking controller: estimation of unmodeled forces.

At each step of 1/240 s, `adapt` compares the change of the velocity with that expected from nominal
motors, nominal mass and feed-forward. The residual contains errors of the force model, of mass and
thrust, and noise. From it, one of three estimators computes `adaptive_force`, which `track`
compensates in addition to the feed-forward. They use only information that a drone has: its state
estimate, its commands, its nominal mass and motor lag; not the true force.

- Momentum observer (`MomentumObserver`): a first-order low-pass of the residual. De Luca and
  Mattone (ICRA 2003) for robot arms, Tomic et al. (IEEE Trans. Robotics 33(6), 2017) for
  multirotors.
- Incremental inversion (`Indi`): a second-order Butterworth filter. Smeur et al. (Control
  Engineering Practice 73, 2018), Tal and Karaman (IEEE Trans. Control Systems Technology 29(3),
  2021); with a learned feed-forward, Cobo-Briesewitz et al. (L4DC 2026, the hybrid method).
- Neural-Fly (`NeuralFly`): coefficients of a fitted basis, by composite adaptation. O'Connell et
  al. (Science Robotics 7(66), 2022).
"""

from __future__ import annotations

from swarm_envs.compiled import equation, part
from swarm_envs.control.config import LAST_LAYER
from swarm_envs.control.loop import four, seen_state
from swarm_envs.tables import LANES, Record, Records
from swarm_envs.vehicles import GRAVITY


@part
def adapt(blocks: Records, count: int, settings: Records, hall: bool | None = None) -> None:
    """Write `adaptive_force` of the first `count` blocks, for one step.

    Blocks have the state or its estimate, the present feed-forward force, and the commands of the
    last step. `hall` is True in the world "hall", else None.
    """
    find_residual(blocks, count, settings, hall)
    filter_residual(blocks, count, settings)
    if settings[0].adaptation == LAST_LAYER:
        learn_last_layer(blocks, count, settings, hall)


@part
def find_residual(blocks: Records, count: int, settings: Records, hall: bool | None = None) -> None:
    """Write `residual`, m (dv/dt + g) - T z - f_hat over the last step, N; 0 in the first one.

    The acceleration is the difference of the velocities. T is the thrust of nominal motors with
    their lag (eq. 1c), and z its direction at the last commands. The present velocity and
    feed-forward are stored for the next step; those of the last step are copied to `old_velocity`
    and `old_feedforward`.
    """
    per_step = 1.0 / settings[0].step
    for n in range(count):
        b = blocks[n]
        _, velocity, attitude, _ = seen_state(b, hall)
        for lane in range(LANES):
            mass, started = b.nominal_mass[lane], b.started[lane]
            x, y, z, w = four(attitude, lane)
            command = 0.0
            for r in range(4):
                command += b.commands[r, lane]
            lag = started * (b.nominal_thrust[lane] - command)
            thrust = command + b.nominal_motor_decay[lane] * lag
            b.nominal_thrust[lane] = thrust
            for k in range(3):
                v, old_v, old_f = (
                    velocity[k, lane],
                    b.last_velocity[k, lane],
                    b.last_feedforward[k, lane],
                )
                known = thrust * b.last_thrust_axis[k, lane] + old_f
                b.residual[k, lane] = started * (mass * (v - old_v) * per_step - known)
                b.old_velocity[k, lane], b.last_velocity[k, lane] = old_v, v
                b.old_feedforward[k, lane] = old_f
                b.last_feedforward[k, lane] = b.feedforward_force[k, lane]
            b.residual[2, lane] += started * mass * GRAVITY
            b.last_thrust_axis[0, lane] = 2.0 * (x * z + w * y)
            b.last_thrust_axis[1, lane] = 2.0 * (y * z - w * x)
            b.last_thrust_axis[2, lane] = 1.0 - 2.0 * (x * x + y * y)


@equation
def within_weight(force: float, mass: float) -> float:
    """Return a force along one axis, N, clipped to the weight of a mass, kg.

    Jumps of the state estimate thereby cannot flip a drone. Rotors with a thrust-to-weight ratio of
    1.9 could not compensate more.
    """
    weight = mass * GRAVITY
    return min(max(force, -weight), weight)


@part
def filter_residual(blocks: Records, count: int, settings: Records) -> None:
    """Low-pass the residual r, which gives the force f of the momentum observer and of INDI.

    Over a step, f - r <- a (f - r) + b f' and f' <- c (f - r) + d f', which is exact for a
    second-order low-pass. For a first-order one, a = exp(-w dt) and b = c = d = 0: this is the
    momentum observer f = w (m v - integral of (T z - m g + f_hat + f)) for forces that are constant
    in a step.
    """
    low_pass = settings[0].residual_filter
    a, b_rate, c, d = low_pass[0], low_pass[1], low_pass[2], low_pass[3]
    for n in range(count):
        b = blocks[n]
        for lane in range(LANES):
            mass = b.nominal_mass[lane]
            for k in range(3):
                residual, rate = b.residual[k, lane], b.filtered_residual_rate[k, lane]
                off = b.filtered_residual[k, lane] - residual
                force = within_weight(residual + a * off + b_rate * rate, mass)
                b.filtered_residual[k, lane] = b.adaptive_force[k, lane] = force
                b.filtered_residual_rate[k, lane] = c * off + d * rate


@part
def learn_last_layer(
    blocks: Records, count: int, settings: Records, hall: bool | None = None
) -> None:
    """Update the coefficients of Neural-Fly in each axis; see `learn_axis`."""
    s = settings[0]
    rates = s.step, s.position_gain, s.adaptive_kept, s.adaptive_noise
    drift = s.adaptive_drift[0], s.adaptive_drift[1], s.adaptive_drift[2]
    for n in range(count):
        b = blocks[n]
        position, velocity, _, _ = seen_state(b, hall)
        for lane in range(LANES):  # three calls, since LLVM does not unroll such a loop over axes
            learn_axis(b, 0, lane, position, velocity, rates, drift)
            learn_axis(b, 1, lane, position, velocity, rates, drift)
            learn_axis(b, 2, lane, position, velocity, rates, drift)


@equation
def learn_axis(
    b: Record,
    k: int,
    lane: int,
    position: Record,
    velocity: Record,
    rates: tuple[float, float, float, float],
    drift: tuple[float, float, float],
) -> None:
    """Update the coefficients a of a basis phi along one axis, by prediction and tracking errors.

    phi = (f_hat / m, v, 1): the prediction of the force model, drag, and a constant; phi a is an
    acceleration. With the filtered residual acceleration y and the velocity error s = v - v_r,

        da/dt = -l a - P phi R^-1 (phi a - y) + P phi s,   dP/dt = -2 l P + Q - P phi R^-1 phi P.

    All terms except P phi s are computed as prediction and correction of a Kalman filter over the
    step, which is stable for any covariance; there phi is that of the step in which y was measured.
    """
    step, kp, kept, noise = rates
    mass, per_mass = b.nominal_mass[lane], 1.0 / b.nominal_mass[lane]
    a, c, square = b.adaptive_coefficients, b.adaptive_covariance, kept * kept
    p00 = square * c[k, 0, lane] + drift[0]
    p01, p02 = square * c[k, 1, lane], square * c[k, 2, lane]
    p11 = square * c[k, 3, lane] + drift[1]
    p12 = square * c[k, 4, lane]
    p22 = square * c[k, 5, lane] + drift[2]

    x, y = per_mass * b.old_feedforward[k, lane], b.old_velocity[k, lane]
    g0, g1, g2 = p00 * x + p01 * y + p02, p01 * x + p11 * y + p12, p02 * x + p12 * y + p22
    per_variance = 1.0 / (noise + x * g0 + y * g1 + g2)
    a0, a1, a2 = kept * a[k, 0, lane], kept * a[k, 1, lane], kept * a[k, 2, lane]
    error = per_mass * b.filtered_residual[k, lane] - (x * a0 + y * a1 + a2)
    scaled = b.started[lane] * error * per_variance
    a0, a1, a2 = a0 + g0 * scaled, a1 + g1 * scaled, a2 + g2 * scaled
    h0, h1, h2 = g0 * per_variance, g1 * per_variance, g2 * per_variance
    p00, p01, p02 = p00 - g0 * h0, p01 - g0 * h1, p02 - g0 * h2
    p11, p12, p22 = p11 - g1 * h1, p12 - g1 * h2, p22 - g2 * h2

    x, y = per_mass * b.feedforward_force[k, lane], velocity[k, lane]
    g0, g1, g2 = p00 * x + p01 * y + p02, p01 * x + p11 * y + p12, p02 * x + p12 * y + p22
    v_d, p_d = b.setpoint_velocity[k, lane], b.setpoint_position[k, lane]
    moved = step * (y - (v_d - kp * (position[k, lane] - p_d)))
    a0, a1, a2 = a0 + g0 * moved, a1 + g1 * moved, a2 + g2 * moved
    a[k, 0, lane], a[k, 1, lane], a[k, 2, lane] = a0, a1, a2
    c[k, 0, lane], c[k, 1, lane], c[k, 2, lane] = p00, p01, p02
    c[k, 3, lane], c[k, 4, lane], c[k, 5, lane] = p11, p12, p22
    b.adaptive_force[k, lane] = within_weight(mass * (x * a0 + y * a1 + a2), mass)
