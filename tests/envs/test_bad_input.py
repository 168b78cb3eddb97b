"""Bad input: an exception that says the value, the rule and the fix; nothing has changed."""

from __future__ import annotations

import pickle
import shutil
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from safetensors import safe_open
from safetensors.numpy import save_file

import swarm_envs
from swarm_envs import swap_v0
from swarm_envs.envs.parallel import SwarmParallelEnv
from tests.helpers.living import living

WEIGHTS = Path(swarm_envs.__file__).parent / "interactions" / "weights" / "learned.safetensors"


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"team": "SX"}, r"unknown vehicle token 'X' in team 'SX'.*valid: 'L', 'S', 'S\*'"),
        ({"team": "s"}, r"unknown vehicle token 's'"),
        ({"team": ""}, r"team '' has no drones; name at least one"),
        ({"physics": "bulet"}, r"unknown physics 'bulet'; did you mean 'bullet'"),
        ({"action": "acceleratoin"}, r"unknown action 'acceleratoin'; did you mean 'acceleration'"),
        ({"layout": "stack"}, r"unknown layout 'stack'; did you mean 'stacked'"),
        ({"render_mode": "rgb"}, r"unknown render_mode 'rgb'; did you mean 'rgb_array'"),
        ({"interactions": "learnd"}, r"unknown interaction model 'learnd'; did you mean 'learned'"),
        (
            {"reward_weights": {"sucess": 1}},
            r"unknown reward term 'sucess'; did you mean 'success'",
        ),
        ({"reward_weights": {"crash": float("nan")}}, r"'crash' is nan, but must be finite"),
        ({"decision_rate": 50}, r"decision_rate is 50, but must be 240 over an integer, such as"),
        ({"horizon_s": 0.0}, r"horizon_s is 0.0, but must be positive and finite"),
        ({"team": "S" * 12, "layout": "stacked"}, r"12 drones stacked .* use fewer drones or"),
    ],
)
def test_impossible_options(options, message):
    with pytest.raises(ValueError, match=message):
        swap_v0.parallel_env(**{"physics": "batch", **options})


def test_unknown_names():
    with pytest.raises(TypeError, match="unknown option 'num_drone'; did you mean 'num_drones'"):
        swarm_envs.make("swap_v0", num_drone=3)
    with pytest.raises(ValueError, match="unknown task 'swap_v1'; did you mean 'swap_v0'"):
        swarm_envs.make("swap_v1")
    env = swap_v0.parallel_env(num_drones=2, physics="batch")
    for space in (env.action_space, env.observation_space):
        with pytest.raises(ValueError, match="unknown agent 'drone_2'; did you mean 'drone_"):
            space("drone_2")


def test_bullet_without_pybullet(monkeypatch):
    monkeypatch.setitem(sys.modules, "pybullet", None)
    with pytest.raises(ImportError, match=r"needs pybullet.*pip install pybullet.*physics='batch'"):
        swap_v0.parallel_env(physics="bullet")
    env = swap_v0.parallel_env()  # the default falls back to the twin
    assert env.physics_name == "batch"
    env.reset(seed=1)


def truncated(path: Path) -> None:
    path.write_bytes(WEIGHTS.read_bytes()[:-1000])


def garbage(path: Path) -> None:
    path.write_bytes(b"these are no weights")


def pickled(path: Path) -> None:
    path.write_bytes(pickle.dumps({"phi.S.0.weight": np.zeros((2, 6))}))


def changed(change: Callable[[dict[str, Any], dict[str, str]], None]) -> Callable[[Path], None]:
    def write(path: Path) -> None:
        with safe_open(WEIGHTS, framework="numpy") as file:
            tensors = {name: file.get_tensor(name) for name in sorted(file.keys())}
            notes = dict(file.metadata())
        change(tensors, notes)
        save_file(tensors, path, notes)

    return write


def put_nan(tensors: dict[str, Any], notes: dict[str, str]) -> None:
    tensors["rho.S.0.weight"][0, 0] = np.nan


def drop_network(tensors: dict[str, Any], notes: dict[str, str]) -> None:
    del tensors["rho.S.0.weight"]


