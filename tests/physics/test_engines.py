"""Both engines check their input, leak nothing and hold forces; torques turn bodies."""

from __future__ import annotations

import dataclasses
import resource
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from swarm_envs.envs.config import EnvConfig
from swarm_envs.envs.core import SwarmCore
from swarm_envs.interactions import InteractionModel, load
from swarm_envs.interactions.field import WAKE, empty_field
from swarm_envs.motors import BatteryModel
from swarm_envs.physics import BatchPhysics, BulletPhysics, Physics, bullet_available
from swarm_envs.state import hover_state
from swarm_envs.tasks.swap import SwapTask
from swarm_envs.vehicles import SMALL, parse_team

TEAM = parse_team("LS")
STACK = [[0.0, 0.0, 1.4], [0.02, 0.0, 1.0]]


@pytest.mark.parametrize(
    ("commands", "complaint"),
    [
        (np.zeros((1, 2, 3)), r"shape \(1, 2, 3\).*\(1, 2, 4\)"),
        (np.full((1, 2, 4), np.nan), "nan at index"),
    ],
)
def test_bad_commands_change_nothing(engine, commands, complaint):
    physics = engine(TEAM)
    physics.reset(hover_state(TEAM, STACK))
    physics.step(physics.state.rotor_thrust)
    before = physics.state.copy()
    with pytest.raises(ValueError, match=complaint):
        physics.step(commands)
    with pytest.raises(ValueError, match="external_force"):
        physics.step(before.rotor_thrust, np.full((1, 2, 3), np.nan))
    for now, then in zip(physics.state, before, strict=True):
        np.testing.assert_array_equal(now, then)
    physics.close()


@pytest.mark.parametrize(
    ("field", "value", "complaint"),
    [
        ("position", np.nan, "state.position is nan"),
        ("quaternion", 0.9, "unit quaternion"),
        ("rotor_thrust", -0.1, "must not be negative"),
        ("battery", 1.5, "between 0"),
    ],
)
def test_impossible_states_are_refused(field: str, value: float, complaint: str) -> None:
    physics = BatchPhysics(TEAM)
    state = hover_state(TEAM, STACK)
    getattr(state, field)[:] = value
    before = physics.state.copy()
    with pytest.raises(ValueError, match=complaint):
        physics.reset(state)
    np.testing.assert_array_equal(physics.state.position, before.position)


def test_an_external_force_pushes_in_its_step_alone(engine: type[Physics]) -> None:
    everywhere, hover = np.ones(1, np.bool_), hover_state(parse_team("S"), [[0, 0, 1.0]])
    physics, speeds = engine("S", interactions="none"), []
    push = np.array([0.1, -0.05, 0.02])
    for force in (np.zeros(3), push):
        physics.reset(hover)
        physics.step(hover.rotor_thrust, external_force=force[None, None])
        first = physics.state.velocity[0, 0].copy()
        physics.fly(3, everywhere)
        speeds.append((first, physics.state.velocity[0, 0].copy()))
    physics.close()
    np.testing.assert_array_equal(np.array(speeds[0])[:, :2], 0.0)
    np.testing.assert_allclose(speeds[1], [push * STEP / SMALL.mass] * 2, rtol=1e-9)


def test_a_model_of_other_vehicles_is_flown(engine: type[Physics]) -> None:
    """Where the controller compensates nothing, nothing has to know what types they are."""
    fitted = InteractionModel("fitted", ("X",), empty_field(1)._replace(kind=WAKE))
    team = (dataclasses.replace(SMALL, interaction_type="X"),) * 2
    for model in (fitted, "none"):
        physics = engine(team, interactions=model)
        physics.step(physics.state.rotor_thrust)
        assert np.isfinite(physics.state.velocity).all()
        physics.close()


def test_batteries_empty_and_weaken_the_rotors() -> None:
    physics = BatchPhysics("S", interactions="none", battery=BatteryModel())
    state = hover_state(parse_team("S"), [[0, 0, 1]])
    state.battery[:] = 0.3
    physics.reset(state)
    full = physics.parameters.max_rotor_thrust.copy()
    for _ in range(240):
        physics.step(state.rotor_thrust)
    assert 0.0 < physics.state.battery[0, 0] < 0.3
    assert physics.world.drones["rotor_limit"][0, 0] < full[0, 0]
    lasting = BatchPhysics("S", interactions="none")
    lasting.step(lasting.state.rotor_thrust)
    assert lasting.state.battery[0, 0] == 1.0


def memory_mb() -> float:
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * resource.getpagesize() / 1e6


