"""Snapshots and copies go on byte for byte; `reset(options={"team": ...})` is a new environment."""

from __future__ import annotations

import copy
import pickle
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import swarm_envs
from swarm_envs import formation_v1, swap_v1
from swarm_envs.control.config import ControllerConfig
from swarm_envs.envs.core import SwarmCore
from swarm_envs.envs.joint import make_joint
from swarm_envs.envs.parallel import SwarmParallelEnv
from swarm_envs.envs.randomization import Randomization
from swarm_envs.envs.vector import make_vector
from swarm_envs.interactions import load
from swarm_envs.motors import BatteryModel
from swarm_envs.vehicles import LARGE, SMALL, Vehicle, parse_team
from tests.helpers.faces import core_of
from tests.helpers.frozen import EVERYTHING

TEAM = "LS*S"  # flies the first episode; then the constructor's team does
ACTIONS = ("acceleration", "velocity", "ctbr", "rotors", "setpoint")

PLAIN: dict[str, Any] = {"end_on_success": False}
LOADED: dict[str, Any] = PLAIN | {
    "randomization": EVERYTHING,
    "battery": BatteryModel(),
    "controller": ControllerConfig(feedforward=load("wake")),
    "force_bounds_g": {"S": 1.0, "L": 2.0},
}


def flying(engine: str, action: str = "acceleration", **options: object) -> SwarmParallelEnv:
    given = LOADED | {"horizon_s": 1.0, "force_rate": 80} | options
    env = swap_v1.parallel_env(team="SLS", physics=engine, action=action, **given)
    env.reset(seed=3, options={"team": TEAM})
    fly(env, np.random.default_rng(1), 20)
    return env


def fly(
    env: SwarmParallelEnv, rng: np.random.Generator, steps: int, on: bool = True
) -> list[object]:
    """Step at random; the results as bytes and numbers. If `on`, new episodes are begun."""
    out: list[object] = []
    middle = {"ctbr": [-0.1, 0.0, 0.0, 0.0], "rotors": [0.05] * 4}.get(env.core.mode.name, [0.0])
    for _ in range(steps):
        if not env.agents:
            if not on:
                break
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
    return [*out, env.state().tobytes(), env.core.metrics()]


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


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"team": "SS"}, r"team is \('S', 'L', 'S'\), but here it is \('S', 'S'\)"),
        ({"team": "SLS", "action": "rotors"}, "action is 'acceleration', but here it is 'rotors'"),
        ({"team": "SLS", "num_neighbors": 1}, "num_neighbors is 3, but here it is 1"),
        ({"team": "SLS", "decision_rate": 24}, "decision_rate is 48, but here it is 24"),
        ({"team": "SLS", "force_rate": 240}, "force_rate is 80, but here it is 240"),
        ({"team": "SLS", "horizon_s": 2.0}, r"horizon_s is 1\.0, but here it is 2\.0"),
        ({"team": "SLS", "interactions": "none"}, "interactions is .*'learned'.* it is .*none"),
        ({"team": "SLS", "observe_load": True}, "observe_load is False, but here it is True"),
        ({"team": "SLS", "observe_setpoint": True}, "observe_setpoint is False, but here .* True"),
        ({"team": "SLS", "end_on_success": True}, "end_on_success is False, but here it is True"),
    ],
)
def test_refuses_what_does_not_fit(options, message):
    snapshot = flying("batch").get_state()
    same = {"horizon_s": 1.0, "force_rate": 80, **LOADED}
    env = swap_v1.parallel_env(**{"physics": "batch", **same, **options})
    env.reset(seed=1)
    before = env.state().tobytes()
    with pytest.raises(ValueError, match=message):
        env.set_state(snapshot)
    assert env.state().tobytes() == before
    with pytest.raises(TypeError, match=r"state is a dict, but must be what get_state\(\)"):
        env.set_state({})  # type: ignore[arg-type]


def test_refuses_another_number_of_stages():
    short, long = (formation_v1.parallel_env(letters=name, num_drones=8) for name in ("LM", "LMNO"))
    for env in (short, long):
        env.reset(seed=1)
    with pytest.raises(ValueError, match="number of stages is 1, but here it is 3"):
        long.set_state(short.get_state())


