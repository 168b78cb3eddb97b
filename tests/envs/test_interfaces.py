"""Every interface gives the same flight to the last bit, and refuses bad input."""

from __future__ import annotations

import copy
import hashlib
import itertools
import pickle
import subprocess
import sys
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import swarm_envs
from swarm_envs import TASKS, swap_v1
from swarm_envs.envs.joint import make_joint, make_solo
from swarm_envs.envs.vector import make_vector
from swarm_envs.interactions import load
from swarm_envs.physics import bullet_available
from tests.helpers.faces import FACES, Face, core_of, everything

SHORT: dict[str, Any] = {"num_drones": 3, "horizon_s": 1.0}
every_task = pytest.mark.parametrize("task", TASKS)
QUICK: dict[str, dict[str, Any]] = {"formation_v1": {"shape_s": 0.25, "travel_s": 0.2}}


def begun(face: Any, task: str, seed: int = 4, **options: Any) -> Any:
    return face.begin(seed, task, **(QUICK.get(task, {}) | options))


def rows(rng: np.random.Generator) -> list[np.ndarray]:
    return list(rng.uniform(-0.3, 0.3, (3, 3)).astype(np.float32))


def actions_at(step: int) -> list[np.ndarray]:
    return rows(np.random.default_rng(step))


def arrays(value: Any) -> Iterator[np.ndarray]:
    """Every array in what an interface gave."""
    if isinstance(value, np.ndarray):
        yield value
    elif isinstance(value, Mapping):
        for part in value.values():
            yield from arrays(part)
    elif isinstance(value, list | tuple):
        for part in value:
            yield from arrays(part)


def as_bytes(value: Any) -> bytes:
    """All of it: arrays to the last bit, the rest in words."""
    found = b"".join(a.tobytes() + str((a.dtype, a.shape)).encode() for a in arrays(value))
    with np.printoptions(threshold=0, edgeitems=1):
        return found + repr(value).encode()


def flight(face: Any, env: Any, steps: int = 20) -> bytes:
    """Digest of what an environment gives from here on, across an end where there is one."""
    rng, digest = np.random.default_rng(0), hashlib.sha256()
    for _ in range(steps):
        digest.update(as_bytes(face.step(env, rows(rng))))
    return digest.digest()


def by_name(rows: list[np.ndarray]) -> dict[str, np.ndarray]:
    return {f"drone_{i}": row for i, row in enumerate(rows)}


def test_deterministic_flights_are_the_same_to_the_last_bit(face):
    """After each of 24 decisions, on the engine that `deterministic` chooses."""
    env = face.begin(physics=face.default, deterministic=True)
    reference = swap_v1.parallel_env(deterministic=True, **SHORT)
    assert reference.physics_name == "batch"
    reference.reset(seed=4)
    for step in range(24):
        assert everything(env) == everything(reference)
        face.step(env, actions_at(step))
        reference.step(by_name(actions_at(step)))
    assert everything(env) == everything(reference)


@pytest.mark.skipif(not bullet_available(), reason="pybullet is not installed")
def test_what_deterministic_chooses():
    assert swap_v1.parallel_env().physics_name == "bullet"
    assert swap_v1.parallel_env(deterministic=True).physics_name == "batch"
    assert swap_v1.parallel_env(deterministic=True, physics="bullet").physics_name == "bullet"


def test_deterministic_holds_in_float32_and_on_threads():
    fast = load("learned").with_precision("float32")
    many = make_vector("swap_v1", 5, threads=2, interactions=fast, deterministic=True, **SHORT)
    many.reset(seed=0)
    ones = [swap_v1.parallel_env(interactions=fast, deterministic=True, **SHORT) for _ in range(5)]
    for e, env in enumerate(ones):
        env.reset(seed=e)
    for step in range(24):
        many.step(np.stack([np.concatenate(actions_at(step))] * 5))
        for env in ones:
            env.step(by_name(actions_at(step)))
    for e, env in enumerate(ones):
        assert np.array_equal(many.core.physics.state.position[e], env.view.state.position)
    many.close()


