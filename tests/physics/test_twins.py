"""Bullet and the compiled engine fly the same flight until something touches."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from swarm_envs.control.config import ControllerConfig
from swarm_envs.control.tracking import TrackingController
from swarm_envs.physics import BatchPhysics, BulletPhysics, Physics, bullet_available
from swarm_envs.state import Setpoint, SwarmState, hover_state
from swarm_envs.vehicles import parse_team

pytestmark = pytest.mark.skipif(not bullet_available(), reason="pybullet is not installed")

TEAM = parse_team("LSS*")
STACK = [[0.0, 0.0, 1.5], [0.06, 0.02, 1.15], [-0.05, 0.08, 0.85]]


def difference(a: SwarmState, b: SwarmState) -> float:
    position, velocity = a.position - b.position, a.velocity - b.velocity
    return float(max(np.abs(position).max(), np.abs(velocity).max()))


def fly_both(engines: list[Physics], commands: list[np.ndarray], push: np.ndarray) -> float:
    worst = 0.0
    for k, u in enumerate(commands):
        a, b = (engine.step(u, push[k]) for engine in engines)
        assert not engines[0].contact.any()
        worst = max(worst, difference(a, b))
    return worst


def controlled_flight(
    interactions: str, push: np.ndarray, rng: np.random.Generator
) -> list[np.ndarray]:
    """Commands that hold the stack in the air against the push, shaken by the generator."""
    physics = BatchPhysics(TEAM, interactions=interactions)
    physics.reset(hover_state(TEAM, STACK))
    config = ControllerConfig(feedforward=physics.interactions)
    controller = TrackingController(TEAM, config=config)
    goal = Setpoint.hold(np.array([STACK]))
    commands = []
    for external in push:
        u = controller.commands(physics.state, goal) * rng.uniform(0.95, 1.05, (1, 3, 4))
        commands.append(u)
        physics.step(u, external)
    return commands


@pytest.mark.parametrize("interactions", ["learned", "wake"])
def test_same_commands_same_flight(interactions: str) -> None:
    rng = np.random.default_rng(3)
    steps = 480
    push = rng.normal(0.0, 0.01, (steps, 1, 3, 3))
    commands = controlled_flight(interactions, push, rng)
    with BulletPhysics(TEAM, interactions=interactions) as bullet:
        batch = BatchPhysics(TEAM, interactions=interactions)
        for engine in (batch, bullet):
            engine.reset(hover_state(TEAM, STACK))
        assert fly_both([batch, bullet], commands, push) < 1e-9
        assert np.abs(batch.force[..., 2]).max() > 0.03  # the drones did blow on each other


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
        assert fly_both([batch, bullet], commands, np.zeros((240, 1, 3, 3))) < 1e-9
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
    attitudes = []
    for kind in (BatchPhysics, BulletPhysics):
        engine = kind(TEAM, interactions="none")
        engine.reset(state)
        for _ in range(240):
            engine.step(np.zeros((1, 3, 4)))
        attitude = Rotation.from_quat(engine.state.quaternion[0].copy())
        inertia = np.array([vehicle.inertia for vehicle in TEAM])
        energies = [
            (inertia * turned.inv().apply(spin.copy()) ** 2).sum(axis=1)
            for turned, spin in (
                (Rotation.from_quat(state.quaternion[0]), state.angular_velocity[0]),
                (attitude, engine.state.angular_velocity[0]),
            )
        ]
        np.testing.assert_allclose(energies[1] / energies[0] - 1.0, gain, rtol=0.01)
        attitudes.append(attitude)
        engine.close()
    assert ((attitudes[0].inv() * attitudes[1]).magnitude() < 1e-6).all()


def spinning(rate: float, wobble: float) -> SwarmState:
    """Three drones close together, far up, spinning about their thrust axes, rad/s."""
    state = hover_state(TEAM, [[0, 0, 100.0], [0.3, 0, 100.6], [0, 0.3, 99.5]])
    state.angular_velocity[0] = rate * np.array([[0, 0, 1], [wobble, 0, 1], [0, -wobble, -1]])
    return state
