"""RTH3D as an agent: grid plans flown on real dynamics, in the downwash."""

from __future__ import annotations

import numpy as np
import pytest

from swarm_envs import formation_v1, ring_v1, swap_v1
from swarm_envs.agents import load
from swarm_envs.agents.protocol import fly_episode
from swarm_envs.baselines.rth3d.grid_agent import GridAgent, Lattice
from swarm_envs.tasks.obstacles import (
    Column,
    Obstacle,
    buildings,
    obstacle_distances,
    obstacle_rows,
)


def test_flights_go_around_buildings():
    agent = load("rth3d")
    assert isinstance(agent, GridAgent)
    city: tuple[Obstacle, ...] = (*buildings(), Column((0.0, 0.0), 0.15))
    env = swap_v1.parallel_env(num_drones=5, obstacles=city, physics="batch", **agent.requires)
    metrics = fly_episode(env, agent, 0)
    assert metrics["success"], metrics
    assert metrics["near_misses"] == 0
    flight = agent.plans[0]
    times = np.linspace(0.0, flight.duration_s, 300)
    points = np.concatenate([flight.reference(float(time)).position for time in times])
    assert obstacle_distances(obstacle_rows(city), points).min() > 0.06


@pytest.mark.slow
def test_a_hundred_drones_fly_between_rings_and_blocks():
    agent = GridAgent.compensated()
    options = {"shapes": ("rings", "blocks"), "labels": "random", "interactions": "learned"}
    env = formation_v1.parallel_env(num_drones=100, physics="batch", **options, **agent.requires)
    metrics = fly_episode(env, agent, 0)
    assert metrics["success"], metrics
    assert metrics["near_misses"] == 0


def test_vertices_are_matched_to_the_nearest_points_and_are_all_different():
    lattice = Lattice(np.zeros(3), np.full(3, 0.5), (3, 3, 2))
    free = np.ones(lattice.shape, dtype=bool)
    free[0, 0, 0] = False
    found = lattice.near(np.array([[0.1, 0.0, 0.0], [0.5, 0.1, 0.0], [0.55, 0.0, 0.0]]), free)
    assert len(np.unique(found, axis=0)) == 3
    assert not (found == 0).all(axis=1).any()
    with pytest.raises(ValueError, match="has 17 free vertices"):
        lattice.near(np.zeros((18, 3)), free)


def test_what_it_cannot_fly_is_refused():
    ring = ring_v1.parallel_env(physics="batch", **GridAgent().requires)
    ring.reset(seed=0)
    with pytest.raises(ValueError, match="those of ring_v1 move"):
        GridAgent().reset(ring, 0)
    env = swap_v1.parallel_env(num_drones=2, physics="batch", **GridAgent().requires)
    env.reset(seed=0)
    with pytest.raises(ValueError, match="use a wider spacing"):
        GridAgent(spacing=(0.1, 0.1, 0.1)).reset(env, 0)
    for bad in ({"spacing": (0.4, 0.0, 0.4)}, {"share": 0.0}):
        with pytest.raises(ValueError, match="must"):
            GridAgent(**bad)
    agent = GridAgent()
    agent.reset(env, 0)
    with pytest.raises(ValueError, match="privileged"):
        agent.act({}, None)
    starts = np.array([[0.0, 0.0, 1.0], [0.14, 0.0, 1.0]])
    goals = np.array([[1.0, 0.0, 1.0], [-1.0, 0.0, 1.0]])
    env.reset(seed=0, options={"start": starts, "goal": goals})
    with pytest.raises(ValueError, match="spread them"):
        agent.reset(env, 0)


@pytest.mark.slow
def test_two_hundred_drones_keep_off_the_walls():
    """With splines up to the walls, one of them touched a wall."""
    agent = load("rth3d")
    assert isinstance(agent, GridAgent)
    env = swap_v1.parallel_env(num_drones=200, physics="batch", horizon_s=30, **agent.requires)
    metrics = fly_episode(env, agent, 0)
    assert metrics["success"], metrics
    flight, (low, high) = agent.plans[0], env.core.task.arena
    times = np.linspace(0.0, flight.duration_s, 8 * flight.num_steps)
    points = np.concatenate([flight.reference(float(time)).position for time in times])
    assert np.minimum(points - low, high - points).min() > env.core.task.radius.max() + 0.099
