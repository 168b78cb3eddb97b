"""What actions do: hover, limits, extrapolation, rotors, and vehicles other than the nominal."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from swarm_envs import swap_v0
from swarm_envs.envs.config import EnvConfig
from swarm_envs.envs.core import SwarmCore
from swarm_envs.envs.parallel import SwarmParallelEnv
from swarm_envs.tasks.swap import SwapTask
from swarm_envs.vehicles import LARGE, SMALL, SMALL_STRONG, Vehicle, parse_team

VEHICLES = {
    "S": SMALL,
    "L": LARGE,
    "S*": SMALL_STRONG,
    "light": replace(SMALL, mass=0.7 * SMALL.mass),
    "heavy": replace(LARGE, mass=1.3 * LARGE.mass),
}
every_vehicle = pytest.mark.parametrize("vehicle", VEHICLES.values(), ids=VEHICLES)


def lone(vehicle: Vehicle = SMALL, engine: str = "batch", **options: Any) -> SwarmParallelEnv:
    """One drone in still air, 1 m high in the middle of the arena."""
    env = swap_v0.parallel_env(team=[vehicle], physics=engine, interactions="none", **options)
    env.reset(seed=1, options={"start": [[0.0, 0.0, 1.0]]})
    return env


def repeat(env: SwarmParallelEnv, action: list[float] | np.ndarray, steps: int) -> None:
    for _ in range(steps):
        env.step({"drone_0": np.array(action)})


@every_vehicle
@pytest.mark.parametrize("action", ["acceleration", "rotors"])
def test_no_acceleration_and_hover_thrust_hover(vehicle, engine, action):
    env = lone(vehicle, engine, action=action)
    share = vehicle.mass * 9.80665 / vehicle.max_thrust
    repeat(env, np.zeros(3) if action == "acceleration" else np.full(4, 2.0 * share - 1.0), 96)
    np.testing.assert_allclose(env.view.state.position, [[0.0, 0.0, 1.0]], atol=1e-9)
    env.close()


@every_vehicle
def test_follows_a_setpoint_after_a_disturbance(vehicle):
    """The loop knows its vehicle's own mass: no offset remains."""
    env = lone(vehicle, action="setpoint", horizon_s=30.0, end_on_success=False)
    goal = np.zeros(14)
    goal[:3] = 0.1, -0.1, 1.2
    repeat(env, goal, 48 * 20)
    np.testing.assert_allclose(env.view.state.position, [goal[:3]], atol=1e-3)


def test_rotor_commands_are_a_share_of_the_largest_thrust():
    env = lone(action="rotors")
    repeat(env, [-1.0, 0.0, 0.5, 1.0], 1)
    commands = env.core.world.drones["commands"][0, 0]
    expected = np.array([0.0, 0.5, 0.75, 1.0]) * SMALL.max_rotor_thrust
    np.testing.assert_allclose(commands, expected, rtol=1e-15)
    assert env.view.state.rotor_thrust[0, 0] < SMALL.hover_rotor_thrust < commands[3]


def test_acceleration_moves_the_setpoint():
    """A first-order lag of 0.1 s: acceleration a (1 - exp(-t / 0.1)), its integrals, and back."""
    env, a, tau, t = lone(), np.array([1.5, 0.0, -0.5]), 0.1, 0.5
    repeat(env, [0.3, 0.0, -0.1], round(48 * t))
    setpoint, gone = env.view.setpoint, tau * (1 - np.exp(-t / tau))
    np.testing.assert_allclose(setpoint.acceleration[0], a * gone / tau, atol=3e-3)
    np.testing.assert_allclose(setpoint.velocity[0], a * (t - gone), atol=3e-3)
    moved = a * (t**2 / 2 - tau * (t - gone))
    np.testing.assert_allclose(setpoint.position[0] - [0, 0, 1], moved, atol=3e-3)
    repeat(env, [0.0, 0.0, 0.0], 96)  # it coasts to what was asked for
    np.testing.assert_allclose(env.view.setpoint.velocity[0], a * t, atol=1e-6)


def test_setpoints_stay_below_the_speed_limit():
    env = lone(horizon_s=100.0)
    rng = np.random.default_rng(0)
    env.reset(seed=1, options={"start": [[-1.5, 0.0, 1.0]]})
    fastest = 0.0
    for _ in range(60):  # full ahead until the limit, then turning at it
        repeat(env, [1.0, rng.uniform(-0.2, 0.2), 0.0], 1)
        assert env.agents
        speed = float(np.linalg.norm(env.view.setpoint.velocity[0]))
        assert speed <= 2.0 + 1e-9
        fastest = max(fastest, speed)
        assert np.linalg.norm(env.view.state.velocity[0]) < 2.6  # the drone follows, with overshoot
    assert fastest == pytest.approx(2.0, abs=1e-3)
    assert np.linalg.norm(env.view.state.velocity[0]) > 1.7


def test_setpoint_extrapolates_with_its_jerk():
    rng = np.random.default_rng(3)
    action = rng.uniform(-0.5, 0.5, 14)
    action[2] += 1.0
    for rate in (240, 48, 10):
        env = lone(action="setpoint", decision_rate=rate)
        repeat(env, action, 1)
        t, (p, v, a, j) = 1 / rate, action[:12].reshape(4, 3)
        setpoint = env.view.setpoint
        expected = p + v * t + a * t**2 / 2 + j * t**3 / 6
        np.testing.assert_allclose(setpoint.position[0], expected, atol=1e-14)
        np.testing.assert_allclose(setpoint.velocity[0], v + a * t + j * t**2 / 2, atol=1e-14)
        np.testing.assert_allclose(setpoint.acceleration[0], a + j * t, atol=1e-14)
        np.testing.assert_allclose(setpoint.yaw[0], action[12] + action[13] * t, atol=1e-14)


@pytest.mark.parametrize("rate", [10, 48])
def test_random_accelerations_are_followed(rate):
    """Exploration: the drone stays near the set-point that its actions move."""
    task = SwapTask(team=parse_team("SL"))
    config = EnvConfig(physics="batch", interactions="none", decision_rate=rate, horizon_s=1e3)
    core = SwarmCore(task, config, num_envs=16)
    rng = np.random.default_rng(0)
    core.reset(list(range(16)))
    drones = core.world.drones
    for name in ("position", "setpoint_position"):
        drones[name][..., 2] += 500.0
    core.settings["arena"] = [[-1e3] * 3, [1e3] * 3]
    for _ in range(3 * rate):
        core.step(rng.uniform(-1.0, 1.0, (16, 2, 3)))
        core.running[:] = True
    offset = drones["position"] - drones["setpoint_position"]
    assert np.quantile(np.linalg.norm(offset, axis=-1), 0.95) < 0.25
