"""MLR-DMPC as an agent: what flies, on real dynamics and in the downwash."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from swarm_envs import crowd_v0, formation_v1, pursuit_v0, ring_v1, swap_v1
from swarm_envs.agents import load
from swarm_envs.agents.protocol import fly_episode
from swarm_envs.baselines.mlr_dmpc.formations import scaled_distances
from swarm_envs.baselines.mlr_dmpc.mlr_dmpc_agent import MlrDmpcAgent
from swarm_envs.baselines.mlr_dmpc.mlr_dmpc_config import MlrDmpcConfig
from swarm_envs.baselines.mlr_dmpc.radio import Jam, LossModel
from swarm_envs.physics import bullet_available
from swarm_envs.tasks.obstacles import Column

DISTANCE = MlrDmpcConfig().distance_m


def places(rng: np.random.Generator, n: int, arena: np.ndarray) -> np.ndarray:
    """Points (n, 3) in the arena that keep the paper's scaled distance, and a little more."""
    low, high = arena[0] + [0.3, 0.3, 0.5], arena[1] - [0.3, 0.3, 0.5]
    while True:
        points = rng.uniform(low, high, (n, 3))
        if scaled_distances(points, MlrDmpcConfig()).min() > 1.2 * DISTANCE:
            return points


def swap(n: int, physics: str, **options: Any):
    return swap_v1.parallel_env(
        num_drones=n, physics=physics, horizon_s=30.0, **MlrDmpcAgent().requires, **options
    )


def test_drones_swap_through_downwash_and_the_references_keep_their_distance():
    env, agent = swap(5, "batch"), MlrDmpcAgent()
    rng = np.random.default_rng(3)
    starts, goals = (places(rng, 5, env.core.task.arena) for _ in range(2))
    apart: list[float] = []

    def watch(env) -> None:
        assert agent.swarm is not None
        flown = agent.swarm.reference(np.zeros(1))[:, 0, 0]
        apart.append(scaled_distances(flown, agent.config).min())

    metrics = fly_episode(env, agent, 0, watch, {"start": starts, "goal": goals})
    assert metrics["success"]
    assert metrics["near_misses"] == 0
    assert agent.config.scaling == (1.0, 1.0, 6.0)
    assert min(apart) >= DISTANCE - 1e-6


def test_the_same_seed_flies_the_same():
    env, found = swap(4, "batch", layout="random"), []
    for _ in range(2):
        agent = MlrDmpcAgent(loss=0.2)
        metrics = fly_episode(env, agent, 5)
        assert agent.swarm is not None
        found.append((metrics, [one.state.tolist() for one in agent.swarm.flying]))
    assert found[0] == found[1]


def test_set_points_are_the_references_of_the_round():
    env, agent = swap(3, "batch", layout="random"), MlrDmpcAgent()
    observations, _ = env.reset(seed=1)
    agent.reset(env, 1)
    assert agent.swarm is not None
    for _ in range(6):
        expected = agent.swarm.reference(np.array([0.0, 0.1, 0.2]))
        actions = agent.act(observations, env.view)
        rows = np.stack([actions[name] for name in env.agents])
        np.testing.assert_array_equal(rows[:, :12], expected[:, 0].reshape(3, 12))
        observations, *_ = env.step(actions)
        # Constant jerk: what the loop extrapolates to is where the next round begins.
        np.testing.assert_allclose(env.view.setpoint.position, expected[:, 2, 0], atol=1e-9)


def test_heights_are_scaled_as_starts_and_goals_allow():
    env, agent = swap(2, "batch"), MlrDmpcAgent()
    starts = np.array([[0.0, 0.0, 1.0], [0.0, 0.1, 1.6]])
    goals = np.array([[1.0, 0.0, 1.0], [-1.0, 0.0, 1.6]])
    env.reset(seed=0, options={"start": starts, "goal": goals})
    agent.reset(env, 0)
    low = agent.config.scaling[2]
    assert 1.0 < low < 6.0
    scaled = (starts[0] - starts[1]) / agent.config.scaling
    assert np.linalg.norm(scaled) == pytest.approx(1.2 * DISTANCE)