@pytest.mark.parametrize("way", ["deepcopy", "pickle"])
def test_copies_fly_on_alike_and_apart(face, way):
    """Through the end of the episode into the next, which the copy begins as the first does."""
    env = face.begin(horizon_s=0.5)
    for step in range(10):
        face.step(env, actions_at(step))
    twin = copy.deepcopy(env) if way == "deepcopy" else pickle.loads(pickle.dumps(env))  # noqa: S301
    start = everything(twin)
    ends = []
    for each in (env, twin):
        assert everything(each) == start
        for step in range(10, 24):
            face.step(each, actions_at(step))
        each.reset()
        face.step(each, actions_at(0))
        ends.append(everything(each))
    assert ends[0] == ends[1] != start


@every_task
def test_same_seed_same_bytes(face, task):
    one, other = begun(face, task), begun(face, task)
    first = flight(face, one)
    assert flight(face, other) == first
    face.reset(one, seed=4)
    assert flight(face, one) == first
    face.reset(one, seed=5)
    assert flight(face, one) != first


@every_task
def test_returned_arrays_are_the_caller_s(face, task):
    """They neither change later, nor does changing them change the flight."""
    env, other, rng = begun(face, task), begun(face, task), np.random.default_rng(0)
    first, seed = face.step(env, sent := rows(rng)), [row.copy() for row in sent]
    kept = [array.copy() for array in arrays(first)]
    storage = [core_of(env).rows, *core_of(env).world]
    assert np.shares_memory(core_of(env).world.drones, core_of(env).physics.state.position)
    for array in arrays(first):
        assert not any(np.shares_memory(array, mine) for mine in storage)
    second = face.step(env, rows(rng))
    for array, before in zip(arrays(first), kept, strict=True):
        np.testing.assert_array_equal(array, before)
    for given, mine in zip(sent, seed, strict=True):
        np.testing.assert_array_equal(given, mine)
    for array in arrays(second):
        if array.flags.writeable and array.dtype.kind == "f":
            array[...] = np.nan
    rng = np.random.default_rng(0)
    for _ in range(2):
        face.step(other, rows(rng))
    assert flight(face, env, 3) == flight(face, other, 3)


def digests() -> list[str]:
    """One for each task through each interface that is installed here."""
    out = []
    for face, task in itertools.product(FACES, TASKS):
        try:
            out.append(flight(face, begun(face, task), 6).hex())
        except ImportError:
            out.append("not installed")
    return out


