"""Bullet and the compiled engine fly alike at high body rates."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from swarm_envs.physics import BatchPhysics, BulletPhysics, bullet_available
from swarm_envs.state import SwarmState, hover_state
from swarm_envs.vehicles import parse_team

pytestmark = pytest.mark.skipif(not bullet_available(), reason="pybullet is not installed")

TEAM = parse_team("LSS*")
STACK = [[0.0, 0.0, 1.5], [0.06, 0.02, 1.15], [-0.05, 0.08, 0.85]]


def difference(a: SwarmState, b: SwarmState) -> float:
    position, velocity = a.position - b.position, a.velocity - b.velocity
    return float(max(np.abs(position).max(), np.abs(velocity).max()))


@pytest.mark.parametrize("rate", [100.0, 125.0, 145.0])
def test_same_flight_at_high_body_rates(rate: float) -> None:
    """Bullet would clamp each component at 100 rad/s; here it must not."""
    rng = np.random.default_rng(5)
    state = spinning(rate, wobble=0.0)
    yaw = np.array([-1.0, 1.0, -1.0, 1.0])
    commands = [
        state.rotor_thrust * (rng.uniform(0.8, 1.2, (1, 3, 1)) + rng.normal(0, 0.1) * yaw)
        for _ in range(240)
    ]
    with BulletPhysics(TEAM) as bullet:
        batch = BatchPhysics(TEAM)
        for engine in (batch, bullet):
            engine.reset(state)
        for command in commands:
            assert difference(batch.step(command), bullet.step(command)) < 1e-9
            assert not batch.contact.any()
        speed = np.linalg.norm(bullet.state.angular_velocity, axis=-1)
        assert ((speed > 95.0) & (speed < 150.0)).all()


@pytest.mark.parametrize("rate", [100.0, 140.0])
def test_same_flight_until_both_report_tumbling(rate: float) -> None:
    """Off the principal axis the explicit gyroscopic term spins bodies up, the same in both."""
    state = spinning(rate, wobble=0.02)
    with BulletPhysics(TEAM) as bullet:
        batch = BatchPhysics(TEAM)
        for engine in (batch, bullet):
            engine.reset(state)
        for step in range(240):  # noqa: B007
            a, b = batch.step(state.rotor_thrust), bullet.step(state.rotor_thrust)
            flags = batch.contacts.tumbling
            np.testing.assert_array_equal(flags, bullet.contacts.tumbling)
            if flags.any():
                break
            assert difference(a, b) < 1e-9
        assert flags.any()
        assert step > 10


@pytest.mark.parametrize(("rate", "gain"), [(4.0, 0.0069), (16.0, 0.1216), (50.0, 3.416)])
def test_free_spin_gains_the_energy_that_the_limits_name(rate: float, gain: float) -> None:
    """Without torque it would keep its energy; attitudes may differ in the quaternion's sign."""
    state = hover_state(TEAM, np.add(STACK, [0.0, 0.0, 50.0]))
    state.rotor_thrust[:] = 0.0
    state.angular_velocity[:] = rate / np.sqrt(3.0)
    inertia, attitudes = np.array([vehicle.inertia for vehicle in TEAM]), []
    for kind in (BatchPhysics, BulletPhysics):
        engine = kind(TEAM, interactions="none")
        engine.reset(state)
        for _ in range(240):
            engine.step(np.zeros((1, 3, 4)))
        attitude = Rotation.from_quat(engine.state.quaternion[0].copy())
        body_rate = attitude.inv().apply(engine.state.angular_velocity[0].copy())
        energy = (inertia * body_rate**2).sum(axis=1)
        # At the start bodies are level.
        before = (inertia * state.angular_velocity[0] ** 2).sum(axis=1)
        np.testing.assert_allclose(energy / before - 1.0, gain, rtol=0.01)
        attitudes.append(attitude)
        engine.close()
    assert ((attitudes[0].inv() * attitudes[1]).magnitude() < 1e-6).all()


def spinning(rate: float, wobble: float) -> SwarmState:
    """Three drones close together, far up, spinning about their thrust axes, rad/s."""
    state = hover_state(TEAM, [[0, 0, 100.0], [0.3, 0, 100.6], [0, 0.3, 99.5]])
    state.angular_velocity[0] = rate * np.array([[0, 0, 1], [wobble, 0, 1], [0, -wobble, -1]])
    return state
