"""The safety filter: what it keeps apart, what it leaves alone."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import pytest

from swarm_envs import swap_v0
from swarm_envs.agents import Safety, SafetyFilter, fly_episode, load
from swarm_envs.agents.batch import BatchAgent
from swarm_envs.agents.evaluation import TIMED, evaluate, frozen_seeds
from swarm_envs.envs.parallel import SwarmParallelEnv


def test_two_that_meet_head_on_pass_each_other_on_the_right():
    start = np.array([[-1.5, 0, 1], [1.5, 0, 1]])
    starts = {"start": start, "goal": start[::-1].copy()}
    for name, safe in (("straight-line", False), ("straight-line+filter", True)):
        agent = load(name)
        env = swap_v0.parallel_env(num_drones=2, physics="batch", **agent.requires)
        side: list[float] = []

        def watch(env: SwarmParallelEnv, side: list[float] = side) -> None:
            position = env.view.state.position
            if abs(position[0, 0] - position[1, 0]) < 0.1:
                side.append(position[0, 1] - position[1, 1])

        metrics = fly_episode(env, agent, 0, watch, options=starts)
        assert metrics["success"] == safe
        assert (metrics["collided_drones"] == 0) == safe
        if safe:
            assert max(side) < -0.12  # the one that flies along x passes on its right, at less y
            assert metrics["minimum_separation_m"] > 0.17
        env.close()


def test_who_is_far_from_everything_is_left_alone():
    agent = load("straight-line")
    both = []
    for flown in (agent, SafetyFilter(agent)):
        env = swap_v0.parallel_env(num_drones=2, **{**flown.requires, "physics": "batch"})
        ways = {"start": np.array([[-1.0, -1, 1], [-1, 1, 1]])}
        ways["goal"] = ways["start"] + [1.5, 0, 0]
        both.append(fly_episode(env, flown, 0, options=ways))
        env.close()
    assert both[0] == both[1]


def test_a_filtered_policy_flies_in_batches_as_it_flies_alone():
    agent, seeds = load("swap-ppo+filter"), frozen_seeds(3, TIMED + 3)
    assert isinstance(agent, SafetyFilter)
    assert isinstance(agent, BatchAgent)
    env = swap_v0.parallel_env(
        num_drones=4, horizon_s=1.5, **{**agent.requires, "physics": "batch"}
    )
    assert env.core.config.num_neighbors == 7  # though the policy observes three
    for episode in list(evaluate(env, agent, seeds))[TIMED:]:
        assert episode["metrics"] == fly_episode(env, agent, episode["seed"])
    counted = agent.statistics()
    assert 0.0 < counted["acted"] < 0.5
    assert counted["decisions"] > 3 * 15
    assert counted["cost_us"]["p50"] <= counted["cost_us"]["p99"]
    env.close()


@pytest.mark.parametrize(
    ("name", "layout", "most"), [("straight-line+filter", "random", 1), ("hover", "random", 0)]
)
def test_collisions_collapse(name, layout, most):
    agent = load(name)
    options = {**agent.requires, "layout": layout, "force_rate": 48, "physics": "batch"}
    env = swap_v0.parallel_env(num_drones=4, **options)
    episodes = list(evaluate(env, agent, frozen_seeds(5, 64)))
    assert sum(e["metrics"]["collided_drones"] > 0 for e in episodes) <= most  # without: 25 of 64
    env.close()


def test_walls_are_kept_away_from():
    class Outwards:
        requires: Mapping[str, Any] = {"action": "acceleration", "decision_rate": 10}
        privileged = False

        def reset(self, env, seed):
            pass

        def act(self, observations, view):
            corner = np.array([1.0, 0.3, -1.0], np.float32)
            return dict(zip(observations, (corner, -corner), strict=True))

    for safety, crashes in ((Safety(), 0), (Safety(walls=False), 1)):
        agent = SafetyFilter(Outwards(), safety)
        assert not isinstance(agent, BatchAgent)
        options = {**agent.requires, "physics": "batch", "horizon_s": 4.0}
        env = swap_v0.parallel_env(num_drones=2, **options)
        metrics = fly_episode(env, agent, 1)
        touched = metrics["collided_wall"] + metrics["collided_floor"]
        assert (touched > 0) == bool(crashes)
        env.close()


def test_what_cannot_be_filtered_is_refused():
    with pytest.raises(ValueError, match=r"needs action='acceleration', but DetourAgent requires"):
        load("detour+filter")
    with pytest.raises(ValueError, match=r"Safety.rate is 0.0, but must be positive"):
        Safety(rate=0.0)
    with pytest.raises(ValueError, match=r"Safety.downwash is 0.5, but must be 1.0 or more"):
        Safety(downwash=0.5)
    with pytest.raises(ValueError, match="at most 1"):
        Safety(share=1.5)
    agent = load("hover+filter")
    env = swap_v0.parallel_env(num_drones=2, **agent.requires)
    env.reset(seed=0)
    agent.reset(env, 0)
    agent.agent.act_batch = lambda rows: np.full((*rows.shape[:-1], 3), np.nan)  # type: ignore
    agent.agent.act = lambda rows, view: {k: np.full(3, np.nan) for k in rows}  # type: ignore
    with pytest.raises(ValueError, match="must be finite"):
        agent.act(env.reset(seed=0)[0], None)
    env.close()