def test_copies_keep_the_weights_that_were_set():
    blueprint = swap_v1.blueprint(num_drones=2, physics="batch")
    core = SwarmCore(blueprint.task, blueprint.config)
    core.set_reward_weights({"effort": -9.0})
    twin, still = copy.deepcopy(core), np.ones((1, 2, 3))
    for env in (core, twin):
        env.reset(seeds=[3])
    np.testing.assert_array_equal(core.step(still).rewards, twin.step(still).rewards)
    parallel = SwarmParallelEnv(*blueprint)
    parallel.core.set_reward_weights({"effort": -9.0})
    assert copy.deepcopy(parallel).core.reward_weights["effort"] == -9.0
    core.set_reward_weights({"effort": -0.1})
    assert (core.step(still).rewards != twin.step(still).rewards).all()


def test_a_closed_environment_has_no_state():
    env = flying("batch")
    env.close()
    for call in (env.get_state, env.state, lambda: pickle.dumps(env)):
        with pytest.raises(RuntimeError, match="closed environment"):
            call()


FLOWN: list[tuple[str, dict[str, Any], str, str]] = [
    ("swap_v1", {"layout": "random"}, "SLSS*", "LSS*L"),
    ("swap_v1", {"layout": "stacked"}, "SSS", "LSL"),
    ("swap_v1", {"layout": "circle", "action": "ctbr"}, "SSS", "LS*L"),
    ("swap_v1", {"layout": "random", "action": "rotors"}, "SSS", "LS*L"),
    ("ring_v1", {}, "S*S*S*LL", "LLS*S*S*"),
    ("formation_v1", {"shape_s": 0.5, "travel_s": 0.4}, "SSSS", "LSLS*"),
]
"""Task, its options, the team that an environment is made with, and another."""


def flight(env: SwarmParallelEnv, steps: int = 40) -> list[object]:
    """The results of an environment that was just reset, in bytes and numbers, until it ends."""
    return fly(env, np.random.default_rng(0), steps, on=False)


@pytest.mark.parametrize("extra", [PLAIN, LOADED], ids=["plain", "everything"])
@pytest.mark.parametrize(("task", "options", "first", "other"), FLOWN)
def test_equals_an_environment_made_with_that_team(engine, task, options, first, other, extra):
    """To the last bit; then the constructor's team is back, as if it had never been away."""

    def make(team: str) -> SwarmParallelEnv:
        return swarm_envs.make(task, team=team, physics=engine, **options, **extra)

    env, like, made = make(first), make(other), make(first)
    env.reset(seed=1)
    flight(env, 5)
    rows, _ = env.reset(seed=7, options={"team": other})
    wanted, _ = like.reset(seed=7)
    assert [row.tobytes() for row in rows.values()] == [row.tobytes() for row in wanted.values()]
    assert env.view.team == like.view.team == parse_team(other)
    assert flight(env) == flight(like)
    for again in (8, None):  # seeded, then going on with the generator
        rows, _ = env.reset(seed=again)
        made.reset(seed=again)
        assert env.view.team == parse_team(first)
        assert flight(env) == flight(made)
    for each in (env, like, made):
        each.close()


def test_every_interface_passes_it_on(face):
    """In its first environment, as the parallel one; another reset brings the first team back."""
    env = face.begin()
    reference = swap_v1.parallel_env(physics="batch", num_drones=3, horizon_s=1.0)
    reference.reset(seed=4, options={"team": "LSL"})
    face.reset(env, seed=4, options={"team": "LSL"})
    core = core_of(env)
    rng = np.random.default_rng(0)
    for _ in range(5):
        rows = list(rng.uniform(-0.3, 0.3, (3, 3)).astype(np.float32))
        face.step(env, rows)
        reference.step(dict(zip(reference.agents, rows, strict=True)))
        np.testing.assert_array_equal(core.rows[0], reference.core.rows[0])
    assert all(task.team == parse_team("LSL") for task in core.tasks)
    face.reset(env, seed=4)
    assert all(task.team == parse_team("SSS") for task in core.tasks)