@pytest.mark.skipif(not bullet_available(), reason="pybullet is not installed")
class TestBulletResources:
    """Clients and bodies are freed, or never made twice."""

    def test_closing_twice_is_harmless_and_stepping_after_is_refused(self) -> None:
        physics = BulletPhysics(TEAM)
        physics.close()
        physics.close()
        with pytest.raises(RuntimeError, match="closed"):
            physics.step(np.zeros((1, 2, 4)))

    def test_resets_and_open_close_cycles_do_not_leak(self) -> None:
        physics, state = BulletPhysics(TEAM), hover_state(TEAM, STACK)
        for limit, warm_up, count, repeat in (
            (2.0, 500, 4_000, lambda: physics.reset(state)),
            (8.0, 20, 80, lambda: BulletPhysics(TEAM).close()),
        ):
            for _ in range(warm_up):
                repeat()
            before = memory_mb()
            for _ in range(count):
                repeat()
            assert memory_mb() - before < limit
        physics.close()

    def test_forgotten_engines_give_their_client_back(self) -> None:
        import pybullet

        physics = BulletPhysics(TEAM)
        client = physics.clients[0]
        del physics
        assert not pybullet.isConnected(client)


STEP = 1 / 240
ROTORS = np.array([[1, -1, 0], [-1, -1, 0], [-1, 1, 0], [1, 1, 0]])  # front right, then clockwise
SLS = "SLS"


def state_of(made: Physics, rng: np.random.Generator) -> Any:
    """Two crowds, all pairs well inside of the volume, tilted and moving."""
    shape = made.state.position.shape
    position = rng.uniform(-0.1, 0.1, shape) + np.array([[0, 0, 0.7], [0, 0, 1.0], [0, 0, 1.3]])
    quaternion = rng.normal(size=(*shape[:2], 4)) * [0.2, 0.2, 0.5, 1.0]
    quaternion /= np.linalg.norm(quaternion, axis=-1, keepdims=True)
    velocity = rng.uniform(-0.4, 0.4, shape)
    moves = {"velocity": velocity, "angular_velocity": rng.uniform(-1.0, 1.0, shape)}
    return made.state.copy()._replace(position=position, quaternion=quaternion, **moves)


@pytest.mark.parametrize("name", ["learned", "wake", "deep-set"])
def test_torque_is_that_of_forces_at_the_rotors(engine: type[Physics], name: str) -> None:
    """Against `forces`, asked with one drone at a time moved to where each of its rotors is."""
    rng, model = np.random.default_rng(2), load(name)
    made, plain = (engine(SLS, 2, model, interaction_torque=on) for on in (True, False))
    state = state_of(made, rng)
    turned = []
    for physics in (made, plain):
        physics.reset(state)
        turned.append(physics.step(np.full((2, 3, 4), 0.1)).angular_velocity.copy())
    for e, i in np.ndindex(2, 3):
        body = Rotation.from_quat(state.quaternion[e, i]).as_matrix()
        arm = made.parameters.rotor_offset[e, i]
        expected = np.zeros(3)
        for place in arm * ROTORS:
            moved = state.position[e].copy()
            moved[i] += body @ place
            force = model.forces(moved[None], state.velocity[e][None], SLS)[0, i, 2]
            expected += np.cross(place, body.T @ [0.0, 0.0, force / 4])
        found = made.world.drones["interaction_torque"][e, i]
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-12)
        change = body.T @ (turned[0] - turned[1])[e, i]
        inertia = made.parameters.inertia[e, i]
        np.testing.assert_allclose(change, STEP * expected / inertia, rtol=0, atol=1e-8)
        if i < 2:  # somebody is above
            assert np.abs(expected[:2]).max() > 1e-7
    for physics in (made, plain):
        physics.close()


@pytest.mark.skipif(not bullet_available(), reason="pybullet is not installed")
def test_engines_and_snapshots_fly_the_same_torque() -> None:
    """With forces that are held over decisions, so that the torque must be kept with the state."""

    def core(engine: str) -> SwarmCore:
        forces: dict[str, Any] = {"interactions": "wake", "force_rate": 30}
        config = EnvConfig(physics=engine, interaction_torque=True, **forces)
        made = SwarmCore(SwapTask(parse_team("LSS"), "stacked"), config, 2)
        made.reset([0, 1])
        return made

    batch, bullet, other = core("batch"), core("bullet"), core("batch")
    rng = np.random.default_rng(0)
    for k in range(45):
        actions = rng.uniform(-0.3, 0.3, (2, 3, 3))
        for made in (batch, bullet, *([other] if k > 20 else [])):
            made.step(actions)
        if k == 20:
            other.set_state(batch.get_state())
    assert not batch.physics.contact.any()
    for name in ("position", "quaternion", "angular_velocity", "interaction_torque"):
        mine = batch.world.drones[name]
        np.testing.assert_allclose(mine, bullet.world.drones[name], rtol=0, atol=1e-9)
        assert mine.tobytes() == other.world.drones[name].tobytes()
    assert np.abs(batch.world.drones["interaction_torque"]).max() > 0.0
