"""Obstacles: distances against plain geometry, contact on both engines, starts free of them."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import swarm_envs
from swarm_envs import swap_v1
from swarm_envs.physics import BatchPhysics, BulletPhysics, bullet_available
from swarm_envs.physics.contact import nearest_point
from swarm_envs.state import hover_state
from swarm_envs.tasks.obstacles import Box, Column, buildings, obstacle_distances, obstacle_rows
from swarm_envs.vehicles import SMALL, parse_team

BLOCK = Box((0.0, -0.5, 0.0), (0.4, 0.5, 1.5))
POST = Column((1.0, 0.5), 0.2, 2.0)
coordinate = st.floats(-3.0, 3.0)


@given(coordinate, coordinate, coordinate)
def test_nearest_points(x, y, z):
    """Of a box: the point, clipped to it. Of a column: on the disc and between its ends."""
    point = np.array([x, y, z])
    to_box = np.array(nearest_point(obstacle_rows([BLOCK]), 0, x, y, z))
    np.testing.assert_allclose(point + to_box, np.clip(point, BLOCK.low, BLOCK.high), atol=1e-12)
    to_post = np.array(nearest_point(obstacle_rows([POST]), 0, x, y, z))
    axis = np.array(POST.center)
    away = point[:2] - axis
    length = np.linalg.norm(away)
    rim = axis + away * min(1.0, POST.radius / max(float(length), 1e-300))
    expected = [*rim, np.clip(z, 0.0, POST.height)]
    np.testing.assert_allclose(point + to_post, expected, atol=1e-9)


def test_distances_of_many_points():
    rows = obstacle_rows([BLOCK, POST])
    points = np.array([[[1.4, 0.0, 1.0], [0.2, 0.0, 1.0]], [[0.4, 0.5, 2.0], [1.0, 0.5, 2.5]]])
    expected = [[[1.0, np.hypot(0.4, 0.5) - 0.2], [0.0, np.hypot(0.8, 0.5) - 0.2]]]
    expected += [[[0.5, 0.4], [np.hypot(0.6, 1.0), 0.5]]]
    np.testing.assert_allclose(obstacle_distances(rows, points), expected)
    assert obstacle_distances(obstacle_rows([]), points).shape == (2, 2, 0)


def test_contacts_name_the_obstacle(engine):
    make = BulletPhysics if engine == "bullet" else BatchPhysics
    rows, r = obstacle_rows([BLOCK, POST]), SMALL.radius
    points = [[-r - 1e-3, 0, 1], [-r + 1e-3, 0.3, 1]]
    points += [[1.2 + 0.9 * r, 0.5, 1], [0.2, 0, 1.5 + 2 * r]]
    physics = make("SSSS", interactions="none", obstacles=rows)
    state = hover_state(parse_team("SSSS"), points)
    physics.reset(state)
    physics.step(state.rotor_thrust)
    assert physics.contacts.obstacle.tolist() == [[-1, 0, 1, -1]]
    assert physics.contact.tolist() == [[False, True, True, False]]
    clearance = [1 + 1e-3 / r, 1 - 1e-3 / r, 0.9, 2.0]
    np.testing.assert_allclose(physics.contacts.obstacle_clearance[0], clearance, atol=1e-2)
    physics.close()


@pytest.mark.skipif(not bullet_available(), reason="pybullet is not installed")
def test_bullet_is_stopped_by_what_stands_there():
    for obstacle in (BLOCK, Column((0.2, 0.0), 0.2, 2.0)):
        physics = BulletPhysics("S", interactions="none", obstacles=obstacle_rows([obstacle]))
        state = hover_state(parse_team("S"), [[-0.3, 0.0, 1.0]])
        state.velocity[0, 0, 0] = 2.0
        physics.reset(state)
        for _ in range(120):
            physics.step(state.rotor_thrust)
        assert physics.state.position[0, 0, 0] < 0.0
        physics.close()


def test_hitting_one_ends_the_episode():
    env = swap_v1.parallel_env(num_drones=2, physics="batch", obstacles=(POST, BLOCK))
    start = [[-0.5, 0.0, 1.0], [-1.5, -1.5, 1.0]]
    env.reset(seed=0, options={"start": start, "goal": [[1.5, 1.5, 1.0], [-1.0, -1.0, 1.0]]})
    proximity = 0.0
    while env.agents:
        actions = {"drone_0": [1.0, 0.0, 0.0], "drone_1": [0.0, 0.0, 0.0]}
        _, _, terminated, _, infos = env.step(actions)
        proximity = max(proximity, infos["drone_0"]["reward_terms"]["proximity"])
    assert all(terminated.values())
    assert [info.get("contact") for info in infos.values()] == [{"obstacle": 1}, None]
    assert [info["reward_terms"]["crash"] for info in infos.values()] == [1.0, 0.0]
    assert proximity == pytest.approx(1 / 48)
    metrics = infos["drone_0"]["episode_metrics"]
    assert metrics["collided_obstacle"] == 1
    assert metrics["collided_drones"] == metrics["collided_wall"] == 0
    assert 0.0 < metrics["minimum_obstacle_distance_m"] < SMALL.radius


@pytest.mark.parametrize("places", [1, 2, 3, 4])
def test_the_nearest_are_observed(places):
    obstacles = (POST, BLOCK, Column((-1.5, 1.5), 0.1))
    env = swap_v1.parallel_env(
        num_drones=3, physics="batch", obstacles=obstacles, num_obstacles=places
    )
    where, rows = {f.name: f.where for f in env.observation_layout}, obstacle_rows(obstacles)
    for seed in range(5):
        observations, _ = env.reset(seed=seed)
        for position, row in zip(env.view.state.position, observations.values(), strict=True):
            offsets = [np.array(nearest_point(rows, k, *position)) for k in range(3)]
            offsets.sort(key=lambda offset: float(np.linalg.norm(offset)))
            offsets.append(np.zeros(3))  # no fourth
            for k in range(places):
                seen = row[where[f"obstacle_{k}.offset"]]
                np.testing.assert_allclose(seen, offsets[k], atol=1e-6)
                assert row[where[f"obstacle_{k}.mask"]] == float(k < 3)


def test_observation_rows_grow_only_where_there_are_obstacles():
    def width(**options: Any) -> int:
        env = swap_v1.parallel_env(physics="batch", **options)
        stop = env.observation_layout[-1].where.stop
        assert env.observation_space("drone_0").shape == (stop,)
        return stop

    bare = width()
    assert width(num_obstacles=2) == bare + 8  # masked: for policies that also fly among obstacles
    assert width(obstacles=(POST,)) == bare + 12
    assert width(obstacles=(POST,), num_obstacles=0) == bare


@pytest.mark.parametrize(
    ("task", "options"),
    [
        ("swap_v1", {"num_drones": 4, "obstacles": buildings(2, 2)}),
        ("swap_v1", {"num_drones": 4, "layout": "circle", "obstacles": (Column((0, 0), 0.4),)}),
        ("swap_v1", {"num_drones": 6, "layout": "circle", "obstacles": (Column((1.5, 0), 0.2),)}),
        ("swap_v1", {"team": "LS", "layout": "stacked", "obstacles": (Column((0.8, 0), 0.1),)}),
        ("ring_v1", {"obstacles": (Column((0.0, 1.5), 0.3), Box((-2, -2, 0), (-1, -1, 1)))}),
        ("formation_v1", {"num_drones": 4, "obstacles": (Column((1.0, 0.0), 0.1),)}),
    ],
)  # fmt: skip
def test_what_is_drawn_is_free(task, options):
    env = swarm_envs.make(task, physics="batch", **options)
    rows, radius = env.core.task.obstacle_rows, env.core.task.radius
    for seed in range(5):
        env.reset(seed=seed)
        view = env.view
        points = [view.state.position, *env.core.world.goals[0]]
        if env.core.task.motion.kind:
            times = np.arange(0.0, env.core.task.episode_s, 0.02)
            points += [view.reference(t).position for t in times]
        for place in points:
            assert (obstacle_distances(rows, place) > radius[:, None] + 0.14).all()


@pytest.mark.parametrize(
    ("task", "options", "message"),
    [
        ("swap_v1", {"layout": "stacked", "team": "LS"}, r"the reference of drone \d is 0.\d+ m"),
        ("ring_v1", {}, r"found no ring_v1 free of the obstacles within 5 draws"),
        ("formation_v1", {}, r"the start of drone \d is .* from obstacle 0, but must keep 0.21"),
    ],
)  # fmt: skip
def test_searches_that_fail_say_why(task, options, message, monkeypatch):
    monkeypatch.setattr("swarm_envs.tasks.base._DRAWS", 5)
    env = swarm_envs.make(task, physics="batch", obstacles=(Column((0, 0), 0.2),), **options)
    with pytest.raises(RuntimeError, match=message):
        env.reset(seed=0)


def test_an_overfull_arena_raises():
    env = swap_v1.parallel_env(physics="batch", obstacles=(Box((-2, -2, 0), (2, 2, 2.4)),))
    with pytest.raises(RuntimeError, match=r"found room for 0 of 4 drones .* or smaller obst"):
        env.reset(seed=0)


def test_given_points_inside_are_refused():
    env = swap_v1.parallel_env(num_drones=2, physics="batch", obstacles=(POST, BLOCK))
    env.reset(seed=0)
    good = [[-1.0, 0.0, 1.0], [-1.0, 1.0, 1.0]]
    state = env.core.generators[0].bit_generator.state
    for name in ("start", "goal"):
        points = [[-0.02, 0.0, 1.0], [-1.0, 1.0, 1.0]]
        message = rf"the {name} of drone 0 is 0.020 m from obstacle 1, but must keep 0.060 m"
        with pytest.raises(ValueError, match=message):
            env.reset(options={"start": good, "goal": good} | {name: points})
    assert env.core.generators[0].bit_generator.state == state
    near = [[-0.1, 0.0, 1.0], [-1.0, 1.0, 1.0]]  # nearer than anything drawn, but free
    env.reset(options={"start": near, "goal": good})
    np.testing.assert_array_equal(env.view.state.position, near)


def test_buildings_stand_on_a_grid():
    towers = buildings(3, 2, spacing=1.0, width=0.3, height=2.0, center=(0.5, 0.0))
    centers = [tuple((a + b) / 2 for a, b in zip(t.low, t.high, strict=True)) for t in towers]
    expected = [(x, y, 1.0) for x in (-0.5, 0.5, 1.5) for y in (-0.5, 0.5)]
    np.testing.assert_allclose(centers, expected)
    sizes = [np.subtract(t.high, t.low) for t in towers]
    np.testing.assert_allclose(sizes, [[0.3, 0.3, 2.0]] * 6)


@pytest.mark.parametrize(
    ("call", "error", "message"),
    [
        (lambda: Box((0, 0, 0), (1, 0, 1)), ValueError, r"Box.low is .* of low must be smaller"),
        (lambda: Box((0, 0), (1, 1)), ValueError, r"Box.low has shape \(2,\)"),  # type: ignore[arg-type]
        (lambda: Column((0, np.nan), 0.1), ValueError, r"Column.center is nan"),
        (lambda: buildings(0, 2), ValueError, r"columns is 0, but must be an integer"),
        (lambda: buildings(2, 2, spacing=0.3), ValueError, r"0 < width < spacing"),
        (lambda: swarm_envs.make("swap_v1", obstacles=[1]), TypeError, "obstacles hold 1, but"),
        (lambda: swarm_envs.make("swap_v1", obstacles="column=2.3:0:0.2"), ValueError, "no obst"),
        (lambda: swarm_envs.make("swap_v1", obstacles="box=0:0:2.6:1:1:3"), ValueError, "outside"),
    ],
)  # fmt: skip
def test_impossible_obstacles(call, error, message):
    with pytest.raises(error, match=message):
        call()