def test_one_environment_of_a_vector():
    """Flies another team until its episode ends and another begins by itself."""
    env = make_vector("swap_v1", 2, num_drones=3, horizon_s=0.1)
    env.reset(seed=0)
    mask = np.array([False, True])
    env.reset(seed=5, options={"reset_mask": mask, "team": (LARGE, SMALL, LARGE)})
    assert [task.team for task in env.core.tasks] == [parse_team("SSS"), parse_team("LSL")]
    single = make_joint("swap_v1", physics="batch", team="LSL", horizon_s=0.1)
    np.testing.assert_array_equal(env.core.rows[1].reshape(-1), single.reset(seed=6)[0])
    rows = np.full((2, 9), 0.2, np.float32)
    for _ in range(3):
        env.step(rows)
        np.testing.assert_array_equal(env.core.rows[1].reshape(-1), single.step(rows[1])[0])
    for _ in range(5):
        env.step(rows)
    assert [task.team for task in env.core.tasks] == [parse_team("SSS")] * 2


STRANGE = replace(SMALL, token="X", interaction_type="X")
WEAK = replace(SMALL, token="W", max_thrust=1.15 * SMALL.mass * 9.80665)
ONLY_SMALL = replace(load("wake"), name="small", types=("S",))
CLOSE = [[0.0, 0.0, 1.0], [0.15, 0.0, 1.0], [1.0, 1.0, 1.0]]
"""Starts where small drones have room, but large ones touch."""


@pytest.mark.parametrize(
    ("options", "reset", "message"),
    [
        ({}, {"team": "LS"}, r"has 2 vehicles, but this environment has 3 drones; make"),
        ({}, {"team": "LSQ"}, r"unknown vehicle token 'Q' in team 'LSQ'"),
        ({}, {"team": (SMALL, SMALL, STRANGE)}, r"unknown interaction type 'X'.*valid: 'L', 'S'"),
        ({}, {"team": "LLS", "start": CLOSE}, r"drones 0 and 1 are 0.150 m apart"),
        (
            {"layout": "stacked"},
            {"team": (replace(LARGE, diameter=0.5),) * 3},
            r"gap_m begins at 0.2 m, but these drones touch at 0.500 m",
        ),
        (
            {"randomization": Randomization(mass=(0.9, 1.2))},
            {"team": (SMALL, SMALL, WEAK)},
            r"can leave 'W' with a thrust-to-weight ratio of 0.96",
        ),
        (
            {"controller": ControllerConfig(feedforward=ONLY_SMALL)},
            {"team": "SSL"},
            r"unknown interaction type 'L' in interaction model 'small'",
        ),
    ],
)
def test_teams_that_cannot_fly_are_refused(engine, options, reset, message):
    """Everything goes on as if it had not been tried."""
    envs = [swap_v1.parallel_env(physics=engine, team="SSS", **options) for _ in range(2)]
    for env in envs:
        env.reset(seed=2)
        env.step({agent: np.full(3, 0.1) for agent in env.agents})
    with pytest.raises(ValueError, match=message):
        envs[0].reset(seed=9, options=reset)
    ends = [flight(env, 5) for env in envs]
    for env in envs:
        env.reset()  # the generators, too, are where they were
        ends.append(flight(env, 5))
        env.close()
    assert ends[0] == ends[1]
    assert ends[2] == ends[3]


def test_starts_are_checked_with_the_team_that_flies():
    env = swap_v1.parallel_env(physics="batch", team="LLL")
    env.reset(seed=1, options={"team": "SSS", "start": CLOSE})


def test_a_vehicle_of_one_s_own():
    """Any vehicle flies whose type the interaction model knows; bounds go by its token."""
    mine: Vehicle = replace(LARGE, token="M", mass=0.05)
    env = swap_v1.parallel_env(num_drones=2, physics="batch", force_bounds_g={"M": 1e-9})
    env.reset(seed=1, options={"team": (mine, SMALL)})
    flight(env, 10)
    assert env.view.team == (mine, SMALL)
    over = env.core.world.drones["over_bound"][0]
    assert over[0] > 40 and over[1] == 0
    assert env.core.physics.parameters.mass[0].tolist() == [0.05, SMALL.mass]
