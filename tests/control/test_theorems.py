"""Theorems 4, 6 and 7 of Neural-Swarm2, and its Example 2, against their proofs and the loop."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from swarm_envs.control.config import GAINS, ControllerConfig
from swarm_envs.control.tracking import TrackingController
from swarm_envs.physics import BatchPhysics
from swarm_envs.state import Setpoint, hover_state
from swarm_envs.vehicles import LARGE, SMALL
from tests.helpers.linear_loop import BODY, STEP, Loop

PLACE = np.array([0.0, 0.0, 100.0])


# ---- Theorem 4 and Example 2


def power_sums(group: np.ndarray) -> np.ndarray:
    """The inner function of the proof, summed: [M; sum of x; sum of x^2; ... ; sum of x^M]."""
    return np.array([np.sum(group**k) for k in range(len(group) + 1)])


def members(sums: np.ndarray) -> np.ndarray:
    """Its inverse: Newton's identities give the polynomial whose roots are the group, sorted."""
    coefficients = [1.0]
    for k in range(1, len(sums)):
        part = sum(coefficients[k - i] * sums[i] for i in range(1, k + 1))
        coefficients.append(-part / k)
    return np.sort(np.roots(coefficients).real)


@pytest.mark.parametrize("seed", range(20))
def test_theorem_4_sums_over_each_group_say_all_that_an_invariant_function_needs(seed):
    rng = np.random.default_rng(seed)
    groups = [rng.uniform(0.0, 1.0, rng.integers(1, 5)) for _ in range(3)]
    code = [power_sums(rng.permutation(group)) for group in groups]
    found = [members(sums) for sums in code]
    for group, member in zip(groups, found, strict=True):
        assert member == pytest.approx(np.sort(group), abs=1e-4)

    def invariant(a, b, c):
        return a.max() + 2.0 * np.prod(b) - np.median(c) * a.min()

    assert invariant(*found) == pytest.approx(invariant(*groups), abs=1e-3)


def test_example_2_tends_to_its_limit_as_fast_as_two_exponentials_part():
    x, y = np.array([0.2, 0.7]), np.array([0.9, 0.4])
    limit = x.max() + 2.0 * y.max()
    for sharpness in (5.0, 20.0, 80.0):
        a, c = np.exp(sharpness * x).sum(), np.exp(sharpness * y).sum()
        b, d = x @ np.exp(sharpness * x), y @ np.exp(sharpness * y)
        # Each ratio falls short by the gap of its pair times the other's share.
        short = sum(f * 0.5 / (1.0 + math.exp(0.5 * sharpness)) for f in (1.0, 2.0))
        assert b / a + 2.0 * d / c == pytest.approx(limit - short, abs=1e-12)
    assert short < 1e-17


# ---- Theorem 6: the attitude under torques that the model does not know


def hovering(vehicle, config, flights):
    """Return the physics and the controller of drones that hover, and their set-point."""
    place = np.tile(PLACE, (flights, 1, 1))
    physics = BatchPhysics((vehicle,), flights, "none")
    physics.reset(hover_state((vehicle,), place))
    return physics, TrackingController((vehicle,), flights, config), Setpoint.hold(place)


def tilt_errors(vehicle, config, torques):
    """(E, T, 3) vector part of the attitude error under body torques (E, T, 3), N m."""
    flights, steps, _ = torques.shape
    physics, controller, target = hovering(vehicle, config, flights)
    drones, memory = physics.world.drones, controller._loop.world.drones
    found = np.zeros((flights, steps, 3))
    for k in range(steps):
        commands = controller.commands(physics.state, target)
        attitude = Rotation.from_quat(drones["quaternion"][:, 0])
        desired = Rotation.from_quat(memory["desired_attitude"][:, 0])
        found[:, k] = (desired.inv() * attitude).as_quat(canonical=True)[:, :3]
        # With the torque of the rotors: after the controller has looked, before the body moves.
        spin = attitude.apply(torques[:, k] / drones["inertia"][:, 0] * STEP)
        drones["angular_velocity"][:, 0] += spin
        physics.step(commands)
    return found


