"""Static obstacles: half-spaces with all of an obstacle behind, and flights around it."""

from __future__ import annotations

import numpy as np
import pytest

from swarm_envs.baselines.mlr_dmpc.avoidance_planes import obstacle_planes
from swarm_envs.baselines.mlr_dmpc.mlr_dmpc_config import MlrDmpcConfig
from swarm_envs.baselines.mlr_dmpc.swarm import MlrDmpcSwarm, SwarmRound
from swarm_envs.baselines.mlr_dmpc.trajectory import hover, sampled_positions
from swarm_envs.tasks.obstacles import Box, Column, obstacle_distances, obstacle_rows
from tests.helpers.mlr_rounds import arrival_time, keep_clear

CONFIG = MlrDmpcConfig()
OBSTACLES = (
    Box((-0.2, -0.3, 0.0), (0.2, 0.1, 0.8)),
    Column((0.9, -0.6), 0.2),
    Column((-1.0, 0.9), 0.3, height=1.0),
)
ROWS = obstacle_rows(OBSTACLES)
MARGIN = 0.2


def inside(rng: np.random.Generator) -> list[np.ndarray]:
    """Points of each obstacle."""
    box, *columns = OBSTACLES
    assert isinstance(box, Box)
    points = [rng.uniform(box.low, box.high, (200, 3))]
    for column in columns:
        assert isinstance(column, Column)
        angle, out = rng.uniform(0.0, 2.0 * np.pi, 200), column.radius * np.sqrt(rng.random(200))
        x, y = column.center
        z = rng.uniform(0.0, column.height, 200)
        points.append(np.stack([x + out * np.cos(angle), y + out * np.sin(angle), z], axis=1))
    return points


def test_every_obstacle_is_behind_its_planes():
    rng = np.random.default_rng(0)
    for place in ([1.0, 1.0, 1.0], [-0.3, -0.5, 1.9], [0.0, 0.0, 2.5], [-1.0, 0.5, 0.4]):
        own = hover(np.array(place), 15, 0.2)
        planes = obstacle_planes(own, 1, ROWS, MARGIN, CONFIG)
        distance = obstacle_distances(ROWS, np.array(place))
        slack = planes.normals[:, 0] @ np.array(place) - planes.offsets[:, 0]
        assert np.allclose(slack, distance - MARGIN, atol=1e-6)
        for k, points in enumerate(inside(rng)):
            assert (points @ planes.normals[k, 0] <= planes.offsets[k, 0] - MARGIN + 1e-6).all()


def test_a_start_inside_is_refused():
    own = hover(np.array([0.0, 0.0, 0.5]), 15, 0.2)
    with pytest.raises(ValueError, match=r"inside obstacle 0 .*start outside"):
        obstacle_planes(own, 1, ROWS, MARGIN, CONFIG)


def test_drones_fly_around_obstacles_and_each_other():
    starts = np.array([[-1.5, 0.0, 1.0], [1.5, 0.3, 1.0], [0.0, -1.5, 1.2]])
    targets = starts * [-1.0, 1.0, 1.0] + [[0.0, 0.4, 0.0], [0.0, -0.8, 0.0], [0.0, 2.6, 0.0]]
    swarm = MlrDmpcSwarm(
        starts,
        targets,
        compute_units=2,
        obstacles=lambda own, k: obstacle_planes(own, k, ROWS, MARGIN, CONFIG),
    )

    def clear(now: MlrDmpcSwarm, report: SwarmRound) -> None:
        keep_clear(now, report)
        for trajectory in now.flying:
            away = obstacle_distances(ROWS, sampled_positions(trajectory, now.round, CONFIG))
            assert away.min() >= MARGIN - 1e-6

    assert arrival_time(swarm, 25.0, clear) < 25.0
