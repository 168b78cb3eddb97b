"""Ends of episodes, reward terms and metrics; a drone that tumbles stops at once."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from swarm_envs import swap_v1
from swarm_envs.agents import fly_episode
from swarm_envs.baselines.neural_swarm import TrackingAgent
from swarm_envs.envs.parallel import SwarmParallelEnv
from swarm_envs.physics.rigid_body import TUMBLING_RATE
from swarm_envs.tasks.swap import StackedLayout
from swarm_envs.vehicles import GRAM_FORCE, LARGE, SMALL

Infos = dict[str, dict[str, Any]]


def fly(
    env: SwarmParallelEnv, start: Sequence[Sequence[float]], actions: Sequence[Sequence[float]]
) -> tuple[Infos, list[dict[str, float]]]:
    """Fly from the start with the same actions until the end; the last infos and all rewards."""
    env.reset(seed=1, options={"start": start})
    rows = dict(zip(env.agents, np.array(actions, np.float32), strict=True))
    rewards = []
    while True:
        _, reward, terminated, truncated, infos = env.step(rows)
        rewards.append(reward)
        assert len(set(terminated.values())) == len(set(truncated.values())) == 1
        assert not any(terminated[a] and truncated[a] for a in rows)
        assert set(terminated) == set(truncated) == set(infos) == set(reward) == set(rows)
        over = terminated["drone_0"] or truncated["drone_0"]
        assert (env.agents == []) == over
        assert all(("episode_metrics" in info) == over for info in infos.values())
        if over:
            env.close()
            return infos, rewards


def contacts(infos: Infos) -> list[dict[str, Any] | None]:
    return [info.get("contact") for info in infos.values()]


HOVER = [2 * SMALL.hover_rotor_thrust / SMALL.max_rotor_thrust - 1] * 4
CRASHES: list[tuple[str, list[list[float]], list[list[float]], dict[str, Any] | None]] = [
    (
        "collided_drones",
        [[-0.2, 0, 1], [0.2, 0, 1]],
        [[1, 0, 0], [-1, 0, 0]],
        {"drone": "drone_1"},
    ),
    ("collided_floor", [[0, 0, 0.2], [-1, 1, 1]], [[0, 0, -1], [0, 0, 0]], {"floor": True}),
    ("collided_wall", [[1.8, 0, 1], [-1, 1, 1]], [[1, 0, 0], [0, 0, 0]], {"wall": True}),
    ("tumbled", [[0, 0, 1], [-1, 1, 1]], [[1, 1, -1, -1], HOVER], None),
]
"""Crashes of the first of three drones: its metric, starts, actions, and what it touched."""


@pytest.mark.parametrize(("metric", "start", "actions", "contact"), CRASHES)
def test_crashes_end_the_episode(engine, metric, start, actions, contact):
    """Only the drones that crashed are punished, once; the team has not succeeded."""
    mode = "rotors" if len(actions[0]) == 4 else "acceleration"
    still = HOVER if mode == "rotors" else [0.0, 0.0, 0.0]
    env = swap_v1.parallel_env(team="SLS", physics=engine, action=mode)
    infos, rewards = fly(env, [*start, [1, 1, 1]], [*actions, still])
    together = metric == "collided_drones"
    hit = [True, together, False]
    expected = [contact, {"drone": "drone_0"} if together else None, None]
    assert contacts(infos) == expected
    for crashed, (agent, info) in zip(hit, infos.items(), strict=True):
        terms = info["reward_terms"]
        assert (terms["crash"], terms["success"]) == (float(crashed), 0.0)
        assert terms["proximity"] == (1 / 48 if crashed and together else 0.0)
        assert (rewards[-1][agent] < -0.9) == crashed
        assert rewards[0][agent] > -0.9
    metrics = infos["drone_0"]["episode_metrics"]
    assert not metrics["success"]
    for name in ("collided_drones", "collided_floor", "collided_wall", "tumbled"):
        assert metrics[name] == (sum(hit) if name == metric else 0)
    assert metrics["length_s"] == pytest.approx(len(rewards) / 48)
    if together:
        touching = SMALL.radius + LARGE.radius
        in_one_decision = 2 * 2.5 / 48  # the episode ends with the decision in which they touch
        assert touching - in_one_decision < metrics["minimum_separation_m"] < touching


def stacked(agent: TrackingAgent, **options: Any) -> SwarmParallelEnv:
    layout = StackedLayout(radius_m=(0.5, 0.5), duration_s=(3.0, 3.0))
    fixed = {"layout": "stacked", "stacked": layout, "physics": "batch", **agent.requires}
    return swap_v1.parallel_env(**{**fixed, **options})


def watched(
    env: SwarmParallelEnv, agent: TrackingAgent, record: Callable[[SwarmParallelEnv], Any]
) -> tuple[dict[str, Any], list[Any]]:
    """Fly an episode; its metrics, and what `record` gave after the reset and every step."""
    log: list[Any] = []
    metrics = fly_episode(env, agent, seed=4, watch=lambda env: log.append(record(env)))
    return metrics, log


def test_success_ends_the_episode_after_the_hold(engine):
    agent = TrackingAgent()
    env = stacked(agent, team="SS", physics=engine, interactions="none")

    def farthest(env: SwarmParallelEnv) -> float:
        view = env.view
        return np.linalg.norm(view.state.position - view.goals, axis=1).max()

    metrics, distance = watched(env, agent, farthest)
    assert metrics["success"]
    inside = np.array(distance) < 0.10
    assert inside[-25:].all()  # 0.5 s at 48 Hz, from the first decision at which all were there
    assert not inside[-26]
    assert metrics["length_s"] == pytest.approx((len(distance) - 1) / 48)
    assert metrics["time_to_goal_s"] == pytest.approx(metrics["length_s"] - 0.5)
    env.close()


@pytest.mark.parametrize("discount", [1.0, 0.99])
def test_lingering_never_pays(discount):
    """Standing still beside the goal until the clock earns less than holding it."""

    def returned(goal_x: float) -> float:
        env = swap_v1.parallel_env(num_drones=1, physics="batch", interactions="none")
        env.reset(seed=0, options={"start": [[0.0, 0.0, 1.0]], "goal": [[goal_x, 0.0, 1.0]]})
        total, factor = 0.0, 1.0
        while env.agents:
            _, rewards, _, _, infos = env.step({"drone_0": np.zeros(3, np.float32)})
            total, factor = total + factor * rewards["drone_0"], factor * discount
        assert infos["drone_0"]["episode_metrics"]["success"] == (goal_x < 0.1)
        return total

    assert returned(0.0) > 1.2 * returned(0.101)


def test_success_is_rewarded_once_and_may_go_on():
    agent = TrackingAgent()
    env = stacked(agent, team="SS", interactions="none", end_on_success=False, horizon_s=5.0)
    observations, _ = env.reset(seed=4)
    agent.reset(env, 4)
    given = dict.fromkeys(env.agents, 0.0)
    while env.agents:
        observations, _, terminated, truncated, infos = env.step(agent.act(observations, env.view))
        for name, info in infos.items():
            given[name] += info["reward_terms"]["success"]
    assert given == {"drone_0": 1.0, "drone_1": 1.0}
    assert all(truncated.values())
    assert not any(terminated.values())
    assert infos["drone_1"]["episode_metrics"]["success"]
    assert infos["drone_1"]["episode_metrics"]["length_s"] == pytest.approx(5.0)


def test_metrics_against_a_logged_flight(engine):
    """Decisions at 240 Hz, so that the log holds every physics step."""
    agent = TrackingAgent(decision_rate=240)
    env = stacked(agent, team="LSS", physics=engine, end_on_success=False, horizon_s=3.5)

    def record(env: SwarmParallelEnv) -> tuple[np.ndarray, ...]:
        view = env.view
        reference = view.reference(view.time).position
        state = view.state
        arrays = (state.position, reference, view.oracle_force, state.rotor_thrust)
        return tuple(array.copy() for array in arrays)

    metrics, log = watched(env, agent, record)
    position, reference, force, thrust = (np.array(column) for column in zip(*log, strict=True))
    error = np.linalg.norm(position - reference, axis=2)[1:]
    height = np.abs(position - reference)[1:, :, 2]
    assert metrics["worst_tracking_error_m"] == pytest.approx(error.max())
    assert metrics["rms_tracking_error_m"] == pytest.approx(np.sqrt(np.mean(error**2)))
    assert metrics["worst_height_error_m"] == pytest.approx(height.max())
    assert metrics["worst_height_error_by_drone_m"] == pytest.approx(height.max(axis=0))
    assert metrics["worst_tracking_error_by_drone_m"] == pytest.approx(error.max(axis=0))

    pairs = [(0, 1), (0, 2), (1, 2)]
    apart = [np.linalg.norm(position[1:, i] - position[1:, j], axis=1).min() for i, j in pairs]
    assert metrics["minimum_separation_m"] == pytest.approx(min(apart))
    radius = [vehicle.radius for vehicle in env.view.team]
    reach = [radius[i] + radius[j] for i, j in pairs]
    share = dict(zip(pairs, np.array(apart) / reach, strict=True))
    assert min(share.values()) >= 1.0
    near = {i for pair, ratio in share.items() if ratio < 1.5 for i in pair}
    assert metrics["near_misses"] == len(near)

    strongest = np.linalg.norm(force, axis=2).max()
    assert metrics["worst_force_g"] == pytest.approx(strongest / GRAM_FORCE)
    assert metrics["worst_force_g"] > 3.0
    area = np.array([np.pi * vehicle.rotor_radius**2 for vehicle in env.view.team])
    power = thrust[:-1] ** 1.5 / np.sqrt(2 * 1.225 * area[:, None])  # momentum theory
    assert metrics["energy_j"] == pytest.approx(power.sum() / 240)
    there = np.linalg.norm(position - env.view.goals, axis=2) < 0.10
    arrival = (1 + np.flatnonzero(~there.all(axis=1)).max()) / 240
    assert metrics["time_to_goal_s"] == (pytest.approx(arrival) if there[-1].all() else None)
    assert 0.0 <= metrics["fraction_outside_measured_range"] <= 1.0
    env.close()


def test_separation_counts_what_happens_between_decisions():
    """Seen at 240 Hz, whatever the decision rate."""
    closest = []
    for rate in (240, 10):
        env = swap_v1.parallel_env(team="SS", physics="batch", decision_rate=rate, horizon_s=0.6)
        start = [[-0.3, -0.15, 1.0], [0.3, 0.15, 1.0]]
        infos, _ = fly(env, start, [[1, 0, 0], [-1, 0, 0]])
        closest.append(infos["drone_0"]["episode_metrics"]["minimum_separation_m"])
    assert closest[0] == pytest.approx(closest[1], abs=2e-3)


def test_forces_outside_the_measured_range_are_counted():
    """A lone drone's input is its speed: the share of steps flown faster than what was measured."""
    env = swap_v1.parallel_env(team="S", physics="batch", decision_rate=240, horizon_s=1.0)
    fastest = env.core.physics.interactions.notes["input_range"]["environment"][1][1]
    for action, some in ((0.0, False), (1.0, True)):
        env.reset(seed=1, options={"start": [[-1.0, 0.0, 1.0]]})
        speeds = []
        while env.agents:
            speeds.append(abs(env.view.state.velocity[0, 0]))
            infos = env.step({"drone_0": [action, 0.0, 0.0]})[-1]
        share = infos["drone_0"]["episode_metrics"]["fraction_outside_measured_range"]
        assert share == pytest.approx(np.mean(np.array(speeds) > fastest))
        assert (share > 0.2) == some