def rename_format(tensors: dict[str, Any], notes: dict[str, str]) -> None:
    notes["swarm_envs"] = notes["swarm_envs"].replace("deep-set-1", "deep-set-9")


def drop_notes(tensors: dict[str, Any], notes: dict[str, str]) -> None:
    del notes["swarm_envs"]


DAMAGES: list[Callable[[Path], None]] = [truncated, garbage, pickled]
DAMAGES += [changed(change) for change in (put_nan, drop_network, rename_format, drop_notes)]


@pytest.mark.parametrize("damage", DAMAGES)
def test_damaged_weights(tmp_path, damage):
    path = tmp_path / "weights.safetensors"
    damage(path)
    with pytest.raises(
        ValueError, match=r"weights\.safetensors' is damaged or not a .*fit it again"
    ):
        swap_v0.parallel_env(physics="batch", interactions=path)
    shutil.copy(WEIGHTS, path)  # the same file, whole
    swap_v0.parallel_env(physics="batch", interactions=str(path))


def test_missing_weights(tmp_path):
    path = tmp_path / "no.safetensors"
    with pytest.raises(FileNotFoundError, match=r"no\.safetensors' does not exist; give the path"):
        swap_v0.parallel_env(physics="batch", interactions=path)


def flying(engine: str, action: str = "acceleration") -> SwarmParallelEnv:
    env = swap_v0.parallel_env(team="LS", physics=engine, action=action, interactions="learned")
    env.reset(seed=3)
    env.step(good(env))
    return env


def good(env: SwarmParallelEnv) -> dict[str, np.ndarray]:
    width = env.core.mode.width
    row = np.linspace(-0.1, 0.2, width, dtype=np.float32)
    return {agent: row + 0.1 * k for k, agent in enumerate(env.agents)}


def everything(env: SwarmParallelEnv) -> bytes:
    arrays = b"".join(array.tobytes() for array in living(env.core).values())
    generators = repr([g.bit_generator.state for g in env.core.generators])
    return arrays + generators.encode() + repr(env.agents).encode()


def bad_row(width: int, value: float) -> np.ndarray:
    row = np.zeros(width, np.float32)
    row[1] = value
    return row


def refused(env: SwarmParallelEnv, call: Callable[[], object], error: type, message: str) -> None:
    """The call is refused; nothing has changed, and the flight goes on as if it never was."""
    twin = flying(env.physics_name, env.core.mode.name)
    before = everything(env)
    with pytest.raises(error, match=message):
        call()
    assert everything(env) == before
    for _ in range(3):
        ours, theirs = env.step(good(env))[0], twin.step(good(twin))[0]
        for agent, row in ours.items():
            assert row.tobytes() == theirs[agent].tobytes()
    ours, theirs = env.reset()[0], twin.reset()[0]  # the generators too are where they were
    assert ours["drone_0"].tobytes() == theirs["drone_0"].tobytes()
    twin.close()
    env.close()


@pytest.mark.parametrize(
    ("change", "error", "message"),
    [
        ({"drone_1": np.zeros(2)}, ValueError, r"'drone_1' has shape \(2,\).*takes 3 numbers"),
        ({"drone_1": np.zeros((1, 3))}, ValueError, r"'drone_1' has shape \(1, 3\)"),
        ({"drone_0": 0.5}, ValueError, r"'drone_0' has shape \(\), but action 'acceleration'"),
        ({"drone_0": "abc"}, ValueError, r"'drone_0' has shape \(\)"),
        ({"drone_0": ["a", "b", "c"]}, ValueError, r"must be numbers"),
        ({"drone_0": None}, ValueError, r"'drone_0' has shape \(\)"),
        ({"drone_1": bad_row(3, np.nan)}, ValueError, r"drone_1 has nan at index 1.*finite"),
        ({"drone_0": bad_row(3, np.inf)}, ValueError, r"drone_0 has inf at index 1.*finite"),
        ({"drone_0": bad_row(3, -np.inf)}, ValueError, r"drone_0 has -inf at index 1"),
        ({"drone_1": bad_row(3, 1.01)}, ValueError, r"has 1.01.* in \[-1, 1\]; clip it"),
        ({"drone_0": bad_row(3, -7.0)}, ValueError, r"drone_0 has -7 .*must lie in \[-1, 1\]"),
        ({"drone_2": np.zeros(3)}, ValueError, r"unknown agent 'drone_2' in actions; did you mean"),
    ],
)
def test_bad_actions(engine, change, error, message):
    env = flying(engine)
    refused(env, lambda: env.step(good(env) | change), error, message)


