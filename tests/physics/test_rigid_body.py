"""The integrator against closed forms and conservation laws."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from swarm_envs.physics import TIME_STEP, BatchPhysics, rigid_body
from swarm_envs.physics.rigid_body import LARGEST_RATE, gust, integrate, sinc_cos, spin_rotors
from swarm_envs.state import FloatArray, SwarmState, hover_state
from swarm_envs.tables import BLOCK_TYPE, ENVIRONMENT_TYPE, LANES, SETTINGS_TYPE, Records
from swarm_envs.vehicles import GRAVITY, Team, parse_team

STEPS = 240
TEAM = parse_team("SL")


def start(team: Team = TEAM, height: float = 50.0) -> SwarmState:
    return hover_state(team, [[10.0 * i, 0.0, height] for i in range(len(team))])


def flown(
    state: SwarmState, commands: FloatArray | float, steps: int = STEPS, team: Team = TEAM
) -> BatchPhysics:
    """The engine after steps with the same rotor commands, N, from a state."""
    physics = BatchPhysics(team, interactions="none")
    physics.reset(state)
    for _ in range(steps):
        physics.step(np.broadcast_to(commands, state.rotor_thrust.shape))
    return physics


def test_free_fall_follows_the_parabola() -> None:
    state = start()
    state.rotor_thrust[:] = 0.0
    state = flown(state, 0.0).state
    t = STEPS * TIME_STEP
    np.testing.assert_allclose(state.velocity[0, :, 2], -GRAVITY * t, rtol=1e-12)
    # semi-implicit Euler adds g t dt / 2 to the parabola, and nothing else
    fallen = GRAVITY * t**2 / 2 + GRAVITY * t * TIME_STEP / 2
    np.testing.assert_allclose(state.position[0, :, 2], 50.0 - fallen, rtol=1e-12)


def test_constant_thrust_along_a_tilted_axis() -> None:
    tilt = Rotation.from_euler("x", 0.3)
    state = start()
    state.quaternion[:] = tilt.as_quat()
    state.rotor_thrust[:] *= 1.5
    velocity = flown(state, state.rotor_thrust.copy()).state.velocity[0]
    acceleration = 1.5 * GRAVITY * tilt.apply([0, 0, 1]) - np.array([0, 0, GRAVITY])
    expected = np.broadcast_to(acceleration * STEPS * TIME_STEP, (2, 3))
    np.testing.assert_allclose(velocity, expected, rtol=1e-10, atol=1e-12)


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("rate", [1.0, 20.0, 140.0])
def test_spin_about_a_principal_axis_keeps_its_rate(axis: int, rate: float) -> None:
    tilt = Rotation.from_rotvec([0.4, -0.2, 0.9])
    state = start()
    state.rotor_thrust[:] = 0.0
    body_axis = np.eye(3)[axis]
    state.quaternion[:] = tilt.as_quat()
    state.angular_velocity[:] = rate * tilt.apply(body_axis)
    state = flown(state, 0.0).state.copy()
    turned = tilt * Rotation.from_rotvec(body_axis * rate * STEPS * TIME_STEP)
    for i in range(2):
        attitude = Rotation.from_quat(state.quaternion[0, i])
        assert (turned.inv() * attitude).magnitude() < 1e-6
        body_rate = attitude.inv().apply(state.angular_velocity[0, i])
        np.testing.assert_allclose(body_rate, rate * body_axis, atol=rate * 1e-6)


def spinning_block(inertia: list[float], rate: list[float]) -> Records:
    """A block of equal bodies without rotors that spin, rad/s."""
    blocks = np.zeros(1, BLOCK_TYPE)
    blocks["mass"] = 1.0
    blocks["quaternion"][:, 3] = 1.0
    blocks["inertia"] = np.array(inertia)[:, None]
    blocks["angular_velocity"] = np.array(rate)[:, None]
    return blocks


def momentum_and_energy(blocks: Records) -> tuple[np.ndarray, float]:
    """Angular momentum and energy of the last of a block's bodies; all have the same."""
    for name in ("quaternion", "angular_velocity"):
        assert (blocks[name] == blocks[name][..., :1]).all()
    attitude = Rotation.from_quat(blocks["quaternion"][0, :, -1])
    inertia = blocks["inertia"][0, :, -1]
    body_rate = attitude.inv().apply(blocks["angular_velocity"][0, :, -1])
    return attitude.apply(inertia * body_rate), float(0.5 * body_rate @ (inertia * body_rate))


