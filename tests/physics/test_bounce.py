"""Drones that bounce: momentum, restitution, and the same on both engines."""

from __future__ import annotations

import numpy as np
import pytest

from swarm_envs.envs.core import SwarmCore
from swarm_envs.physics import Physics, bullet_available
from swarm_envs.physics.bounce import RESTITUTION, bounce
from swarm_envs.state import FloatArray, SwarmState, hover_state
from swarm_envs.swap_v1 import blueprint
from swarm_envs.tables import BLOCK_TYPE, SETTINGS_TYPE, aligned
from swarm_envs.tasks.obstacles import Box, obstacle_rows
from swarm_envs.vehicles import LARGE, SMALL, parse_team

ARENA = [[-2.0, -2.0, 0.0], [2.0, 2.0, 2.5]]


def flown(
    engine: type[Physics], team: str, position: FloatArray, velocity: FloatArray, steps: int
) -> tuple[SwarmState, Physics]:
    """The state after some steps at constant thrust: hover, so that nothing falls."""
    physics = engine(team, interactions="none", arena=ARENA, on_contact="bounce")
    state = hover_state(parse_team(team), position)
    state.velocity[0] = velocity
    physics.reset(state)
    for _ in range(steps):
        physics.step(state.rotor_thrust)
    physics.close()
    return physics.state.copy(), physics


def test_two_drones_keep_their_momentum(engine: type[Physics]) -> None:
    position = np.array([[-0.3, 0.02, 1.0], [0.3, -0.02, 1.03]])
    velocity = np.array([[1.0, 0.0, 0.0], [-0.5, 0.1, 0.0]])
    after, _ = flown(engine, "SL", position, velocity, 120)
    mass = np.array([[SMALL.mass], [LARGE.mass]])
    np.testing.assert_allclose(
        (mass * after.velocity[0]).sum(0), (mass * velocity).sum(0), atol=1e-9
    )
    change = after.velocity[0, 0] - velocity[0]
    n = change / np.linalg.norm(change)  # without friction: the normal of the contact
    before, parting = (
        (velocity[0] - velocity[1]) @ n,
        (after.velocity[0, 0] - after.velocity[0, 1]) @ n,
    )
    assert before < -1.0
    assert parting == pytest.approx(-RESTITUTION * before, abs=1e-9)
    assert not after.angular_velocity.any()


def test_walls_floor_and_ceiling_give_back_a_part(engine: type[Physics]) -> None:
    position = np.array([[1.5, 0, 1.0], [0, -1.5, 1.0], [0, 0, 0.5], [0, 0.5, 2.2]])
    velocity = np.array([[1.0, 0.2, 0], [0, -1.0, 0.2], [0.2, 0, -1.0], [0, 0.2, 1.0]])
    after, _ = flown(engine, "SSSS", position, velocity, 144)
    expected = np.where(abs(velocity) == 1.0, -RESTITUTION * velocity, velocity)
    np.testing.assert_allclose(after.velocity[0], expected, atol=1e-9)


def test_what_lies_on_the_floor_stays_there(engine: type[Physics]) -> None:
    physics = engine("S", interactions="none", arena=ARENA, on_contact="bounce")
    physics.reset(hover_state(parse_team("S"), [[0.0, 0.0, 0.3]]))
    for _ in range(600):
        physics.step(np.zeros((1, 1, 4)))
    assert physics.state.position[0, 0, 2] == pytest.approx(SMALL.radius, abs=1e-3)
    assert physics.contacts.floor.all()
    physics.close()


def test_an_obstacle_gives_back_a_part() -> None:
    """A sphere meets the edge of a box at 45 degrees: plain Python runs what is compiled."""
    rows = obstacle_rows((Box(low=(0.0, -1.0, 0.0), high=(1.0, 1.0, 1.0)),))
    blocks, settings = aligned(1, BLOCK_TYPE), np.zeros(1, SETTINGS_TYPE)
    settings["arena"] = [[-9, -9, -9], [9, 9, 9]]
    b = blocks[0]
    b["touched_drone"], b["mass"], b["radius"] = -1.0, 1.0, 0.1
    b["position"][:, 0], b["velocity"][:, 0] = (-0.06, 0.0, 1.06), (1.0, 0.5, 0.0)
    bounce(blocks, 0, 1, settings.view(np.recarray), rows)
    n = np.array([-1.0, 0.0, 1.0]) / np.sqrt(2.0)
    expected = np.array([1.0, 0.5, 0.0]) + (1 + RESTITUTION) * np.sqrt(0.5) * n
    np.testing.assert_allclose(b["velocity"][:, 0], expected, atol=1e-12)
    np.testing.assert_allclose(b["position"][:, 0], 0.1 * n + [0.0, 0.0, 1.0], atol=1e-12)


@pytest.mark.skipif(not bullet_available(), reason="pybullet is not installed")
def test_both_engines_bounce_alike() -> None:
    """A crowd that is told to fly into each other: bounce after bounce, to 1e-9."""
    cores = []
    for physics in ("batch", "bullet"):
        task, config, _ = blueprint(
            num_drones=6, physics=physics, on_contact="bounce", action="velocity", horizon_s=2.0
        )
        cores.append(SwarmCore(task, config))
        cores[-1].reset([4])
    bounces, worst = 0, 0.0
    while cores[0].running[0]:
        away = cores[0].world.drones["position"] - [0.0, 0.0, 0.8]
        actions = np.clip(-2.0 * away, -1.0, 1.0)
        results = [core.step(actions) for core in cores]
        bounces += int(results[0].reward_terms[5].sum())
        for one, other in zip(*(core.physics.state for core in cores), strict=True):
            worst = max(worst, float(abs(one - other).max()))
        np.testing.assert_allclose(results[0].rewards, results[1].rewards, atol=1e-9)
    assert bounces > 4
    assert worst < 1e-9
    for core in cores:
        core.close()
