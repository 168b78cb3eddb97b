"""Agents fly only in environments that are what they require."""

from __future__ import annotations

import copy
import pickle

import pytest

from swarm_envs import swap_v0
from swarm_envs.agents import Agent, fly_episode
from swarm_envs.baselines.neural_swarm import TrackingAgent
from swarm_envs.physics import BatchPhysics


def test_an_agent_is_not_flown_with_another_controller() -> None:
    plain, compensated = TrackingAgent(), TrackingAgent.compensated()
    assert isinstance(plain, Agent)
    for made, flown in ((plain, compensated), (compensated, plain)):
        env = swap_v0.parallel_env(team="LS", layout="stacked", physics="batch", **made.requires)
        with pytest.raises(ValueError, match=r"requires controller.*\*\*agent\.requires"):
            fly_episode(env, flown, seed=0)
    env = swap_v0.parallel_env(team="LS", layout="stacked", physics="batch", action="rotors")
    with pytest.raises(ValueError, match=r"requires action='setpoint', but .* 'rotors'"):
        fly_episode(env, plain, seed=0)


def test_two_agents_of_one_kind_may_share_an_environment() -> None:
    env = swap_v0.parallel_env(
        team="LS", layout="stacked", physics="batch", **TrackingAgent.compensated().requires
    )
    assert fly_episode(env, TrackingAgent.compensated(), seed=0)["success"]


@pytest.mark.parametrize("clone", [copy.deepcopy, pickle.dumps])
def test_copies_that_would_come_apart_are_refused(clone) -> None:
    env = swap_v0.parallel_env(num_drones=1, physics="batch")
    env.reset(seed=0)
    for thing in (env, env.core, BatchPhysics("S")):
        with pytest.raises(TypeError, match="cannot be copied or pickled"):
            clone(thing)
