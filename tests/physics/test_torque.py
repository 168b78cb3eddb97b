"""Option `interaction_torque`: the interaction force is felt rotor by rotor, and turns bodies."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from swarm_envs.envs.config import EnvConfig
from swarm_envs.envs.core import SwarmCore
from swarm_envs.interactions import load
from swarm_envs.physics import BatchPhysics, BulletPhysics, bullet_available
from swarm_envs.physics.base import Physics
from swarm_envs.tasks.swap import SwapTask
from swarm_envs.vehicles import parse_team

STEP = 1 / 240
ROTORS = np.array([[1, -1, 0], [-1, -1, 0], [-1, 1, 0], [1, 1, 0]])  # front right, then clockwise
TEAM = "SLS"
engines = pytest.mark.parametrize("engine", [BatchPhysics, BulletPhysics])


def rotation(q: np.ndarray) -> np.ndarray:
    """Body to world, by Rodrigues' formula."""
    cross = np.cross(np.eye(3), q[:3])
    return np.asarray(np.eye(3) + 2.0 * q[3] * cross + 2.0 * cross @ cross)


def state_of(made: Physics, rng: np.random.Generator) -> Any:
    """Two crowds, all pairs well inside of the volume, tilted and moving."""
    shape = made.state.position.shape
    position = rng.uniform(-0.1, 0.1, shape) + np.array([[0, 0, 0.7], [0, 0, 1.0], [0, 0, 1.3]])
    quaternion = rng.normal(size=(*shape[:2], 4)) * [0.2, 0.2, 0.5, 1.0]
    quaternion /= np.linalg.norm(quaternion, axis=-1, keepdims=True)
    velocity = rng.uniform(-0.4, 0.4, shape)
    moves = {"velocity": velocity, "angular_velocity": rng.uniform(-1.0, 1.0, shape)}
    still = type(made.state)(*(array.copy() for array in made.state))
    return still._replace(position=position, quaternion=quaternion, **moves)


@engines
@pytest.mark.parametrize("name", ["learned", "wake", "deep-set"])
def test_torque_is_that_of_forces_at_the_rotors(engine: type[Physics], name: str) -> None:
    """Against `forces`, asked with one drone at a time moved to where each of its rotors is."""
    if engine is BulletPhysics and not bullet_available():
        pytest.skip("pybullet is not installed")
    rng, model = np.random.default_rng(2), load(name)
    made, plain = (engine(TEAM, 2, model, interaction_torque=on) for on in (True, False))
    state = state_of(made, rng)
    turned = []
    for physics in (made, plain):
        physics.reset(state)
        turned.append(physics.step(np.full((2, 3, 4), 0.1)).angular_velocity.copy())
    for e, i in np.ndindex(2, 3):
        body, arm = rotation(state.quaternion[e, i]), made.parameters.rotor_offset[e, i]
        expected = np.zeros(3)
        for place in arm * ROTORS:
            moved = state.position[e].copy()
            moved[i] += body @ place
            force = model.forces(moved[None], state.velocity[e][None], TEAM)[0, i, 2]
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
        config = EnvConfig(
            physics=engine, interactions="wake", interaction_torque=True, force_rate=30
        )
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
