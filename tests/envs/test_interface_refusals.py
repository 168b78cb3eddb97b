"""Bad input to every interface: refused with the value, the rule and the fix; nothing changes."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import swarm_envs
from swarm_envs.envs.joint import make_joint, make_solo
from swarm_envs.envs.vector import make_vector
from swarm_envs.tasks.obstacles import Column
from tests.helpers.faces import everything


def good(step: int) -> list[np.ndarray]:
    rng = np.random.default_rng(step)
    return list(rng.uniform(-0.3, 0.3, (3, 3)).astype(np.float32))


@pytest.mark.parametrize(
    ("row", "message"),
    [
        (np.array([0, np.nan, 0]), "{} has nan at index 1, but every number must be finite"),
        (np.array([0, 0, np.inf]), "{} has inf at index 2, but every number must be finite"),
        (np.array([1.5, 0, 0]), r"{} has 1.5 at index 0, but must lie in \[-1, 1\]; clip it"),
    ],
)
def test_bad_actions(face, row, message):
    """Refused, naming the drone, its environment and the rule."""
    rows = good(0)
    rows[1] = row
    check_refused(face, rows, message.format("drone_1" + face.place))


@pytest.mark.parametrize(
    ("row", "message"),
    [
        (np.zeros(2), r"shape \("),
        (np.zeros(4), r"shape \("),
        (np.array(["a", "b", "c"]), "must be numbers"),
        (np.array([None, 0, 0]), "must be numbers"),
        (np.array([True, False, True]), "must be numbers"),
        (np.zeros(3, complex), "must be numbers"),
    ],
)
def test_actions_of_a_wrong_kind(face, row, message):
    check_refused(face, [row] * 3, message)


def check_refused(face: Any, rows: list[np.ndarray], message: str) -> None:
    """The team's actions are refused, and nothing has changed."""
    env, other = face.begin(), face.begin()
    with pytest.raises(ValueError, match=message):
        face.step(env, rows)
    rows = good(0)
    if face.name == "turns":  # those before the bad one have decided well
        rows = rows[env.agents.index(env.agent_selection) :]
    face.step(env, rows)
    face.step(other, good(0))
    assert everything(env) == everything(other)


@pytest.mark.parametrize(
    ("options", "error", "message"),
    [
        ({"num_drone": 2}, TypeError, "unknown option 'num_drone'; did you mean 'num_drones'"),
        ({"layuot": "circle"}, TypeError, "unknown option 'layuot'; did you mean 'layout'"),
        ({"layout": "cricle"}, ValueError, "unknown layout 'cricle'; did you mean 'circle'"),
        ({"action": "velocty"}, ValueError, "unknown action 'velocty'; did you mean 'velocity'"),
        ({"team": "SX"}, ValueError, "unknown vehicle token 'X'"),
        ({"num_drones": 0}, ValueError, "num_drones is 0, but must be an integer of at least 1"),
        ({"physics": "bulet"}, ValueError, "unknown physics 'bulet'; did you mean 'bullet'"),
        ({"deterministic": "yes"}, TypeError, "deterministic is 'yes', but must be True or False"),
        ({"render_mode": "rgb"}, ValueError, "rgb"),
    ],
)
def test_bad_options(face, options, error, message):
    with pytest.raises(error, match=message):
        face.make("swap_v0", **options)


@pytest.mark.parametrize("make", [swarm_envs.make, make_joint, make_solo, make_vector])
def test_unknown_tasks(make):
    with pytest.raises(ValueError, match="unknown task 'swop_v0'; did you mean 'swap_v0'"):
        make("swop_v0")


SPAWNS: list[tuple[dict[str, Any], str]] = [
    ({"strat": 1}, "unknown reset option 'strat'; did you mean 'start'"),
    ({"start": [[0, 0, 1], [0.1, 0, 1], [1, 0, 1]]}, "drones 0 and 1 are 0.100 m apart"),
    ({"start": [[0, 0, 1], [1, 0, 1], [9, 0, 1]]}, "start of drone 2 has x = 9.000 m, but must"),
    ({"start": [[0, 0, 1]]}, r"start has shape \(1, 3\), but must have shape \(3, 3\)"),
    ({"goal": [[0, 0, np.nan]] * 3}, r"goal is nan at index \(0, 2\)"),
]


@pytest.mark.parametrize(("options", "message"), SPAWNS)
def test_impossible_starts(face, options, message):
    env, other = face.begin(), face.begin()
    with pytest.raises(ValueError, match=message):
        face.reset(env, options=options)
    face.step(env, good(0))
    face.step(other, good(0))
    assert everything(env) == everything(other)


def test_no_room_to_start(face):
    """Drawn a bounded number of times, and then refused with the reason."""
    spots = [(x, y) for x in np.arange(-2.0, 2.1, 0.4) for y in np.arange(-2.0, 2.1, 0.4)]
    forest = [Column(center=spot, radius=0.15) for spot in spots]
    with pytest.raises((RuntimeError, ValueError), match=r"room|apart|spacing"):
        face.begin(obstacles=forest, num_drones=12)


@pytest.mark.parametrize("seed", [-1, 1.5, "a", True])
def test_bad_seeds(face, seed):
    env, other = face.begin(), face.begin()
    with pytest.raises((ValueError, TypeError), match="seed"):
        face.reset(env, seed=seed)
    face.step(env, good(0))
    face.step(other, good(0))
    assert everything(env) == everything(other)


def test_mixed_seeds_of_a_vector():
    """None goes on with that environment's generator, beside others that are seeded anew."""
    env = make_vector("swap_v0", 3, num_drones=3)
    first, _ = env.reset(seed=[5, 6, 7])
    second, _ = env.reset(seed=[5, None, 7])
    assert np.array_equal(first[[0, 2]], second[[0, 2]]) and not np.array_equal(first[1], second[1])
    single = make_joint("swap_v0", physics="batch", num_drones=3)
    single.reset(seed=6)
    assert np.array_equal(single.reset()[0], second[1])
    assert np.array_equal(env.reset(seed=np.array([5, 6, 7]))[0], first)  # type: ignore[arg-type]
    for seeds, message in (([1, 2], "has 2 entries, but must have 3"), ([1, "a", 2], "'a'")):
        with pytest.raises(ValueError, match=message):
            env.reset(seed=seeds)  # type: ignore[arg-type]


def test_a_pilot_must_fly():
    with pytest.raises(TypeError, match="others is 3, but must be a function from an observation"):
        make_solo("swap_v0", others=3, physics="batch")  # type: ignore[arg-type]


def test_closed(face):
    env = face.begin()
    env.close()
    env.close()
    rows = [np.zeros(3)] * 3
    for call in (lambda: face.step(env, rows), env.reset):
        with pytest.raises(RuntimeError, match="closed environment; make a new one"):
            call()