def torque_ball(vehicle, config, rate):
    """Radius in which the error of roll and pitch ends if torques change by `rate`, N m/s.

    With s = omega - omega_r the closed loop of the proof is J ds'/dt = -K s' - Gamma s + rate, two
    real low-passes, and q_v follows s / Lambda.
    """
    inertia = vehicle.inertia[0]
    return rate / (config.rate_integral_tilt * inertia) / config.attitude_tilt


@pytest.mark.parametrize("vehicle", [SMALL, LARGE], ids=["small", "large"])
def test_theorem_6_attitude_errors_end_in_a_ball_by_the_rate_of_the_torque_error(vehicle):
    config, inertia = ControllerConfig(), vehicle.inertia[0]
    rate, time = 0.2 * inertia, np.arange(0.0, 8.0, STEP)
    growing = np.zeros((3, len(time), 3))
    growing[0, :, 0] = growing[1, :, 1] = rate * time  # about each axis, and a constant one
    growing[2, :, 0] = 0.5 * inertia
    errors = np.linalg.norm(tilt_errors(vehicle, config, growing), axis=-1)
    radius = torque_ball(vehicle, config, rate)
    assert errors[:2, -1] == pytest.approx(radius, rel=0.01)
    assert errors[:2].max() < 1.01 * radius
    assert errors[2, -1] < 0.02 * errors[2].max()  # a rate of zero has a ball of radius zero


def test_theorem_6_random_torque_errors_stay_in_the_ball():
    config, rng = ControllerConfig(), np.random.default_rng(0)
    time, rate = np.arange(0.0, 6.0, STEP), 0.2 * SMALL.inertia[0]
    slope = np.repeat(rng.choice([-1.0, 1.0], (4, 24, 3)), len(time) // 24, axis=1) / np.sqrt(3.0)
    errors = tilt_errors(SMALL, config, rate * STEP * np.cumsum(slope, axis=1))
    assert np.linalg.norm(errors[..., :2], axis=-1).max() < 1.02 * torque_ball(SMALL, config, rate)


# ---- Theorem 7: all errors decay, those of the rotors too


@pytest.mark.parametrize("name", GAINS)
@pytest.mark.parametrize("vehicle", [SMALL, LARGE], ids=["small", "large"])
def test_theorem_7_the_augmented_state_decays_exponentially(name, vehicle):
    config = ControllerConfig(GAINS[name])
    rate = -math.log(Loop(config, vehicle=vehicle).radius()) / STEP  # 1/s of the slowest mode
    slowest = min(GAINS[name].integral, GAINS[name].position, config.rate_integral_tilt / 25.0)
    assert 0.8 * slowest < rate < 1.2 * slowest
    errors = augmented_errors(vehicle, config, 16, round(10.0 / STEP))
    time = STEP * np.arange(errors.shape[1])
    late = time > 4.0
    envelope = errors[:, late][:, :1] * np.exp(-0.7 * rate * (time[late] - time[late][0]))
    assert (errors[:, late] <= 1.5 * envelope).all()
    assert (errors[:, -1] < 0.05 * errors[:, 0]).all()


def augmented_errors(vehicle, config, flights, steps):
    """(E, T) norm of [p; v; q_v; omega; eta / weight] from random starts around hover."""
    rng = np.random.default_rng(1)
    physics, controller, target = hovering(vehicle, config, flights)
    drones = physics.world.drones
    rest = drones["rotor_thrust"].copy()
    for name in ("position", "velocity"):
        drones[name] += rng.uniform(-0.1, 0.1, drones[name].shape)
    tilt = Rotation.from_rotvec(rng.uniform(-0.2, 0.2, (flights, 3)))
    drones["quaternion"][:, 0] = tilt.as_quat()
    drones["angular_velocity"] += rng.uniform(-0.5, 0.5, drones["angular_velocity"].shape)
    drones["rotor_thrust"] *= rng.uniform(0.9, 1.1, rest.shape)
    found = np.zeros((flights, steps))
    for k in range(steps):
        parts = [np.asarray(drones[name][:, 0]) for name in BODY]
        parts[0] = parts[0] - PLACE
        parts[1] = parts[1][:, :3]
        parts[4] = (parts[4] - rest[:, 0]) / rest[:, 0]
        found[:, k] = np.linalg.norm(np.concatenate(parts, axis=1), axis=1)
        physics.step(controller.commands(physics.state, target))
    return found