def test_same_bytes_in_another_process():
    helpers = str(Path(__file__).parents[1] / "helpers")
    script = (
        f"import runpy, sys; sys.path.insert(0, {helpers!r}); "
        f"here = runpy.run_path({__file__!r}); print(*here['digests'](), sep='\\n')"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert done.stdout.split("\n")[:-1] == digests()


def check_refused(
    face: Face,
    call: Callable[[Any], object],
    message: str,
    error: type = ValueError,
    **options: Any,
) -> None:
    """The call is refused; the flight and its generator go on as if it had never been made."""
    env, other = (face.begin(**options) for _ in range(2))
    with pytest.raises(error, match=message):
        call(env)
    rows = actions_at(0)
    if face.name == "turns":  # those before the bad one have decided well
        rows = rows[env.agents.index(env.agent_selection) :]
    face.step(env, rows)
    face.step(other, actions_at(0))
    assert everything(env) == everything(other)
    states = [core_of(each).generators[0].bit_generator.state for each in (env, other)]
    assert states[0] == states[1]
    for each in (env, other):
        each.close()


@pytest.mark.parametrize(
    ("row", "message"),
    [
        ([0, np.nan, 0], "nan at index 1, but every number must be finite"),
        ([0, 0, -np.inf], "-inf at index 2, but every number must be finite"),
        ([1.5, 0, 0], r"1.5 at index 0, but must lie in \[-1, 1\]; clip it"),
    ],
)
def test_bad_actions(face, row, message):
    """Refused, naming the drone, its environment and the rule."""
    rows = actions_at(0)
    rows[1] = np.array(row)
    check_refused(face, lambda env: face.step(env, rows), f"drone_1{face.place} has {message}")


@pytest.mark.parametrize(
    ("row", "message"),
    [
        (np.zeros(2), r"shape \("),
        (np.array(["a", "b", "c"]), "must be numbers"),
        (np.array([None, 0, 0]), "must be numbers"),
        (np.array([True, False, True]), "must be numbers"),
        (np.zeros(3, complex), "must be numbers"),
    ],
)
def test_actions_of_a_wrong_kind(face, row, message):
    check_refused(face, lambda env: face.step(env, [row] * 3), message)


ZERO = np.zeros(3)


@pytest.mark.parametrize(
    ("actions", "error", "message"),
    [
        (
            {"drone_0": ZERO, "drone_1": np.zeros((1, 3)), "drone_2": ZERO},
            ValueError,
            r"'drone_1' has shape \(1, 3\), but action 'acceleration' takes 3 numbers",
        ),
        ({"drone_0": ZERO}, ValueError, r"actions lack \['drone_1', 'drone_2'\]; give one for"),
        ({"drone0": ZERO}, ValueError, "unknown agent 'drone0' in actions; did you mean 'drone_0'"),
        (np.zeros((3, 3)), TypeError, "actions are ndarray, but must be a dict"),
    ],
)
def test_actions_by_agent(engine, actions, error, message):
    check_refused(FACES[0], lambda env: env.step(actions), message, error, physics=engine)


def test_setpoints_that_cannot_be_observed():
    env = swap_v1.parallel_env(num_drones=1, physics="batch", action="setpoint")
    env.reset(seed=3)
    message = r"drone_0 has -1.7014118e\+38 at index 0.* must lie in \[-1e\+30, 1e\+30\]; clip it"
    with pytest.raises(ValueError, match=message):
        env.step({"drone_0": np.full(14, -(2.0**127), np.float32)})
    with pytest.raises(ValueError, match="drone_0 has nan at index 0"):
        env.step({"drone_0": np.full(14, np.nan)})
    while env.agents:  # absurd, but allowed: everything stays finite until it ends
        observations, rewards, *_ = env.step({"drone_0": np.full(14, 1e30)})
        assert np.isfinite(observations["drone_0"]).all() and np.isfinite(rewards["drone_0"])


@pytest.mark.parametrize(
    ("options", "error", "message"),
    [
        ({"frameskip": 2}, TypeError, "has no option 'frameskip'; decision_rate is"),
        ({"max_cycles": 2}, TypeError, "option 'max_cycles'; the time limit is horizon_s"),
        ({"continuous": True}, TypeError, "option 'continuous'; every action is continuous"),
        ({"num_drone": 2}, TypeError, "option 'num_drone'; did you mean 'num_drones'"),
        ({"layout": "cricle"}, ValueError, "unknown layout 'cricle'; did you mean 'circle'"),
        ({"team": "SX"}, ValueError, "unknown vehicle token 'X'"),
        ({"num_drones": 0}, ValueError, "num_drones is 0, but must be an integer of at least 1"),
        ({"deterministic": "yes"}, ValueError, "deterministic is 'yes', but must be True or False"),
        ({"render_mode": "rgb"}, ValueError, "rgb"),
    ],
)
def test_bad_options(face, options, error, message):
    with pytest.raises(error, match=message):
        face.make("swap_v1", **options)


def test_options_have_names():
    with pytest.raises(TypeError, match="options have names, such as num_drones=4, but got 8"):
        swap_v1.parallel_env(8)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"interactions": "learnd"}, r"unknown interaction model 'learnd'; did you mean 'learned'"),
        ({"reward_weights": {"sucess": 1}}, "unknown reward term 'sucess'; did you mean 'success'"),
        ({"reward_weights": {"crash": np.nan}}, "'crash' is nan, but must be a finite number"),
        ({"reward_weights": 3}, "reward_weights is 3, but must be a Mapping"),
        ({"team": "S" * 12, "layout": "stacked"}, r"12 drones stacked .* gaps up to 0.149 m or"),
        ({"force_bounds_g": {"S": 0.0}}, r"force_bounds_g\['S'\] is 0.0, but must be positive"),
    ],
)
def test_options_that_no_annotation_excludes(options, message):
    with pytest.raises(ValueError, match=message):
        swap_v1.parallel_env(physics="batch", **options)


def test_unknown_agents():
    env = swap_v1.parallel_env(num_drones=2, physics="batch")
    for space in (env.action_space, env.observation_space):
        with pytest.raises(ValueError, match="unknown agent 'drone_2'; did you mean 'drone_"):
            space("drone_2")


@pytest.mark.parametrize("make", [swarm_envs.make, make_joint, make_solo, make_vector])
def test_unknown_tasks(make):
    with pytest.raises(ValueError, match="unknown task 'swop_v1'; did you mean 'swap_v1'"):
        make("swop_v1")


