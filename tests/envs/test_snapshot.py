"""Snapshots, pickles and copies: each goes on byte for byte, with a simulator of its own."""

from __future__ import annotations

import copy
import pickle
from collections.abc import Callable

import numpy as np
import pytest

from swarm_envs import formation_v0, swap_v0
from swarm_envs.control.config import ControllerConfig
from swarm_envs.envs.core import SwarmCore
from swarm_envs.envs.parallel import SwarmParallelEnv
from swarm_envs.interactions import load
from swarm_envs.motors import BatteryModel
from swarm_envs.vehicles import parse_team
from tests.helpers.frozen import EVERYTHING

TEAM = "LS*S"  # Who flies the first episode; then the constructor's team does
ACTIONS = ("acceleration", "velocity", "ctbr", "rotors", "setpoint")


def flying(engine: str, action: str = "acceleration", **options: object) -> SwarmParallelEnv:
    env = swap_v0.parallel_env(
        team="SLS",
        physics=engine,
        action=action,
        randomization=EVERYTHING,
        battery=BatteryModel(),
        controller=ControllerConfig(feedforward=load("wake")),
        end_on_success=False,
        horizon_s=1.0,
        force_rate=80,
        **options,  # type: ignore[arg-type]
    )
    env.reset(seed=3, options={"team": TEAM})
    fly(env, np.random.default_rng(1), 20)
    return env


def fly(env: SwarmParallelEnv, rng: np.random.Generator, steps: int) -> list[object]:
    """Step at random, into a new episode where one ends; what came out, as bytes and numbers."""
    out: list[object] = []
    middle = {"ctbr": [-0.1, 0.0, 0.0, 0.0], "rotors": [0.05] * 4}.get(env.core.mode.name, [0.0])
    for _ in range(steps):
        if not env.agents:
            env.reset()
        actions = {
            agent: np.clip(middle + 0.1 * rng.standard_normal(env.action_space(agent).shape), -1, 1)
            for agent in env.agents
        }
        if env.core.mode.name == "setpoint":
            for i, agent in enumerate(env.agents):
                actions[agent][:3] += env.view.state.position[i]
        observations, *rest = env.step(actions)
        out += [row.tobytes() for row in observations.values()] + [repr(rest)]
    return [*out, env.state().tobytes()]


def restored(env: SwarmParallelEnv) -> SwarmParallelEnv:
    """Another environment of the same options, sent to the same place from elsewhere."""
    other = flying(env.physics_name, env.core.mode.name)
    other.reset(seed=5)
    fly(other, np.random.default_rng(5), 7)
    other.set_state(env.get_state())
    return other


WAYS: list[Callable[[SwarmParallelEnv], SwarmParallelEnv]] = [
    restored,
    copy.deepcopy,
    lambda env: pickle.loads(pickle.dumps(env)),  # noqa: S301
]


@pytest.mark.parametrize("action", ACTIONS)
@pytest.mark.parametrize("way", WAYS, ids=["set_state", "deepcopy", "pickle"])
def test_goes_on_byte_for_byte(engine, action, way):
    """Through the episode's end into the next ones, so that the generator is there too."""
    env = flying(engine, action)
    twin = way(env)
    assert twin.view.team == env.view.team == parse_team(TEAM)
    assert fly(twin, np.random.default_rng(2), 60) == fly(env, np.random.default_rng(2), 60)
    assert twin.view.team == env.view.team == parse_team("SLS")
    twin.close()
    env.close()


def test_a_snapshot_is_independent_of_what_flies_on(engine):
    env = flying(engine)
    snapshot = env.get_state()
    first = fly(env, np.random.default_rng(2), 30)
    env.set_state(snapshot)
    assert fly(env, np.random.default_rng(2), 30) == first
    env.set_state(snapshot)
    assert fly(env, np.random.default_rng(2), 30) == first


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"team": "SS"}, r"team is \('S', 'L', 'S'\), but here it is \('S', 'S'\)"),
        ({"team": "SLS", "action": "rotors"}, "action is 'acceleration', but here it is 'rotors'"),
        ({"team": "SLS", "num_neighbors": 1}, "num_neighbors is 3, but here it is 1"),
    ],
)
def test_refuses_what_does_not_fit(options, message):
    snapshot = flying("batch").get_state()
    env = swap_v0.parallel_env(physics="batch", **options)
    with pytest.raises(ValueError, match=message):
        env.set_state(snapshot)
    with pytest.raises(TypeError, match=r"state is a dict, but must be what get_state\(\)"):
        env.set_state({})  # type: ignore[arg-type]


def test_refuses_another_number_of_stages():
    short, long = (formation_v0.parallel_env(letters=name, num_drones=8) for name in ("LM", "LMNO"))
    for env in (short, long):
        env.reset(seed=1)
    with pytest.raises(ValueError, match="number of stages is 1, but here it is 3"):
        long.set_state(short.get_state())


def test_copies_keep_the_weights_that_were_set():
    blueprint = swap_v0.blueprint(num_drones=2, physics="batch")
    core = SwarmCore(blueprint.task, blueprint.config)
    core.set_reward_weights({"effort": -9.0})
    twin, still = copy.deepcopy(core), np.ones((1, 2, 3))
    for env in (core, twin):
        env.reset(seeds=[3])
    np.testing.assert_array_equal(core.step(still).rewards, twin.step(still).rewards)
    core.set_reward_weights({"effort": -0.1})
    assert (core.step(still).rewards != twin.step(still).rewards).all()


def test_a_closed_environment_has_no_state():
    env = flying("batch")
    env.close()
    for call in (env.get_state, env.state, lambda: pickle.dumps(env)):
        with pytest.raises(RuntimeError, match="closed environment"):
            call()