def test_goals_of_a_crowd_may_be_any_of_its_sites_at_once():
    """Scaled for the first goals alone, later ones came too near, and the agent raised."""
    agent = MlrDmpcAgent()
    env = crowd_v0.parallel_env(num_drones=8, layout="open", physics="batch", **agent.requires)
    given: set[tuple[float, ...]] = set()
    metrics = fly_episode(env, agent, 0, lambda env: given.update(map(tuple, env.view.goals)))
    assert metrics["success"], metrics
    assert metrics["near_misses"] == 0
    sites = np.array(sorted(given))
    assert len(sites) > 16
    assert scaled_distances(sites, agent.config).min() > 1.19 * DISTANCE


def test_obstacles_are_flown_around():
    agent, city = MlrDmpcAgent(), (Column((0.0, 0.1), 0.2),)
    env = swap(2, "batch", obstacles=city)
    starts = np.array([[-1.2, 0.0, 1.0], [1.2, 0.3, 1.0]])
    metrics = fly_episode(env, agent, 0, options={"start": starts, "goal": -starts + [0, 0, 2]})
    assert metrics["success"], metrics
    assert metrics["minimum_obstacle_distance_m"] > 0.0


def test_what_it_cannot_fly_is_refused():
    options: dict[str, Any] = {"physics": "batch", **MlrDmpcAgent().requires}
    chase = pursuit_v0.parallel_env(layout="chase", **options)
    for moving in (ring_v1.parallel_env(**options), chase):
        moving.reset(seed=0)
        with pytest.raises(ValueError, match=r"but those of (ring_v1|pursuit_v0) move"):
            MlrDmpcAgent().reset(moving, 0)
    env = swap(2, "batch")
    starts, goals = np.array([[0.0, 0, 1], [0.15, 0, 1]]), np.array([[1.0, 0, 1], [-1, 0, 1]])
    env.reset(seed=0, options={"start": starts, "goal": goals})
    with pytest.raises(ValueError, match=r"closer than 0\.3 m"):
        MlrDmpcAgent().reset(env, 0)
    env.reset(seed=0, options={"start": 2 * starts, "goal": goals})
    agent = MlrDmpcAgent()
    agent.reset(env, 0)
    with pytest.raises(ValueError, match="privileged"):
        agent.act({}, None)
    with pytest.raises(ValueError, match="compute_units"):
        MlrDmpcAgent(compute_units=3).reset(env, 0)


def test_a_deaf_drone_is_named_while_it_flies():
    deaf = LossModel(jams=(Jam(first_round=0, last_round=500, receivers="drone 1"),))
    env, agent = swap(2, "batch", layout="random"), MlrDmpcAgent(loss=deaf)
    with pytest.warns(RuntimeWarning) as warned:
        fly_episode(env, agent, 0)
    assert agent.faults == {
        0: "the target of drone 0 is unreachable because another drone, 1, rests on it",
        1: "drone 1 has accepted none of the last 20 plans for it: it seems to receive nothing",
    }
    assert {str(one.message) for one in warned} == set(agent.faults.values())
    fly_episode(env, MlrDmpcAgent(loss=0.3), 0)  # warnings are errors here


@pytest.mark.slow
@pytest.mark.skipif(not bullet_available(), reason="pybullet is not installed")
def test_fifty_swaps_of_eight_on_bullet_collide_never_and_arrive():
    env, rng = swap(8, "bullet", interactions="learned"), np.random.default_rng(11)
    for seed in range(50):
        starts, goals = (places(rng, 8, env.core.task.arena) for _ in range(2))
        agent = MlrDmpcAgent()
        metrics = fly_episode(env, agent, seed, options={"start": starts, "goal": goals})
        assert agent.config.scaling == (1.0, 1.0, 6.0)
        assert metrics["success"], (seed, metrics)


def test_formations_are_reached_with_the_downwash_fed_forward():
    agent = load("mlr-dmpc+compensated")
    env = formation_v1.parallel_env(num_drones=8, physics="batch", **agent.requires)
    metrics = fly_episode(env, agent, 0)
    assert metrics["success"], metrics
    assert metrics["near_misses"] == 0