SPAWNS: list[tuple[dict[str, Any], str]] = [
    ({"strat": 1}, "unknown reset option 'strat'; did you mean 'start'"),
    ({"start": [[0, 0, 1], [0.1, 0, 1], [1, 0, 1]]}, "drones 0 and 1 are 0.100 m apart"),
    ({"goal": [[0, 0, 1], [1, 0, 1], [0, 0.1, 1]]}, "goals of drones 0 and 2 are 0.100 m"),
    ({"start": [[0, 0, 1], [1, 0, 1], [9, 0, 1]]}, "start of drone 2 has x = 9.000 m, but must"),
    ({"start": [[0, 0, 0.05]] * 3}, "z = 0.050 m"),
    ({"start": [[0, 0, 1]]}, r"start has shape \(1, 3\), but must have shape \(3, 3\)"),
    ({"goal": [[0, 0, np.nan]] * 3}, r"goal is nan at index \(0, 2\)"),
    ({"start": "above"}, r"start is 'above', but must be numbers"),
]


@pytest.mark.parametrize(("options", "message"), SPAWNS)
def test_impossible_starts(face, options, message):
    check_refused(face, lambda env: face.reset(env, seed=9, options=options), message)


@pytest.mark.parametrize("seed", [-1, 1.5, "a", True])
def test_bad_seeds(face, seed):
    check_refused(face, lambda env: face.reset(env, seed=seed), "seed")


def test_mixed_seeds_of_a_vector():
    """None goes on with that environment's generator, beside others that are seeded anew."""
    env = make_vector("swap_v1", 3, num_drones=3)
    with pytest.raises(RuntimeError, match="no episode has begun"):
        env.step(np.zeros((3, 9)))
    first, _ = env.reset(seed=[5, 6, 7])
    second, _ = env.reset(seed=[5, None, 7])
    assert np.array_equal(first[[0, 2]], second[[0, 2]]) and not np.array_equal(first[1], second[1])
    single = make_joint("swap_v1", physics="batch", num_drones=3)
    single.reset(seed=6)
    assert np.array_equal(single.reset()[0], second[1])
    assert np.array_equal(env.reset(seed=np.array([5, 6, 7]))[0], first)  # type: ignore[arg-type]
    for seeds, message in (([1, 2], "has 2 entries, but must have 3"), ([1, "a", 2], "'a'")):
        with pytest.raises(ValueError, match=message):
            env.reset(seed=seeds)  # type: ignore[arg-type]


def test_a_pilot_must_fly():
    with pytest.raises(TypeError, match="others is 3, but must be a function from an observation"):
        make_solo("swap_v1", others=3, physics="batch")  # type: ignore[arg-type]


def test_closed(face):
    env = face.begin()
    env.close()
    env.close()
    rows = [np.zeros(3)] * 3
    for call in (lambda: face.step(env, rows), env.reset):
        with pytest.raises(RuntimeError, match="closed environment; make a new one"):
            call()


def test_step_without_an_episode(engine):
    env = swap_v1.parallel_env(team="LS", physics=engine, horizon_s=0.1)
    actions = {agent: np.zeros(3) for agent in env.possible_agents}
    for given in (actions, {}):
        with pytest.raises(RuntimeError, match=r"no episode has begun; call reset\(\) first"):
            env.step(given)
    env.reset(seed=1)
    while env.agents:
        env.step(actions)
    before = everything(env)
    with pytest.raises(RuntimeError, match=r"the episode has ended; call reset\(\) first"):
        env.step(actions)
    assert env.step({}) == ({}, {}, {}, {}, {})  # as SuperSuit's black_death_v3 does
    assert everything(env) == before
    env.close()
    with pytest.raises(RuntimeError, match="closed environment"):
        env.step({})


def test_wrappers_draw_from_the_generator_of_the_episodes():
    env = swap_v1.parallel_env(num_drones=2, physics="batch")
    draws = []
    for _ in range(2):
        env.reset(seed=3)
        draws.append(env.np_random.integers(1000, size=4).tolist())
    assert draws[0] == draws[1] != env.np_random.integers(1000, size=4).tolist()


def test_render_without_a_mode_warns_on_every_interface():
    options: dict[str, Any] = {"num_drones": 2, "physics": "batch"}
    makers: list[Any] = [make_joint, make_solo, make_vector, swarm_envs.make]
    for env in [*(make("swap_v1", **options) for make in makers), swap_v1.env(**options)]:
        env.reset(seed=1)  # does not warn
        with pytest.warns(UserWarning, match='without.* any render mode.* render_mode="human"'):
            assert env.render() is None
