"""Contacts on both engines, and drones that bounce: momentum and restitution."""

from __future__ import annotations

import numpy as np
import pytest

from swarm_envs.envs.core import SwarmCore
from swarm_envs.physics import BatchPhysics, BulletPhysics, bullet_available
from swarm_envs.physics.contact import RESTITUTION, bounce
from swarm_envs.state import hover_state
from swarm_envs.swap_v1 import blueprint
from swarm_envs.tables import BLOCK_TYPE, LANES, SETTINGS_TYPE, aligned
from swarm_envs.tasks.obstacles import Box, obstacle_rows
from swarm_envs.vehicles import LARGE, SMALL, parse_team

ARENA = [[-2.0, -2.0, 0.0], [2.0, 2.0, 2.5]]


def flown(engine, team, positions, velocity=0.0, steps=1, **options):
    """The engine after some steps at the thrust of hover."""
    physics = engine(team, interactions="none", **{"arena": ARENA, **options})
    state = hover_state(physics.team, positions)
    state.velocity[0] = velocity
    physics.reset(state)
    for _ in range(steps):
        physics.step(state.rotor_thrust)
    physics.close()
    return physics


def test_drones_touch_below_the_sum_of_radii(engine):
    reach = SMALL.radius + LARGE.radius
    near = flown(engine, "SLS", [[0, 0, 1], [reach - 1e-3, 0, 1], [0, 1, 1]])
    assert near.contacts.drone.tolist() == [[1, 0, -1]]
    assert near.contact.tolist() == [[True, True, False]]
    far = flown(engine, "SLS", [[0, 0, 1], [reach + 1e-3, 0, 1], [0, 1, 1]])
    assert not far.contact.any()
    assert far.contacts.separation[0, 0] == pytest.approx(reach + 1e-3)
    assert far.contacts.clearance[0, 0] == pytest.approx((reach + 1e-3) / reach)


def test_floor_wall_and_ceiling(engine):
    sides = [[1.95, 0, 1], [-1.95, 0, 1], [0.0, 1.95, 1], [0.0, -1.95, 1], [0.0, 0, 2.46]]
    positions = [[0.0, 0, 0.05], *sides, [1.0, 1, 0.07]]
    physics = flown(engine, "SSSSSSS", positions)
    assert physics.contacts.floor.tolist() == [[True, *6 * [False]]]
    assert physics.contacts.wall.tolist() == [[False, *5 * [True], False]]
    assert (physics.contacts.drone == -1).all()


def test_flags_are_those_of_the_last_step(engine):
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
    seen = flown(BatchPhysics, team, positions, arena=None).contacts
    apart = np.linalg.norm(positions[:, None] - positions, axis=-1)
    np.fill_diagonal(apart, np.inf)
    ratio = apart / (radius[:, None] + radius)
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
    places = [[-r, 0.0, 1.0], [2.0, 1.0, 1.0], [2.0, 1.0 + 2 * r, 1.0]]
    physics = flown(BatchPhysics, "SSS", places, arena=None, obstacles=rows)
    assert physics.contacts.obstacle_clearance[0, 0] == 1.0
    assert physics.contacts.clearance[0, 1] == pytest.approx(1.0, abs=1e-15)
    assert not physics.contact[0, 0]
    x, y, z = 0.75, -0.5, 1.0
    walls = [[x - r, y - r, 0.0], [x + r, y + r, z + r]]
    assert not flown(BatchPhysics, "S", [[x, y, z]], arena=walls).contacts.wall.any()


@pytest.mark.parametrize("drones", [4, 28])
def test_of_those_that_are_equally_near_the_first_is_touched(drones: int) -> None:
    """Few, and many; places are binary fractions, so that distances are equal to the last bit."""
    step, near = 1.5 * SMALL.radius, 0.09375
    positions = np.stack([np.arange(drones) * 4 * step, np.ones(drones), np.ones(drones)], axis=1)
    positions[[1, 2, 3]] = [[near, 1, 1], [0, 1 + near, 1], [-near, 1, 1]]
    for order, center, first in ((1, 0, 1), (-1, drones - 1, drones - 4)):
        physics = flown(BatchPhysics, drones * "S", positions[::order], arena=None)
        assert physics.contacts.drone[0, center] == first


