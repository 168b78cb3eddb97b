"""Forces as functions: they act and are compensated as compiled models are, on both engines."""

from __future__ import annotations

import functools
import itertools
from typing import Any

import numpy as np
import pytest

import swarm_envs
from swarm_envs.control.config import ControllerConfig
from swarm_envs.interactions import load
from swarm_envs.physics import BatchPhysics
from swarm_envs.physics.step import FAR

WAKE = load("wake")


def wake(position, velocity, types):
    """The shipped wake, as a user would write a model of his own."""
    out = np.zeros_like(position)
    for e, team in enumerate(types):
        out[e] = WAKE.forces(position[e : e + 1], velocity[e : e + 1], "".join(team))[0]
    return out


def flown(interactions, physics, feedforward=None, **options):
    """Positions (T, N, 3) of a stacked swap in which drones do not act."""
    if feedforward is not None:
        options["controller"] = ControllerConfig(feedforward=feedforward)
    options |= {"physics": physics, "interactions": interactions}
    env = swarm_envs.make("swap_v1", team="LS", layout="stacked", **options)
    env.reset(seed=3)
    path = []
    for k in range(40):
        action = np.array([0.4 * np.sin(k / 5.0), 0.3, 0.0], np.float32)
        env.step(dict.fromkeys(env.agents, action))
        if not env.agents:
            break
        path.append(env.view.state.position.copy())
    env.close()
    return np.array(path)


@pytest.mark.parametrize("force_rate", [240, 48])
def test_the_wake_is_the_same_as_a_function(engine, force_rate):
    compiled = flown("wake", engine, force_rate=force_rate)
    ours = flown(wake, engine, force_rate=force_rate)
    assert len(ours) == len(compiled) > 20
    np.testing.assert_allclose(ours, compiled, rtol=0, atol=1e-12)
    still = flown("none", engine)
    assert np.abs(still[: len(ours)] - ours[: len(still)]).max() > 1e-3, "it acts"


def test_a_function_is_compensated_as_the_model(engine):
    compiled = flown("wake", engine, feedforward=WAKE)
    np.testing.assert_allclose(flown("wake", engine, feedforward=wake), compiled, atol=1e-12)


def test_a_function_sees_types_and_ended_drones_far_away_and_is_called_at_its_rate():
    calls = []

    def watched(position, velocity, types):
        calls.append((position.copy(), types))
        return np.zeros_like(position)

    rates = {"force_rate": 48, "decision_rate": 10, "on_contact": "end_pair"}
    env = swarm_envs.make("swap_v1", team="LS", physics="batch", interactions=watched, **rates)
    env.reset(seed=0, options={"start": np.array([[0, 0, 0.2], [1, 0, 1.0]])})
    down = {"drone_0": np.array([0, 0, -1], np.float32), "drone_1": np.zeros(3, np.float32)}
    for k in range(20):
        env.step({name: down[name] for name in env.agents})
        assert len(calls) == -(-24 * (k + 1) // 5)
    assert calls[0][1].tolist() == [["L", "S"]]
    assert env.agents == ["drone_1"]
    assert calls[-1][0][0, 0, 0] == FAR
    assert np.isfinite(env.view.state.position).all()


def test_many_environments_reset_apart_are_each_called_when_due():
    """A force that counts its calls shows when each environment was last due."""
    count = itertools.count(1)
    batch = BatchPhysics("S", 3, lambda p, v, t: np.full(p.shape, next(count)), force_rate=80)
    hover = np.full((3, 1, 4), batch.team[0].hover_rotor_thrust)
    batch.reset()
    batch.step(hover)
    batch.reset(mask=np.array([False, True, False]))
    batch.step(hover)
    assert batch.force[:, 0, 0].tolist() == [1, 2, 1]
    batch.step(hover)
    batch.step(hover)
    assert batch.force[:, 0, 0].tolist() == [3, 2, 3]


@pytest.mark.parametrize(
    ("function", "message"),
    [
        (lambda p, v, t: p[..., 0], r"has shape \(1, 2\), but must have shape \(1, 2, 3\)"),
        (lambda p, v, t: np.nan * p, "is nan at index"),
        (lambda p, v, t: None, "must be numbers of shape"),
    ],
)
def test_functions_that_give_no_forces_are_refused(function, message):
    physics = BatchPhysics("LS", 1, function)
    with pytest.raises(ValueError, match=message):
        physics.step(np.zeros((1, 2, 4)))


def test_a_function_of_other_arguments_is_refused_before_it_is_called():
    two: Any = lambda position, velocity: position  # noqa: E731
    with pytest.raises(ValueError, match="a function of position, velocity, types, but its sig"):
        BatchPhysics("LS", 1, two)
    wrapped: Any = functools.wraps(two)(lambda p, v, t: np.zeros(p.shape))
    BatchPhysics("LS", 1, wrapped).step(np.zeros((1, 2, 4)))
    many: Any = lambda *given: np.zeros(given[0].shape)  # noqa: E731
    BatchPhysics("LS", 1, many).step(np.zeros((1, 2, 4)))


@pytest.mark.parametrize("given", ["3.0", "type('Force', (), {'__call__': wake})"])
def test_what_is_no_force_is_refused(given, tmp_path):
    file = tmp_path / "force.py"
    file.write_text(f"def wake(self, position, velocity, types): ...\nforce = {given}\n")
    with pytest.raises(ValueError, match=r"force' is .*must be a function|a function or an object"):
        load(f"{file}:force")
    for wrong in (3.0, BatchPhysics):
        with pytest.raises(ValueError, match=r"must be a name, a path, a function|is a class"):
            load(wrong)  # type: ignore[arg-type]


def test_functions_are_refused_where_only_a_compiled_model_can_be_asked():
    with pytest.raises(ValueError, match="interaction_torque is True"):
        BatchPhysics("LS", 1, wake, interaction_torque=True)
    with pytest.raises(ValueError, match="observe_force is the function"):
        swarm_envs.make("swap_v1", observe_force=load(wake))


def test_a_model_takes_the_types_that_functions_get():
    rng = np.random.default_rng(0)
    position = rng.uniform(0.7, 1.3, (5, 3, 3))
    velocity, types = rng.normal(size=position.shape), np.array([["L", "S", "S"]] * 5)
    types[1] = ["S", "L", "S"]
    for name in ("learned", "deep-set", "wake", "none"):
        model = load(name)
        force = model.forces(position, velocity, types)
        assert (force[[0, 2, 3, 4]] == model.forces(position, velocity, "LSS*")[[0, 2, 3, 4]]).all()
        assert (force[1] == model.forces(position, velocity, "SLS")[1]).all()
    for bad in (types[:4], types[:, :2], np.array("L")):
        with pytest.raises(ValueError, match="must"):
            load("learned").forces(position, velocity, bad)
