"""Formations: stages by the clock, who goes where, and that straight ways do not meet."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from swarm_envs import formation_v0
from swarm_envs.agents import fly_episode
from swarm_envs.baselines.neural_swarm import TrackingAgent
from swarm_envs.envs.config import EnvConfig
from swarm_envs.envs.core import SwarmCore
from swarm_envs.envs.parallel import SwarmParallelEnv
from swarm_envs.tasks.base import Placement, world_of
from swarm_envs.tasks.formation import CLOSEST, FormationTask, nearest_places
from swarm_envs.tasks.shapes import SHAPES, block_of, shape_points
from swarm_envs.vehicles import parse_team


def task_of(n: int = 9, **options: Any) -> FormationTask:
    return FormationTask(parse_team(n * "S"), **options)


def drawn(task: FormationTask, seed: int = 0) -> Placement:
    return task.place(np.random.default_rng(seed))


def same_points(a: np.ndarray, b: np.ndarray) -> bool:
    distance = np.linalg.norm(a[:, None] - b[None], axis=-1)
    return bool((distance.min(axis=1) < 1e-9).all() and (distance.min(axis=0) < 1e-9).all())


@pytest.mark.parametrize("labels", ["nearest", "random", "mirror"])
def test_every_stage_is_its_shape_turned(labels):
    shapes = ("plane", "pyramid", "cube", "sphere", "rings", "blocks")
    task = task_of(10, shapes=shapes, labels=labels)
    placement = drawn(task)
    assert placement.goals.shape == (5, 10, 3)
    corner = placement.start - task.arena.mean(axis=0)
    flat = shape_points("plane", 10, task.spacing)
    angle = min(
        np.linspace(0.0, 2 * np.pi, 20_001),
        key=lambda a: (
            np.linalg.norm(corner[:, None] - turned(flat, a)[None], axis=-1).min(axis=1).max()
        ),
    )
    for name, points in zip(shapes, [placement.start, *placement.goals], strict=True):
        expected = turned(shape_points(name, 10, task.spacing), angle) + task.arena.mean(axis=0)
        distance = np.linalg.norm(points[:, None] - expected[None], axis=-1)
        assert distance.min(axis=1).max() < 1e-3
        assert distance.min(axis=0).max() < 1e-3


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


def test_nearest_places_are_the_best_match():
    rng = np.random.default_rng(0)
    wanted, places = rng.normal(size=(2, 5, 3))
    ours = nearest_places(wanted, places)
    assert sorted(ours) == list(range(5))
    least = np.square(wanted - places[ours]).sum()
    for _ in range(200):
        assert least <= np.square(wanted - places[rng.permutation(5)]).sum() + 1e-12


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
        pairs = [
            (i, j) for i in range(18) for j in range(i) if np.linalg.norm(here[i] - here[j]) < 0.6
        ]
        assert len(pairs) == 9  # the two of each block
        for i, j in pairs:
            np.testing.assert_allclose(move[i], move[j], atol=1e-9)
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
    env = formation_v0.parallel_env(num_drones=9, physics="batch", **agent.requires)
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
    assert metrics["stages_reached"] == 1
    assert not metrics["success"]
    assert metrics["length_s"] == pytest.approx(2.0)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"shapes": ("plane", "sfere")}, r"unknown shape 'sfere'; did you mean 'sphere'"),
        ({"shapes": ("plane",)}, r"shapes are \('plane',\), but must be at least 2"),
        ({"labels": "blocks"}, r"labels='blocks' needs shapes=\('blocks', ...\)"),
        ({"travel_s": 7.0}, r"travel_s is 7.0, but must not exceed shape_s, 6.0"),
        ({"spacing_m": 0.1}, r"places are 0.100 m apart, but must be 0.170 m apart"),
        ({"spacing_m": 2.0}, r"shape 'pyramid' of 9 drones 2.0 m apart does not fit .* spacing_m"),
    ],
)
def test_impossible_options(options, message):
    with pytest.raises(ValueError, match=message):
        formation_v0.parallel_env(physics="batch", **options)


def test_a_goal_is_refused():
    env = formation_v0.parallel_env(num_drones=2, physics="batch")
    with pytest.raises(ValueError, match=r"in formation goals are those of shapes="):
        env.reset(options={"goal": [[0, 0, 1], [1, 0, 1]]})
    env.reset(options={"start": [[0, 0, 1], [1, 0, 1]]})
    np.testing.assert_array_equal(env.view.state.position, [[0, 0, 1], [1, 0, 1]])
    assert pytest.approx(2.8284, abs=1e-4) == CLOSEST