def test_two_drones_keep_their_momentum(engine):
    position = np.array([[-0.3, 0.02, 1.0], [0.3, -0.02, 1.03]])
    velocity = np.array([[1.0, 0.0, 0.0], [-0.5, 0.1, 0.0]])
    after = flown(engine, "SL", position, velocity, 120, on_contact="bounce").state
    mass = np.array([[SMALL.mass], [LARGE.mass]])
    kept = (mass * after.velocity[0]).sum(0)
    np.testing.assert_allclose(kept, (mass * velocity).sum(0), atol=1e-9)
    change = after.velocity[0, 0] - velocity[0]
    n = change / np.linalg.norm(change)  # without friction: the normal of the contact
    before, parting = ((v[0] - v[1]) @ n for v in (velocity, after.velocity[0]))
    assert before < -1.0
    assert parting == pytest.approx(-RESTITUTION * before, abs=1e-9)
    assert not after.angular_velocity.any()


def test_walls_floor_and_ceiling_give_back_a_part(engine):
    position = np.array([[1.5, 0, 1.0], [0, -1.5, 1.0], [0, 0, 0.5], [0, 0.5, 2.2]])
    velocity = np.array([[1.0, 0.2, 0], [0, -1.0, 0.2], [0.2, 0, -1.0], [0, 0.2, 1.0]])
    after = flown(engine, "SSSS", position, velocity, 144, on_contact="bounce").state
    expected = np.where(abs(velocity) == 1.0, -RESTITUTION * velocity, velocity)
    np.testing.assert_allclose(after.velocity[0], expected, atol=1e-9)


def test_what_lies_on_the_floor_stays_there(engine):
    physics = engine("S", interactions="none", arena=ARENA, on_contact="bounce")
    physics.reset(hover_state(physics.team, [[0.0, 0.0, 0.3]]))
    for _ in range(600):
        physics.step(np.zeros((1, 1, 4)))
    assert physics.state.position[0, 0, 2] == pytest.approx(SMALL.radius, abs=1e-3)
    assert physics.contacts.floor.all()
    physics.close()