ROTORS = dict(zip(("drone_0", "drone_1", "drone_2"), ([1, 1, -1, -1], HOVER, HOVER), strict=True))
"""The first drone rolls over, the others hover."""
START = [[0, 0, 2], [-1, 1, 2], [1, 1, 2]]
FIELDS = ("position", "quaternion", "velocity", "angular_velocity", "rotor_thrust")


def flown(
    engine: str, rate: int, rule: str, **options: Any
) -> tuple[list[float], npt.NDArray[np.void]]:
    """Fly a second: the first drone's angular speed after each decision, rad/s; and the records."""
    given: dict[str, Any] = {"num_drones": 3, "action": "rotors", "horizon_s": 1.0, **options}
    env = swap_v1.parallel_env(physics=engine, decision_rate=rate, on_contact=rule, **given)
    env.reset(seed=1, options={"start": START})
    speeds = []
    while env.agents:
        env.step({name: np.array(ROTORS[name], np.float32) for name in env.agents})
        speeds.append(float(np.linalg.norm(env.core.world.drones["angular_velocity"][0, 0])))
    records = env.core.world.drones[0].copy()
    env.close()
    return speeds, records


@pytest.mark.parametrize("rule", ["end_team", "end_pair", "bounce"])
def test_who_tumbles_stops_at_that_physics_step(engine, rule):
    """Against the flight that is evaluated at every physics step: there the episode ended so."""
    speeds, expected = flown(engine, 240, rule)
    first = next(k for k, speed in enumerate(speeds) if speed > TUMBLING_RATE)
    growth = speeds[first] - speeds[first - 1]
    for rate in (1, 24):
        seldom, records = flown(engine, rate, rule)
        assert len(seldom) < len(speeds)
        assert TUMBLING_RATE < max(seldom) <= TUMBLING_RATE + growth
        assert records["tumbling"].tolist() == [1.0, 0.0, 0.0]
        assert records["steps"].tolist() == expected["steps"].tolist()
        assert records["steps"][0] == first + 1
        assert (records["steps"][1] == first + 1) == (rule == "end_team")
        for name in FIELDS:
            np.testing.assert_allclose(records[name], expected[name], rtol=0.0, atol=1e-9)


def test_the_hall_s_estimate_stops_with_the_drone():
    """Its errors are those of the step at which the drone stopped."""
    _, expected = flown("batch", 240, "end_team", world="hall")
    _, records = flown("batch", 1, "end_team", world="hall")
    assert records["steps"].tolist() == expected["steps"].tolist()
    for name in (*FIELDS, "position_error", "velocity_error"):
        np.testing.assert_allclose(records[name], expected[name], rtol=0.0, atol=1e-9)
