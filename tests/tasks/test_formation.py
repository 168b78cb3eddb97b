"""Formations and rings: stages by the clock, assignments, and that nobody can collide."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from swarm_envs import formation_v1, ring_v1
from swarm_envs.agents import fly_episode
from swarm_envs.baselines.neural_swarm import TrackingAgent
from swarm_envs.envs.config import EnvConfig
from swarm_envs.envs.core import SwarmCore
from swarm_envs.envs.parallel import SwarmParallelEnv
from swarm_envs.state import FloatArray
from swarm_envs.tasks.base import Placement, TrackingSuccess, world_of
from swarm_envs.tasks.formation import CLOSEST, FormationTask
from swarm_envs.tasks.ring import (
    CLOSE_FIVE,
    CLOSE_SIXTEEN,
    RingLayout,
    RingTask,
    num_upright,
    perimeter,
    ring_team,
)
from swarm_envs.tasks.shapes import SHAPES, block_of, shape_points
from swarm_envs.vehicles import parse_team, team_string


def task_of(n: int = 9, **options: Any) -> FormationTask:
    return FormationTask(parse_team(n * "S"), **options)


def drawn(task: FormationTask, seed: int = 0) -> Placement:
    return task.place(np.random.default_rng(seed))


def same_points(a: np.ndarray, b: np.ndarray, within: float = 1e-9) -> bool:
    distance = np.linalg.norm(a[:, None] - b[None], axis=-1)
    return bool((distance.min(axis=1) < within).all() and (distance.min(axis=0) < within).all())


@pytest.mark.parametrize("labels", ["nearest", "random", "mirror"])
def test_every_stage_is_its_shape_turned(labels):
    shapes = ("plane", "pyramid", "cube", "sphere", "rings", "blocks")
    task = task_of(10, shapes=shapes, labels=labels)
    placement = drawn(task)
    assert placement.goals.shape == (5, 10, 3)
    corner = placement.start - task.arena.mean(axis=0)
    flat = shape_points("plane", 10, task.spacing)

    def off(angle: float) -> float:
        apart = np.linalg.norm(corner[:, None] - turned(flat, angle)[None], axis=-1)
        return float(apart.min(axis=1).max())

    angle = min(np.linspace(0.0, 2 * np.pi, 20_001), key=off)
    for name, points in zip(shapes, [placement.start, *placement.goals], strict=True):
        expected = turned(shape_points(name, 10, task.spacing), angle) + task.arena.mean(axis=0)
        assert same_points(points, expected, within=1e-3)


def turned(points: np.ndarray, angle: float) -> np.ndarray:
    out = points.copy()
    out[:, 0] = np.cos(angle) * points[:, 0] - np.sin(angle) * points[:, 1]
    out[:, 1] = np.sin(angle) * points[:, 0] + np.cos(angle) * points[:, 1]
    return out


@pytest.mark.parametrize("n", [1, 2, 7, 16, 30])
@pytest.mark.parametrize("start", ["shape", "ground"])
def test_straight_ways_to_the_nearest_places_do_not_meet(n, start):
    """Turpin et al. 2014: at spacing s they stay s / sqrt 2 apart."""
    shapes = ("plane", "pyramid", "cube", "sphere", "letter:R", "blocks", "plane")
    task = task_of(n, shapes=shapes, start=start)
    for seed in range(3):
        placement = drawn(task, seed)
        world = world_of(placement)
        for time in np.arange(0.0, task.episode_s, 0.1):
            position = task.reference(world, np.array([time])).position[0]
            distance = np.linalg.norm(position[:, None] - position[None], axis=-1)
            distance[np.eye(n, dtype=bool)] = np.inf
            assert distance.min() > task.spacing / np.sqrt(2) - 1e-9


def test_mirrored_places_are_the_point_reflections():
    task = task_of(16, shapes=("rings", "rings"), labels="mirror")
    placement = drawn(task)
    middle = task.arena.mean(axis=0)
    np.testing.assert_allclose(placement.goals[0] - middle, middle - placement.start, atol=1e-9)


def test_blocks_go_to_other_blocks_as_a_whole():
    task = task_of(18, shapes=("blocks", "blocks", "blocks"), labels="blocks")
    placement = drawn(task)
    for here, there in zip([placement.start, *placement.goals], placement.goals):
        assert same_points(here, there)
        move = there - here
        assert np.linalg.norm(move, axis=1).min() > 0.5
        apart = np.linalg.norm(here[:, None] - here, axis=-1)
        first, second = np.nonzero(np.triu(apart < 0.6, 1))
        assert len(first) == 9  # the two of each block
        np.testing.assert_allclose(move[first], move[second], atol=1e-9)
    assert block_of(18).tolist() == [k // 2 for k in range(18)]


def test_random_labels_are_drawn_anew():
    task = task_of(9, shapes=("plane", "plane"), labels="random")
    ways = {drawn(task, seed).goals.tobytes() for seed in range(5)}
    assert len(ways) == 5
    placement = drawn(task)
    assert same_points(placement.start, placement.goals[0])
    assert not np.allclose(placement.start, placement.goals[0])


def test_the_ground_is_level_and_low():
    placement = drawn(task_of(8, start="ground"))
    np.testing.assert_allclose(placement.start[:, 2], 0.15)
    assert len(placement.goals) == 5


@pytest.mark.parametrize("n", [1, 3, 16, 64, 200])
def test_any_number_of_drones_fits(n):
    for shapes in (tuple(SHAPES), ("letter:A", "letter:O")):
        task = task_of(n, shapes=shapes)
        placement = drawn(task)  # which is checked against the arena and for touching
        assert 0.17 <= task.spacing <= 0.5
        assert placement.goals.shape == (len(shapes) - 1, n, 3)


def test_stages_change_with_the_clock():
    task = task_of(2, shapes=("plane", "cube", "plane"), shape_s=0.5, travel_s=0.5)
    core = SwarmCore(task, EnvConfig(physics="batch", interactions="none", end_on_success=False))
    core.reset([1])
    goals, drones = core.world.goals[0].copy(), core.world.drones[0]
    for k in range(48):
        np.testing.assert_array_equal(drones["goal"], goals[int(k >= 24)])
        distance = np.linalg.norm(core.physics.state.position[0] - drones["goal"], axis=1)
        np.testing.assert_allclose(drones["distance"], distance)
        core.step(np.zeros((1, 2, 3)))
    assert not core.running.any()


def test_the_tracking_agent_flies_the_shapes():
    agent = TrackingAgent()
    env = formation_v1.parallel_env(num_drones=9, physics="batch", **agent.requires)
    shares: list[float] = []
    metrics = fly_episode(
        env, agent, 0, lambda env: shares.append(env.core.world.environments["achieved"][0])
    )
    assert metrics["success"]
    assert metrics["stages"] == metrics["stages_reached"] == 4
    assert [share for share in shares if share] == [0.25] * 4
    assert metrics["collided_drones"] == 0
    assert 18.0 < metrics["length_s"] < 24.0
    assert metrics["time_to_goal_s"] == pytest.approx(metrics["length_s"] - 0.5)


def test_a_missed_shape_is_no_success():
    """Too little time for the second shape; the flight goes on to the last."""
    agent = TrackingAgent()
    task = task_of(4, shapes=("plane", "letter:I", "letter:I"), shape_s=1.0, travel_s=1.0)
    env = SwarmParallelEnv(task, EnvConfig(physics="batch", **agent.requires))
    metrics = fly_episode(env, agent, 0)
    assert metrics["stages_reached"] == 1 and not metrics["success"]
    assert metrics["length_s"] == pytest.approx(2.0)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"shapes": ("plane", "sfere")}, r"unknown shape 'sfere'; did you mean 'sphere'"),
        ({"shapes": ("plane",)}, r"shapes are \('plane',\), but .* there must be at least 2"),
        ({"letters": "AB", "shapes": ("plane",)}, r"letters='AB' and shapes are given, but each"),
        ({"labels": "blocks"}, r"with labels='blocks' all must be 'blocks'; give shapes="),
        ({"travel_s": 7.0}, r"travel_s is 7.0, but must not exceed shape_s, 6.0"),
        ({"spacing_m": 0.1}, r"slots are 0.100 m apart, but must be at least 0.170 m"),
        ({"spacing_m": 2.0}, r"shape 'pyramid' of 9 drones 2.0 m apart does not fit .* spacing_m"),
    ],
)
def test_impossible_options(options, message):
    with pytest.raises(ValueError, match=message):
        formation_v1.parallel_env(physics="batch", **options)


def test_a_goal_is_refused():
    env = formation_v1.parallel_env(num_drones=2, physics="batch")
    with pytest.raises(ValueError, match=r"in formation goals are those of shapes="):
        env.reset(options={"goal": [[0, 0, 1], [1, 0, 1]]})
    env.reset(options={"start": [[0, 0, 1], [1, 0, 1]]})
    np.testing.assert_array_equal(env.view.state.position, [[0, 0, 1], [1, 0, 1]])
    assert pytest.approx(2.8284, abs=1e-4) == CLOSEST


G = 9.80665


def flown(task: RingTask, seed: int, times: FloatArray) -> list[FloatArray]:
    """Position, velocity, acceleration and jerk (T, N, 3) of the reference."""
    world = world_of(task.place(np.random.default_rng(seed)))
    rows = [[a[0] for a in task.reference(world, np.array([t]))] for t in times]
    return [np.array(column) for column in zip(*rows, strict=True)]


@pytest.mark.parametrize("team", ["5", "16", "S", "SL", "LLLLLLLL", "S*LLSSLSS*SSL", "S" * 40])
def test_references_never_come_close(team):
    """Over a period of the slowest ring, for several start phases: the sum of radii and 5 cm."""
    task = RingTask(ring_team(int(team)) if team.isdigit() else parse_team(team))
    reach = task.radius[:, None] + task.radius[None]
    for seed in range(3):
        position = flown(task, seed, np.arange(0.0, 13.0, 0.1))[0]
        distance = np.linalg.norm(position[:, :, None] - position[:, None], axis=-1)
        distance[:, np.eye(len(task.team), dtype=bool)] = np.inf
        assert (distance >= reach + 0.05).all()
        assert (position > task.arena[0] + task.radius[:, None]).all()
        assert (position < task.arena[1] - task.radius[:, None]).all()


@pytest.mark.parametrize("n", [*range(1, 34), 49, 64, 128, 256])
def test_any_number_of_drones_flies_around_the_ring(n):
    task = RingTask(ring_team(n))
    assert task.orbit.center.shape == (n, 3)
    assert len(task.place(np.random.default_rng(0)).start) == n


@pytest.mark.parametrize("n", [5, 16])
def test_thrust_is_far_from_its_limit(n):
    task = RingTask(ring_team(n))
    _, velocity, acceleration, _ = flown(task, 0, np.arange(0.0, 13.0, 0.1))
    needed = np.linalg.norm(acceleration + np.array([0.0, 0.0, G]), axis=-1) / G
    assert (needed < 0.75 * np.array([v.thrust_to_weight for v in task.team])).all()
    assert np.linalg.norm(velocity, axis=-1).max() < 1.0


def test_the_five_of_the_paper():
    """A small one is at its lowest when a large one is right above, at all times of the flight."""
    task = RingTask(ring_team(5))
    assert team_string(task.team) == "S*S*S*LL"
    position, velocity, *_ = flown(task, 4, np.arange(2.0, 12.0, 0.01))
    small, large = position[:, :3], position[:, 3:]
    assert np.ptp(large[..., 2]) == pytest.approx(0.0, abs=1e-12)
    assert np.ptp(small[..., 1]) == pytest.approx(0.0, abs=1e-12)
    np.testing.assert_allclose(np.linalg.norm(velocity, axis=-1), 0.65)
    lowest = np.argmin(small[..., 2], axis=0)
    below = small[lowest, range(3), :2]
    assert np.linalg.norm(large[lowest, :, :2] - below[:, None], axis=-1).min() < 0.01
    assert small[..., 2].min() == pytest.approx(1.2 - 0.55, abs=1e-3)


def test_the_sixteen_of_the_paper():
    task = RingTask(ring_team(16))
    assert sorted(team_string([v]) for v in task.team) == ["L"] * 2 + ["S"] * 4 + ["S*"] * 10
    level = np.flatnonzero(task.orbit.first[:, 2] == 0.0)
    assert [task.team[i].token for i in level] == ["L", "S", "S", "L", "S", "S"]
    np.testing.assert_allclose(task.orbit.first[level], [[1.0, 0.0, 0.0]] * 6)
    np.testing.assert_allclose(task.orbit.second[level], [[0.0, 0.6, 0.0]] * 6)
    upright = np.setdiff1d(np.arange(16), level)
    tips, counts = np.unique(task.orbit.center[upright, 0].round(9), return_counts=True)
    assert tips.tolist() == [-1.0, 1.0]
    assert counts.tolist() == [5, 5]
    position = flown(task, 0, np.arange(2.0, 2.0 + perimeter(1.0, 0.6) / 0.5, 0.005))[0]
    way = np.linalg.norm(np.diff(position, axis=0), axis=-1).sum(axis=0)
    np.testing.assert_allclose(way[level], perimeter(1.0, 0.6), rtol=1e-3)  # once round, at 0.5 m/s


@pytest.mark.parametrize(("n", "upright"), [(1, 1), (2, 1), (5, 3), (8, 5), (9, 5), (16, 10)])
def test_share_of_upright_rings(n, upright):
    assert num_upright(n) == upright
    team = "S*" * upright + "S" * (n - upright)
    task = RingTask(parse_team(team))
    stands = task.orbit.first[:, 2] != 0.0
    assert stands.tolist() == [v.token == "S*" for v in task.team]


def test_starts_on_the_rings_at_rest_and_ramps_up():
    task = RingTask(ring_team(5))
    starts = []
    for seed in range(20):
        placement = task.place(np.random.default_rng(seed))
        position, velocity, acceleration, jerk = flown(task, seed, np.array([0.0, 1.0, 2.0, 5.0]))
        np.testing.assert_array_equal(position[0], placement.start)
        for derivative in (velocity, acceleration, jerk):
            assert not derivative[0].any()
        speed = np.linalg.norm(velocity, axis=-1)
        np.testing.assert_allclose(speed[1], 0.65 / 2)
        np.testing.assert_allclose(speed[2:], 0.65)
        starts.append(placement.start)
    assert len({s.tobytes() for s in starts}) == 20


def test_a_fixed_lead_fixes_the_start():
    layout = RingLayout((0.6, 0.6), 0.6, 0.5, lead_s=(0.0, 0.0), phases_rad=(0.0, np.pi))
    task = RingTask(parse_team("S*L"), rings=layout)
    for seed in range(3):
        start = task.place(np.random.default_rng(seed)).start
        tip = task.orbit.center[0]
        np.testing.assert_allclose(start[0] - tip, [0, 0, 0.6], atol=1e-9)  # half a turn on: on top
        np.testing.assert_allclose(start[1], tip, atol=1e-9)


def test_errors_of_the_start_up_do_not_count():
    """Drones that start 0.2 m above their rings: errors count once they had time to catch up."""
    agent = TrackingAgent()
    env = ring_v1.parallel_env(interactions="none", physics="batch", **agent.requires)
    env.reset(seed=3)
    start = env.view.state.position + np.array([0.0, 0.0, 0.2])
    errors = []

    def watch(env: Any) -> None:
        view = env.view
        np.testing.assert_array_equal(view.goals, view.reference(view.time).position)
        errors.append(np.linalg.norm(view.state.position - view.goals, axis=1))

    metrics = fly_episode(env, agent, 3, watch, options={"start": start})
    counted = np.array(errors)[96:]  # from 2 s on, at 48 decisions a second
    assert np.max(errors[0]) > 0.15
    assert metrics["worst_tracking_error_m"] == pytest.approx(counted.max())
    assert metrics["rms_tracking_error_m"] == pytest.approx(np.sqrt(np.mean(counted**2)))
    assert metrics["success"] == (counted.max() < 0.15)


def test_success_comes_with_the_clock_and_needs_the_tracking():
    for worst, expected in ((0.15, True), (1e-3, False)):
        task = RingTask(ring_team(5), success=TrackingSuccess(worst, 0.5), scored_s=1.0)
        agent = TrackingAgent()
        env = SwarmParallelEnv(task, EnvConfig(physics="batch", **agent.requires))
        observations, _ = env.reset(seed=1)
        agent.reset(env, 1)
        given = 0.0
        while env.agents:
            actions = agent.act(observations, env.view)
            observations, _, terminated, truncated, infos = env.step(actions)
            given += infos["drone_0"]["reward_terms"]["success"]
        assert all(truncated.values()) and not any(terminated.values())
        assert infos["drone_0"]["episode_metrics"]["success"] == expected
        assert infos["drone_0"]["episode_metrics"]["length_s"] == pytest.approx(1.5)
        assert given == float(expected)


@pytest.mark.parametrize(
    ("team", "layout", "message"),
    [
        ("S" * 8, RingLayout((0.05, 0.05), 0.5, 0.5), r"drones \d and \d of a group come within"),
        ("SSSSS", RingLayout((0.6, 0.6), 0.3, 0.5, height_m=0.3), r"leave the arena"),
        ("SSSSS", RingLayout((0.6, 0.6), 0.6, 3.0), r"drone 0 would accelerate at 15.00"),
        ("S" * 200, RingLayout((1.5, 1.5), 0.5, 0.5), r"13 groups of up to 16 drones do not fit"),
    ],
)
def test_impossible_rings(team, layout, message):
    with pytest.raises(ValueError, match=message):
        RingTask(parse_team(team), rings=layout)


def test_a_goal_is_refused_and_changes_nothing():
    env = ring_v1.parallel_env(physics="batch")
    env.reset(seed=1)
    state = env.core.generators[0].bit_generator.state
    goal = env.view.state.position + 0.0
    with pytest.raises(ValueError, match="in ring goals are the positions of the reference; leave"):
        env.reset(options={"goal": goal})
    assert env.core.generators[0].bit_generator.state == state


@pytest.mark.parametrize(("layout", "drones"), [(CLOSE_FIVE, 5), (CLOSE_SIXTEEN, 16)])
def test_close_rings_are_those_that_the_authors_flew(layout, drones):
    orbit = RingTask(ring_team(drones), rings=layout).orbit
    assert 2.0 * np.pi / orbit.rate == pytest.approx(np.full(drones, 5.0), rel=0.01)  # s a turn
    places = [orbit.at(orbit.phase + orbit.rate * t) for t in np.arange(0.0, 5.0, 0.01)]
    first, second = np.triu_indices(drones, 1)
    apart = np.array([np.linalg.norm(p[first] - p[second], axis=-1).min() for p in places])
    if drones == 16:
        assert apart.min() == pytest.approx(0.26, abs=0.005)  # theirs: 0.254
    assert apart.min() > 0.23


def test_upright_rings_may_have_a_speed_of_their_own():
    team = ring_team(5)
    same = RingTask(team, rings=RingLayout((0.6, 0.6), 0.6, 0.5)).orbit
    own = RingTask(team, rings=RingLayout((0.6, 0.6), 0.6, 0.5, upright_speed_m_s=0.25)).orbit
    assert own.rate / same.rate == pytest.approx([0.5, 0.5, 0.5, 1.0, 1.0])