def bounced(positions, velocities, mass=1.0, radius=0.125, rows=None, touching=()):
    """Positions and velocities after a bounce in walls at -8 and 8 m: plain Python runs it."""
    drones = len(positions)
    blocks, settings = aligned(-(-drones // LANES), BLOCK_TYPE), np.zeros(1, SETTINGS_TYPE)
    settings["arena"] = [[-8, -8, -8], [8, 8, 8]]
    touched = np.where(np.isin(np.arange(drones), touching), 0.0, -1.0)
    given = {"position": positions, "velocity": velocities, "touched_drone": touched}
    given |= {"mass": np.broadcast_to(mass, drones), "radius": np.full(drones, radius)}
    for name, values in given.items():
        lanes = np.zeros((len(blocks) * LANES, *np.shape(values)[1:]))
        lanes[:drones] = values
        lanes = lanes.reshape(-1, LANES, *lanes.shape[1:])
        blocks[name] = np.moveaxis(lanes, 1, -1)
    obstacles = np.zeros((0, 7)) if rows is None else rows
    bounce(blocks, 0, drones, settings.view(np.recarray), obstacles)
    found = (blocks[name].transpose(0, 2, 1) for name in ("position", "velocity"))
    return [part.reshape(-1, 3)[:drones] for part in found]


def test_an_obstacle_gives_back_a_part() -> None:
    """A sphere meets the edge of a box at 45 degrees."""
    rows = obstacle_rows((Box(low=(0.0, -1.0, 0.0), high=(1.0, 1.0, 1.0)),))
    place, speed = bounced([[-0.06, 0.0, 1.06]], [[1.0, 0.5, 0.0]], rows=rows)
    n = np.array([-1.0, 0.0, 1.0]) / np.sqrt(2.0)
    expected = np.array([1.0, 0.5, 0.0]) + (1 + RESTITUTION) * np.sqrt(0.5) * n
    np.testing.assert_allclose(speed[0], expected, atol=1e-12)
    np.testing.assert_allclose(place[0], 0.125 * n + [0.0, 0.0, 1.0], atol=1e-12)
    touching, towards = [[-0.125, 0.0, 0.5]], [[1.0, 0.0, 0.0]]
    place, speed = bounced(touching, towards, rows=rows)
    assert place.tolist() == touching and speed.tolist() == towards


def test_a_drone_inside_an_obstacle_goes_back_as_it_came() -> None:
    rows = obstacle_rows((Box(low=(-1.0, -1.0, -1.0), high=(1.0, 1.0, 1.0)),))
    velocity = np.array([0.3, -0.4, 1.2])  # of 1.3 m/s
    place, speed = bounced([[0.0, 0.0, 0.5]], [velocity], rows=rows)
    np.testing.assert_allclose(speed[0], -RESTITUTION * velocity, atol=1e-12)
    back = np.array([0.0, 0.0, 0.5]) - 0.125 * velocity / 1.3
    np.testing.assert_allclose(place[0], back, atol=1e-12)


def test_what_overlaps_a_wall_is_put_beside_it() -> None:
    beyond, expected = np.full((6, 3), 4.0), np.full((6, 3), 4.0)
    for axis, low in enumerate((-7.875, -7.875, 0.125)):  # the floor is the ground at z = 0
        beyond[axis, axis], expected[axis, axis] = low - 0.05, low
        beyond[axis + 3, axis], expected[axis + 3, axis] = 7.95, 7.875
    place, speed = bounced(beyond, np.zeros((6, 3)))
    np.testing.assert_array_equal(place, expected)
    assert not speed.any()


@pytest.mark.parametrize("first", [0, LANES])
def test_two_that_overlap_part_by_their_masses(first: int) -> None:
    """Drones of the first block, or of the second behind a full one."""
    positions = np.array([[0.0, 0.0, 1.0 + 0.5 * i] for i in range(first)] + 2 * [[3.0, 0.0, 1.0]])
    positions[-1] += [0.15, 0.0, 0.0]
    velocities, mass = np.zeros_like(positions), np.ones(first + 2)
    velocities[-2], mass[-1] = [0.6, 0.2, 0.0], 3.0
    place, speed = bounced(positions, velocities, mass, touching=(first, first + 1))
    np.testing.assert_array_equal(place[:first], positions[:first])
    assert place[-1, 0] - place[-2, 0] == pytest.approx(0.25, abs=1e-12)
    for before, after in ((positions, place), (velocities, speed)):
        np.testing.assert_allclose(mass @ after, mass @ before, atol=1e-12)
    assert speed[-1, 0] - speed[-2, 0] == pytest.approx(RESTITUTION * 0.6, abs=1e-12)
    assert speed[-2, 1] == 0.2


def test_two_at_one_place_part_upwards_and_two_that_just_touch_do_not_bounce() -> None:
    same = [[0.0, 0.0, 1.0], [0.0, 0.0, 1.0]]
    place, speed = bounced(same, np.zeros((2, 3)), touching=(0, 1))
    np.testing.assert_allclose(place, [[0.0, 0.0, 1.125], [0.0, 0.0, 0.875]], atol=1e-12)
    assert not speed.any()
    near, towards = [[0.0, 0.0, 1.0], [0.25, 0.0, 1.0]], [[1.0, 0.0, 0.0], [0.0, 0.0, 0.0]]
    place, speed = bounced(near, towards, touching=(0, 1))
    np.testing.assert_array_equal(place, near)
    np.testing.assert_array_equal(speed, towards)


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
