"""Shapes of reward terms, and when a team has succeeded."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from swarm_envs.envs.config import EnvConfig
from swarm_envs.envs.core import SwarmCore
from swarm_envs.tables import SETTINGS_TYPE, new_world
from swarm_envs.tasks.base import SPEED_LIMIT, Success
from swarm_envs.tasks.rewards import REWARD_NAMES, weigh, write_terms
from swarm_envs.tasks.swap import SwapTask
from swarm_envs.vehicles import parse_team

number = st.floats(-1e6, 1e6)


def written(**fields: float) -> dict[str, float]:
    """The terms of a drone with these records, at 25 decisions a second and a horizon of 10 s."""
    world, settings = new_world(1, 1), np.zeros(1, SETTINGS_TYPE)
    settings["decision_s"], settings["horizon_s"] = 0.04, 10.0
    world.drones["active"] = 1.0
    world.drones["clearance"] = world.drones["obstacle_clearance"] = math.inf
    for name, value in fields.items():
        table = world.environments if name == "achieved" else world.drones
        table[name] = value
    out = np.full((len(REWARD_NAMES), 1, 1), np.nan)
    write_terms(world.drones, world.environments, settings, out)
    return dict(zip(REWARD_NAMES, out.ravel().tolist(), strict=True))


@given(number)
def test_proximity(x):
    """From 0 at 2.5 times the sum of radii to 1 where drones touch; obstacles alike."""
    for name in ("clearance", "obstacle_clearance"):
        assert written(**{name: 2.5})["proximity"] == 0.0
        assert written(**{name: 1.0})["proximity"] == 0.04
        assert written(**{name: 1.75})["proximity"] == pytest.approx(0.5 * 0.04)
        expected = 0.04 * np.clip((2.5 - x) / 1.5, 0.0, 1.0)
        assert written(**{name: x})["proximity"] == pytest.approx(expected)
        assert 0.0 <= written(**{name: x})["proximity"] <= 0.04
    nearest = written(clearance=2.0, obstacle_clearance=x)["proximity"]
    assert nearest == written(clearance=min(2.0, x))["proximity"]
    assert written()["proximity"] == 0.0  # of a lone drone


@given(number, number)
def test_progress(before, now):
    seconds = written(last_distance=before, distance=now)["progress"]
    assert seconds == pytest.approx((before - now) / SPEED_LIMIT, abs=1e-9)


@given(st.floats(0.0, 1e3))
def test_bells_are_seconds(x):
    at_goal, tracking = 0.04 * math.exp(-((x / 0.15) ** 2)), 0.04 * math.exp(-100.0 * x * x)
    assert written(distance=x)["at_goal"] == pytest.approx(at_goal)
    assert written(tracking_error=x)["tracking"] == pytest.approx(tracking)


def test_effort_lasts_and_events_do_not():
    told = written(effort=0.5, crashed=1.0, achieved=0.25)
    assert told["effort"] == 0.02
    assert (told["crash"], told["success"]) == (1.0, 0.25)


def test_weighted_sum():
    rng = np.random.default_rng(0)
    terms, weights = rng.normal(size=(7, 3, 4)), rng.normal(size=7)
    rewards = np.full((3, 4), 5.0)
    drones, environments, _ = new_world(3, 4)
    drones["active"], drones["active"][0, 1] = 1.0, 0.0  # one has ended, another now
    drones["active"][2, 2], drones["crashed"][2, 2] = 0.0, 1.0
    expected = np.tensordot(weights, terms, 1)
    expected[0, 1] = 0.0
    active, ended = np.ones((2, 3, 4), np.bool_)
    terminated, truncated = np.zeros((2, 3), np.bool_)
    written = rewards, terminated, truncated, active, ended
    flown = np.array([True, False, True])
    weigh(terms, weights, flown, drones, environments, *written)
    np.testing.assert_allclose(rewards[[0, 2]], expected[[0, 2]], rtol=1e-13)
    np.testing.assert_array_equal(rewards[1], 0.0)
    assert active.tolist() == [[True, False, True, True], [False] * 4, [True] * 4]
    assert np.argwhere(ended).tolist() == [[2, 2]]
    environments["terminated"][0] = True  # ends the episodes of all that still fly
    weigh(terms, weights, flown, drones, environments, *written)
    assert np.argwhere(ended).tolist() == [[0, 0], [0, 2], [0, 3], [2, 2]]
    assert terminated.tolist() == [True, False, False]
    assert not truncated.any()


def hovering(success: Success, start: list[list[float]], steps: int) -> list[bool]:
    """Return the success of a hovering team after each decision; its goals are at z = 1."""
    task = SwapTask(team=parse_team("SS"), success=success)
    core = SwarmCore(task, EnvConfig(physics="batch", interactions="none", end_on_success=False))
    goal = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 1.0]])
    core.reset([0], options={"start": start, "goal": goal})
    succeeded = []
    for _ in range(steps):
        core.step(np.zeros((1, 2, 3)))
        succeeded.append(bool(core.world.environments["succeeded"][0]))
    return succeeded


@pytest.mark.parametrize("hold_s", [0.25, 0.5, 1.0])
def test_success_needs_the_hold(hold_s):
    near = [[0.09, 0.0, 1.0], [1.0, 0.0, 0.91]]
    succeeded = hovering(Success(hold_s=hold_s), near, 60)
    assert succeeded == [k >= round(hold_s * 48) for k in range(1, 61)]


def test_success_needs_every_drone():
    start = [[0.0, 0.0, 1.0], [1.0, 0.11, 1.0]]
    assert not any(hovering(Success(), start, 60))
    assert any(hovering(Success(radius=0.12), start, 60))


def test_leaving_the_goal_starts_the_hold_anew():
    core = SwarmCore(SwapTask(parse_team("S")), EnvConfig(physics="batch", interactions="none"))
    core.reset([0], options={"start": [[0.0, 0.0, 1.0]], "goal": [[0.0, 0.0, 1.0]]})
    inside = []
    for k in range(80):
        core.step(np.array([[[0.6 if k < 16 else -0.6 if k < 48 else 0.0, 0.0, 0.0]]]))
        distance = np.linalg.norm(core.physics.state.position[0, 0] - [0, 0, 1])
        inside.append(bool(distance < 0.10))
    assert inside[0] and not all(inside)
    assert sum(inside) > 24  # half a second in all, but not at a stretch
    assert not core.world.environments["succeeded"][0]