def drift(dt: float, duration: float = 1.0) -> tuple[float, float]:
    """Relative change of angular momentum and energy of a torque-free, generic spin."""
    blocks = spinning_block([1.2e-5, 1.9e-5, 2.9e-5], [3.0, 4.0, 5.0])
    momentum, energy = momentum_and_energy(blocks)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(rigid_body, "TIME_STEP", dt)  # called from here, `integrate` is interpreted
        for _ in range(round(duration / dt)):
            integrate(blocks, 1)
    later, later_energy = momentum_and_energy(blocks)
    change = float(np.linalg.norm(later - momentum) / np.linalg.norm(momentum))
    return change, abs(later_energy - energy) / energy


def test_torque_free_spin_converges_at_first_order() -> None:
    steps = [1 / 240, 1 / 480, 1 / 960]
    momentum, energy = (np.array(errors) for errors in zip(*map(drift, steps), strict=True))
    for errors in (momentum, energy):
        order = np.log2(errors[:-1] / errors[1:])
        np.testing.assert_allclose(order, 1.0, atol=0.15)
    assert momentum[0] < 0.05
    assert energy[0] < 0.05


def test_rotors_lag_exponentially() -> None:
    state = start()
    state.rotor_thrust[:] = 0.0
    expected = 0.05 * (1.0 - np.exp(-16.0 * 0.1))
    np.testing.assert_allclose(flown(state, 0.05, 24).state.rotor_thrust, expected, rtol=1e-12)


def test_rotors_stay_within_what_motors_can() -> None:
    most = flown(start(), 10.0).state.rotor_thrust[0]
    expected = [[v.max_rotor_thrust] * 4 for v in TEAM]
    np.testing.assert_allclose(most, expected, rtol=1e-6)
    least = flown(start(), -10.0).state.rotor_thrust
    assert (least >= 0.0).all() and (least < 1e-6).all()


@pytest.mark.parametrize(
    ("rotors", "axis", "sign"),
    [((2, 3), 0, 1), ((1, 2), 1, 1), ((1, 3), 2, 1), ((0, 1), 0, -1), ((0, 3), 1, -1)],
)
def test_torque_signs(rotors: tuple[int, int], axis: int, sign: int) -> None:
    """Left rotors roll right side down, rear rotors pitch nose down, clockwise ones yaw left."""
    team = parse_team("S")
    state = start(team)
    state.rotor_thrust[0, 0, list(rotors)] *= 1.2
    rate = flown(state, state.rotor_thrust.copy(), 1, team).state.angular_velocity[0, 0]
    assert np.sign(rate[axis]) == sign
    assert np.abs(np.delete(rate, axis)).max() < 1e-12


def test_tumbling_is_reported_above_150_rad_per_s_only() -> None:
    state = start()
    state.rotor_thrust[:] = 0.0
    state.angular_velocity[0, :, 2] = [149.0, 151.0]
    assert flown(state, 0.0, 1).contacts.tumbling.tolist() == [[False, True]]


def test_numbers_stay_finite_while_tumbling_wildly() -> None:
    state = start(height=500.0)
    state.angular_velocity[:] = [150.0, 140.0, -130.0]
    for array in flown(state, np.array([0.0, 1.0, 0.0, 1.0]), 2000).state:
        assert np.isfinite(array).all()