def test_missing_and_misnamed_agents(engine):
    env = flying(engine)
    one = {"drone_0": np.zeros(3)}
    refused(env, lambda: env.step(one), ValueError, r"actions lack \['drone_1'\]; give one for")
    env = flying(engine)
    wrong = one | {"drone1": np.zeros(3)}
    refused(env, lambda: env.step(wrong), ValueError, "unknown agent 'drone1'.* mean 'drone_1'")
    env = flying(engine)
    array: Any = np.zeros((2, 3))
    refused(env, lambda: env.step(array), TypeError, "actions are ndarray, but must be a dict")


@pytest.mark.parametrize("action", ["rotors", "setpoint"])
@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_actions_that_are_not_finite(engine, action, value):
    env = flying(engine, action)
    change = {"drone_1": bad_row(env.core.mode.width, value)}
    refused(
        env, lambda: env.step(good(env) | change), ValueError, f"drone_1 has {value} at index 1"
    )


def test_setpoints_too_far_to_be_observed():
    env = flying("batch", "setpoint")
    change = {"drone_1": bad_row(14, -(2.0**127))}
    message = r"drone_1 has -1.7014118e\+38 at index 1.* must lie in \[-1e\+30, 1e\+30\]; clip it"
    refused(env, lambda: env.step(good(env) | change), ValueError, message)
    env = flying("batch", "setpoint")
    while env.agents:  # absurd, but allowed: everything stays finite until it ends
        observations, rewards, *_ = env.step({agent: np.full(14, 1e30) for agent in env.agents})
        assert all(np.isfinite(row).all() for row in observations.values())
        assert all(np.isfinite(reward) for reward in rewards.values())


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"strat": [[0, 0, 1], [1, 0, 1]]}, r"unknown reset option 'strat'; did you mean 'start'"),
        ({"start": [[0, 0, 1], [0.1, 0, 1]]}, r"drones 0 and 1 are 0.100 m apart, closer than the"),
        ({"goal": [[0, 0, 1], [0, 0.15, 1]]}, r"goals of drones 0 and 1 are 0.150 m .* apart"),
        ({"start": [[0, 0, 1], [2.5, 0, 1]]}, r"start of drone 1 has x = 2.500 m, but must lie"),
        ({"start": [[0, 0, 0.05], [1, 0, 1]]}, r"start of drone 0 has z = 0.050 m"),
        ({"goal": [[0, 0, 1], [1, 0, 2.6]]}, r"goal of drone 1 has z = 2.600 m"),
        ({"start": [[0, 0, 1]]}, r"start has shape \(1, 3\), but must have shape \(2, 3\)"),
        ({"start": [[0, 0, np.nan], [1, 0, 1]]}, r"start is nan at index \(0, 2\)"),
        ({"start": "above"}, r"start is 'above', but must be numbers"),
    ],
)
def test_bad_resets(engine, options, message):
    env = flying(engine)
    refused(env, lambda: env.reset(options=options), ValueError, message)
    env = flying(engine)
    refused(env, lambda: env.reset(seed=9, options=options), ValueError, message)


def test_step_without_an_episode(engine):
    env = swap_v0.parallel_env(team="LS", physics=engine, horizon_s=0.1)
    actions = {agent: np.zeros(3) for agent in env.possible_agents}
    with pytest.raises(RuntimeError, match=r"no episode has begun; call reset\(\) first"):
        env.step(actions)
    env.reset(seed=1)
    while env.agents:
        env.step(actions)
    before = everything(env)
    with pytest.raises(RuntimeError, match=r"the episode has ended; call reset\(\) first"):
        env.step(actions)
    assert everything(env) == before
    env.close()
