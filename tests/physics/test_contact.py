"""Collision flags: who touches what, on both engines."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest

from swarm_envs.physics import BatchPhysics, BulletPhysics, Physics, bullet_available
from swarm_envs.state import hover_state
from swarm_envs.tasks.obstacles import Box, obstacle_rows
from swarm_envs.vehicles import LARGE, SMALL, parse_team

ARENA = [[-2.0, -2.0, 0.0], [2.0, 2.0, 2.5]]


def touched(engine: type[Physics], team: str, positions: Sequence[Sequence[float]]) -> Physics:
    physics = engine(team, interactions="none", arena=ARENA)
    state = hover_state(parse_team(team), positions)
    physics.reset(state)
    physics.step(state.rotor_thrust)
    physics.close()
    return physics


def test_drones_touch_below_the_sum_of_radii(engine: type[Physics]) -> None:
    reach = SMALL.radius + LARGE.radius
    near = touched(engine, "SLS", [[0, 0, 1], [reach - 1e-3, 0, 1], [0, 1, 1]])
    assert near.contacts.drone.tolist() == [[1, 0, -1]]
    assert near.contact.tolist() == [[True, True, False]]
    far = touched(engine, "SLS", [[0, 0, 1], [reach + 1e-3, 0, 1], [0, 1, 1]])
    assert not far.contact.any()
    assert far.contacts.separation[0, 0] == pytest.approx(reach + 1e-3)
    assert far.contacts.clearance[0, 0] == pytest.approx((reach + 1e-3) / reach)


def test_floor_wall_and_ceiling(engine: type[Physics]) -> None:
    positions = [[0.0, 0, 0.05], [1.95, 0, 1], [0.0, -1.95, 1], [0.0, 0, 2.46], [1.0, 1, 0.07]]
    physics = touched(engine, "SSSSS", positions)
    assert physics.contacts.floor.tolist() == [[True, False, False, False, False]]
    assert physics.contacts.wall.tolist() == [[False, True, True, True, False]]
    assert (physics.contacts.drone == -1).all()


def test_flags_are_those_of_the_last_step(engine: type[Physics]) -> None:
    physics = engine("SS", interactions="none")
    apart = hover_state(parse_team("SS"), [[0, 0, 1], [1, 0, 1]])
    close = hover_state(parse_team("SS"), [[0.0, 0, 1], [0.1, 0, 1]])
    physics.reset(close)
    physics.step(close.rotor_thrust)
    assert physics.contact.all()
    physics.reset(apart)
    assert not physics.contact.any()
    physics.step(apart.rotor_thrust)
    assert not physics.contact.any()
    physics.close()


@pytest.mark.skipif(not bullet_available(), reason="pybullet is not installed")
def test_bullet_pushes_colliding_drones_apart_and_floors_hold() -> None:
    physics = BulletPhysics("SS", interactions="none")
    state = hover_state(parse_team("SS"), [[0.0, 0, 1], [0.3, 0, 1]])
    state.velocity[0, 0, 0] = 1.0
    physics.reset(state)
    for _ in range(120):
        physics.step(state.rotor_thrust)
    assert physics.state.velocity[0, 1, 0] > 0.1
    for _ in range(480):
        physics.step(np.zeros((1, 2, 4)))
    assert (physics.state.position[0, :, 2] > 0.0).all()
    physics.close()


@pytest.mark.parametrize(("drones", "seed"), [(6, 20), (6, 22), (6, 24), (28, 3)])
def test_contacts_are_those_of_every_pair(drones: int, seed: int) -> None:
    """Few, which are compared each with each, and many: some touch, some nearly, some are far."""
    rng = np.random.default_rng(seed)
    team = parse_team("SL" * (drones // 2))
    radius = np.array([v.radius for v in team])
    positions = rng.uniform([-0.3, -0.3, 0.02], [0.3, 0.3, 0.5], (drones, 3))
    if drones > 6:
        positions = positions * [3.0, 1.5, 1.5]
        positions[5] = [30.0, 0.0, 1.0]
    physics = BatchPhysics(team, interactions="none")
    state = hover_state(team, positions)
    physics.reset(state)
    physics.step(state.rotor_thrust)
    apart = np.linalg.norm(positions[:, None] - positions, axis=-1)
    np.fill_diagonal(apart, np.inf)
    ratio = apart / (radius[:, None] + radius)
    seen = physics.contacts
    np.testing.assert_allclose(seen.separation[0], apart.min(axis=1), rtol=1e-12)
    np.testing.assert_allclose(seen.clearance[0], ratio.min(axis=1), rtol=1e-12)
    expected = np.where(ratio.min(axis=1) < 1.0, ratio.argmin(axis=1), -1)
    np.testing.assert_array_equal(seen.drone[0], expected)
    np.testing.assert_array_equal(seen.floor[0], positions[:, 2] < radius)
    assert 0 < np.count_nonzero(expected >= 0) < drones


def test_what_just_touches_is_no_collision() -> None:
    """Distances exactly equal to the radius of a drone, and to the sum of two."""
    r = SMALL.radius
    rows = obstacle_rows([Box((0.0, -0.5, 0.0), (0.4, 0.5, 1.5))])
    team = parse_team("SSS")
    physics = BatchPhysics(team, interactions="none", obstacles=rows)
    state = hover_state(team, [[-r, 0.0, 1.0], [2.0, 1.0, 1.0], [2.0, 1.0 + 2 * r, 1.0]])
    physics.reset(state)
    physics.step(state.rotor_thrust)
    assert physics.contacts.obstacle_clearance[0, 0] == 1.0
    assert physics.contacts.clearance[0, 1] == pytest.approx(1.0, abs=1e-15)
    assert not physics.contact[0, 0]