def test_unequal_rotors_and_a_force_from_outside_add_up() -> None:
    """Level at first, so the first step is (sum of thrusts along z + force) / m - g."""
    physics = BatchPhysics(TEAM, interactions="none")
    state = start()
    state.rotor_thrust[0] = [[0.01, 0.02, 0.04, 0.08], [0.08, 0.01, 0.02, 0.04]]
    physics.reset(state)
    force = np.array([[[0.01, -0.02, 0.03], [-0.04, 0.05, -0.06]]])
    physics.step(state.rotor_thrust, external_force=force)
    mass = np.array([vehicle.mass for vehicle in TEAM])[:, None]
    expected = (force[0] + [0.0, 0.0, 0.15]) / mass - [0.0, 0.0, 9.80665]
    np.testing.assert_allclose(physics.state.velocity[0] * 240.0, expected, rtol=1e-10)


def test_gusts_are_one_acceleration_of_a_team_by_the_exact_step_of_their_process(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(rigid_body, "normal", lambda key, number: float(key) - float(number))
    kept, strength, key, age = 0.8, 2.0, 77, 5
    environment = np.zeros(1, ENVIRONMENT_TYPE).view(np.recarray)
    settings = np.zeros(1, SETTINGS_TYPE).view(np.recarray)
    blocks = np.zeros(2, BLOCK_TYPE).view(np.recarray)
    environment.gust_key, environment.age, environment.gust = key, age, [0.5, -1.0, 3.0]
    settings.gust_kept, settings.gust_strength = kept, strength
    blocks["mass"] = np.arange(1.0, 1.0 + 2 * LANES).reshape(2, LANES)
    first, drones = LANES - 2, 4  # two in each block
    gust(environment[0], first, drones, settings, blocks)
    drawn = np.array([key - 15.0, key - 16.0, key - 17.0])
    expected = kept * np.array([0.5, -1.0, 3.0]) + strength * 0.6 * drawn
    np.testing.assert_allclose(environment[0].gust, expected, rtol=1e-12)
    forces = blocks["external"].transpose(0, 2, 1).reshape(-1, 3)
    moved = slice(first, first + drones)
    masses = blocks["mass"].ravel()[moved, None]
    np.testing.assert_allclose(forces[moved], masses * expected, rtol=1e-12)
    assert not forces[:first].any() and not forces[first + drones :].any()


def test_a_physics_step_is_counted_once_with_what_was_outside_and_over_the_bound() -> None:
    blocks = np.zeros(1, BLOCK_TYPE).view(np.recarray)
    b = blocks[0]
    b["force"][:, 0], b["worst_force"][1] = (3.0, -4.0, -12.0), 20.0
    b["force_bound"][:], b["outside"][2] = 11.9, 1.0
    b["rotor_thrust"][:, 3], b["energy_scale"][3] = (0.0, 1.0, 4.0, 9.0), 0.5
    for _ in range(2):
        spin_rotors(blocks, 1)
        b["rotor_thrust"][:, 3] = (0.0, 1.0, 4.0, 9.0)
    assert (b["steps"] == 2.0).all()
    assert b["worst_force"][:2].tolist() == [13.0, 20.0]
    assert b["over_bound"][:2].tolist() == [2.0, 0.0]
    assert b["outside_steps"][:3].tolist() == [0.0, 0.0, 2.0]
    assert b["energy"][3] == 2 * 0.5 * (1.0 + 8.0 + 27.0)


def test_sines_by_series_are_those_of_the_library() -> None:
    """At every half turn of a step that the limits of the three body rates allow."""
    most = 0.5 * np.sqrt(3.0) * LARGEST_RATE * TIME_STEP
    angles = np.concatenate([np.linspace(0.0, most, 2001), np.logspace(-300, 0, 301)])
    for angle in angles.tolist():
        sinc, cos = sinc_cos(angle)
        assert sinc == pytest.approx(np.sinc(angle / np.pi), abs=1e-14)
        assert cos == pytest.approx(np.cos(angle), abs=1e-14)
