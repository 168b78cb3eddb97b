"""Actions, and every field of an observation against numbers computed in another way."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from swarm_envs import make, swap_v1
from swarm_envs.envs.config import EnvConfig
from swarm_envs.envs.core import SwarmCore
from swarm_envs.envs.observation import ObservationField, observation_layout, shaper
from swarm_envs.envs.options import batch_of
from swarm_envs.envs.parallel import SwarmParallelEnv
from swarm_envs.interactions import load
from swarm_envs.motors import BatteryModel
from swarm_envs.tasks.swap import SwapTask
from swarm_envs.vehicles import LARGE, SMALL, SMALL_STRONG, VEHICLES, Vehicle, parse_team

FLOWN = {
    "S": SMALL,
    "L": LARGE,
    "S*": SMALL_STRONG,
    "light": replace(SMALL, mass=0.7 * SMALL.mass),
    "heavy": replace(LARGE, mass=1.3 * LARGE.mass),
}
every_vehicle = pytest.mark.parametrize("vehicle", FLOWN.values(), ids=FLOWN)


def lone(vehicle: Vehicle = SMALL, engine: str = "batch", **options: Any) -> SwarmParallelEnv:
    """One drone in still air, 1 m high in the middle of the arena."""
    env = swap_v1.parallel_env(team=[vehicle], physics=engine, interactions="none", **options)
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


TEAM = "LSS*SL"
TYPES = list(VEHICLES)


def shaken(
    seed: int = 2, steps: int = 20, **options: Any
) -> tuple[SwarmParallelEnv, dict[str, Any]]:
    """An environment after some random accelerations, and what was observed there."""
    env = swap_v1.parallel_env(**{"team": TEAM, "physics": "batch", **options})
    observations, _ = env.reset(seed=seed)
    rng = np.random.default_rng(seed)
    mode = env.core.mode
    for _ in range(steps):
        shape = (len(env.agents), mode.width)
        actions = rng.uniform(-1, 1, shape) if mode.name != "rotors" else rng.normal(0, 0.1, shape)
        observations = env.step(dict(zip(env.agents, actions, strict=True)))[0]
        assert env.agents
    return env, observations


def fields(env: SwarmParallelEnv, row: np.ndarray) -> dict[str, np.ndarray]:
    """The named fields of a row in their units."""
    return {f.name: row[f.where].astype(float) * f.scale for f in env.observation_layout}


def near(actual: np.ndarray, expected: np.ndarray | float) -> None:
    np.testing.assert_allclose(actual, expected, rtol=3e-7, atol=3e-7)


@pytest.mark.parametrize("num_neighbors", [0, 1, 3, 7])
def test_layout_covers_the_row_without_gaps(num_neighbors):
    layout = observation_layout(num_neighbors)
    env = swap_v1.parallel_env(team="LS", physics="batch", num_neighbors=num_neighbors)
    assert env.observation_layout == layout
    covered = [k for field in layout for k in range(field.where.start, field.where.stop)]
    assert env.observation_space("drone_0").shape == (len(covered),)
    assert covered == list(range(len(covered)))
    assert len({field.name for field in layout}) == len(layout)
    assert sum(field.name.startswith("neighbor_") for field in layout) == 5 * num_neighbors
    assert all(isinstance(field, ObservationField) and field.scale > 0 for field in layout)


def test_self(engine):
    env, observations = shaken(physics=engine)
    state = env.view.state
    for i, agent in enumerate(env.agents):
        seen, vehicle = fields(env, observations[agent]), env.view.team[i]
        turn = Rotation.from_quat(state.quaternion[i].copy())
        near(seen["self.position"], state.position[i])
        near(seen["self.velocity"], state.velocity[i])
        near(seen["self.attitude"], turn.as_matrix().ravel())
        rate = turn.inv().apply(state.angular_velocity[i].copy())
        np.testing.assert_allclose(seen["self.body_rate"], rate, rtol=1e-6, atol=3e-6)
        near(seen["self.thrust"], state.rotor_thrust[i].sum() / vehicle.max_thrust)
        near(seen["self.setpoint_offset"], env.view.setpoint.position[i] - state.position[i])
        assert seen["self.type"].tolist() == [float(t == vehicle.token) for t in TYPES]
    assert np.abs(state.angular_velocity).max() > 0.5  # the flight was shaken
    env.close()


@pytest.mark.parametrize("num_neighbors", [2, 3, 6])
def test_neighbors(num_neighbors):
    env, observations = shaken(num_neighbors=num_neighbors)
    state, goals = env.view.state, env.view.goals
    for i, agent in enumerate(env.agents):
        seen = fields(env, observations[agent])
        distance = np.linalg.norm(state.position - state.position[i], axis=1)
        others = [j for j in np.argsort(distance) if j != i][:num_neighbors]
        for k, j in enumerate(others):
            near(seen[f"neighbor_{k}.position"], state.position[j] - state.position[i])
            near(seen[f"neighbor_{k}.velocity"], state.velocity[j] - state.velocity[i])
            near(seen[f"neighbor_{k}.goal"], goals[j] - state.position[j])
            expected = [float(t == env.view.team[j].token) for t in TYPES]
            assert seen[f"neighbor_{k}.type"].tolist() == expected
            assert seen[f"neighbor_{k}.mask"] == [1.0]
        for k in range(len(others), num_neighbors):
            for name in ("position", "velocity", "goal", "type", "mask"):
                assert not seen[f"neighbor_{k}.{name}"].any()


def test_load_and_predicted_force():
    """As estimated in the hall, beside the other fields, which stay what they were."""
    heavy = replace(SMALL, mass=0.05)
    given: dict[str, Any] = {"team": (heavy, *parse_team("LS*S")), "world": "hall"}
    given |= {"battery": BatteryModel(), "num_neighbors": 3}
    env, observations = shaken(**given, observe_load=True, observe_force="learned")
    plain, rows = shaken(**given)
    state, team = env.view.state, env.view.team
    mass = np.array([vehicle.mass for vehicle in team])
    drones = env.core.world.drones[0]
    margin = 4 * drones["rotor_limit"] / (9.80665 * mass) - 1
    battery = drones["battery"]
    assert (battery < 1.0).all()
    position = state.position + drones["position_error"]
    velocity = state.velocity + drones["velocity_error"]
    force = load("learned").forces(position[None], velocity[None], team)[0]
    for i, agent in enumerate(env.agents):
        seen, before = fields(env, observations[agent]), fields(plain, rows[agent])
        assert all((seen[name] == value).all() for name, value in before.items())
        near(seen["self.force"], force[i] / (9.80665 * mass[i]))
        others = [j for j in np.argsort(np.linalg.norm(position - position[i], axis=1)) if j != i]
        for name, j in zip(("self", *(f"neighbor_{k}" for k in range(3))), (i, *others)):
            near(seen[f"{name}.thrust_margin"], margin[j])
            near(seen[f"{name}.mass_ratio"], mass[j] / 0.034)
            near(seen[f"{name}.battery"], battery[j])
    shaped = shaper("dict", 3, 0, True, True)(observations["drone_0"])
    assert shaped["neighbors"].shape == (3, 15)
    assert shaped["mask"].tolist() == [1.0, 1.0, 1.0]


def test_set_points_are_observed_without_noise():
    env, observations = shaken(
        observe_setpoint=True, randomization="position_noise_m=0.1,velocity_noise=0.5"
    )
    drones = env.core.world.drones[0]
    assert (np.abs(drones["setpoint_velocity"]) > 1e-3).all()
    for i, agent in enumerate(env.agents):
        seen = fields(env, observations[agent])
        near(seen["self.setpoint_velocity"], drones["setpoint_velocity"][i])
        near(seen["self.setpoint_acceleration"], drones["setpoint_acceleration"][i])
        off = seen["self.velocity"] - drones["velocity"][i]
        assert (np.abs(off) > 1e-4).all()
    for action in ("ctbr", "rotors"):
        with pytest.raises(ValueError, match=f"with action='{action}' there is no set-point"):
            make("swap_v1", action=action, observe_setpoint=True)


def test_the_scale_of_noise_is_drawn_for_each_environment():
    noise = "position_noise_m=0.1,velocity_noise=0.5"
    rows = {}
    for scale in ("0:0", "1:1", "0.5:0.5"):
        given = f"{noise},noise_scale={scale}"
        env = make("swap_v1", num_drones=2, physics="batch", randomization=given)
        rows[scale] = np.stack([*env.reset(seed=3)[0].values()]).astype(float)
        if scale == "0:0":
            assert np.array_equal(rows[scale], env.core.true_rows(*env.core.form[1:])[0])
    own = np.s_[:, :6]  # position and velocity of the drone itself
    full, half = (rows[s][own] - rows["0:0"][own] for s in ("1:1", "0.5:0.5"))
    assert (np.abs(full) > 1e-5).all()
    np.testing.assert_allclose(half, full / 2, atol=1e-6)
    found = batch_of("swap_v1", num_drones=2, randomization=f"{noise},noise_scale=0:1")
    core = SwarmCore(found.task, found.config, 64)
    core.reset(list(range(64)))
    drawn = core.world.environments["noise_scale"]
    assert 0.0 <= drawn.min() < 0.1 < 0.9 < drawn.max() <= 1.0


def test_bad_noise_is_refused():
    with pytest.raises(ValueError, match=r"noise_scale is \(0.0, 1.0\), but there is no noise"):
        make("swap_v1", randomization="noise_scale=0:1")
    with pytest.raises(ValueError, match="position_noise_m=0:1, but must be one number"):
        make("swap_v1", randomization="position_noise_m=0:1")


@pytest.mark.parametrize("layout", ["random", "stacked"])
def test_task(layout):
    env, observations = shaken(team="LSS*", layout=layout, horizon_s=5.0)
    view = env.view
    reference = view.reference(view.time)
    for i, agent in enumerate(env.agents):
        seen, p = fields(env, observations[agent]), view.state.position[i]
        near(seen["task.goal"], view.goals[i] - p)
        near(seen["task.reference_position"], reference.position[i] - p)
        near(seen["task.reference_velocity"], reference.velocity[i])
        near(seen["task.reference_acceleration"], reference.acceleration[i])
        near(seen["task.time_left"], 1.0 - view.time / 5.0)
    assert view.time == pytest.approx(20 / 48)
    moving = np.abs(reference.velocity).max() > 0.01
    assert moving == (layout == "stacked")


def test_rotors_have_no_setpoint():
    env, observations = shaken(action="rotors", steps=3)
    for agent in env.agents:
        assert not fields(env, observations[agent])["self.setpoint_offset"].any()
