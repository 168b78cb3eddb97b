"""Columns, delivery and gates: draws, success, and that aerodynamics decide."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import swarm_envs
from swarm_envs.agents import fly_episode, load
from swarm_envs.baselines.neural_swarm.downwash import place_heavy_on_top
from swarm_envs.envs.config import EnvConfig
from swarm_envs.envs.core import SwarmCore
from swarm_envs.envs.joint import make_joint
from swarm_envs.envs.parallel import SwarmParallelEnv
from swarm_envs.tasks.base import Success
from swarm_envs.tasks.columns import ColumnsTask, column_team
from swarm_envs.tasks.delivery import DOCKS, DeliveryTask, delivery_team
from swarm_envs.tasks.gates import GatesTask
from swarm_envs.training.scoreboard.tasks import TASKS, make_scored
from swarm_envs.vehicles import SMALL, parse_team, team_string


def make(task: str, **options: Any) -> SwarmParallelEnv:
    return swarm_envs.make(task, **{"physics": "batch", **options})


def test_columns_are_drawn_within_their_ranges():
    task, gaps, loads, turns, on_top = ColumnsTask(column_team("stack", None)), [], [], [], []
    for seed in range(40):
        drawn = task.place(np.random.default_rng(seed))
        start, (goal,), team = drawn.start, drawn.goals, drawn.team
        assert team is not None
        mass = np.array([vehicle.mass for vehicle in team]) - SMALL.mass
        axes = np.stack([goal[:4, :2], goal[4:, :2]])
        assert np.ptp(axes, axis=1).max() < 1e-12
        assert np.linalg.norm(axes[0, 0] - axes[1, 0]) == pytest.approx(1.5)
        assert start[:, 2] == pytest.approx(goal[:, 2])
        assert np.linalg.norm(start - goal, axis=1) == pytest.approx(0.6)
        for column in (slice(0, 4), slice(4, 8)):
            heights = np.sort(goal[column, 2])
            assert heights[0] == pytest.approx(0.4)
            gaps.append(np.diff(heights))
            assert np.ptp(gaps[-1]) < 1e-12
            assert (mass[column] > 0.0).sum() == 2
            on_top.append(mass[column][goal[column, 2].argmax()] > 0.0)
        loads += mass[mass > 0.0].tolist()
        turns.append(np.arctan2(*goal[0, 1::-1]))
    assert 0.36 <= np.min(gaps) < 0.37
    assert 0.41 < np.max(gaps) <= 0.42
    assert 0.008 <= min(loads) < 0.009
    assert 0.0107 < max(loads) <= 0.011
    assert np.ptp(turns) > 5.0
    assert 20 < np.sum(on_top) < 60


def test_a_sprint_draws_who_stands_above_whom():
    assert team_string(column_team("sprint", None)) == "LLS*LLS*"
    env, tops = make("columns_v0", layout="sprint"), set()
    for seed in range(20):
        env.reset(seed=seed)
        tops.add(env.view.team[int(env.view.goals[:3, 2].argmax())].token)
    assert tops == {"L", "S*"}


def test_docks_are_drawn():
    task, covered, stages = DeliveryTask(delivery_team(7)), [], 3
    for seed in range(60):
        drawn = task.place(np.random.default_rng(seed))
        goals = drawn.goals
        assert goals.shape == (stages, 7, 3)
        docked = goals[:, :DOCKS]
        assert np.hypot(docked[..., 0], docked[..., 1]) == pytest.approx(0.8)
        assert np.all((docked[..., 2] >= 0.093) & (docked[..., 2] <= 0.103))
        for courier in range(DOCKS):  # each visits every dock
            assert len(np.unique(docked[:, courier].round(6), axis=0)) == 3
        assert np.ptp(goals[:, DOCKS:], axis=0).max() == 0.0
        above = goals[0, DOCKS:]
        below = [np.linalg.norm(docked[0, :, :2] - p[:2], axis=1) < 1e-9 for p in above]
        assert np.sum(below) == 4
        assert np.all((above[::2, 2] - docked[0, 0, 2] >= 0.28) & (above[1::2, 2] < 0.82))
        covered.append(int(below[0].argmax()))
    assert set(covered) == {0, 1, 2}


def test_payloads_are_flown_and_leave_with_their_episode():
    env = make("columns_v0")
    for seed in (0, 1):
        env.reset(seed=seed)
        drones = env.core.world.drones[0]
        drawn = env.core.task.place(np.random.default_rng(seed)).team
        assert drawn is not None
        assert drones["mass"].tolist() == [vehicle.mass for vehicle in drawn]
        assert env.view.team == drawn
    state = env.core.get_state()
    other = make("columns_v0")
    other.reset(seed=9)
    other.core.set_state(state)
    assert other.view.team == drawn


def stand(env: SwarmParallelEnv, places: np.ndarray, steps: int) -> dict[str, Any]:
    """Hold drones at places (N, 3) without any flight; return the infos of the last step."""
    infos: dict[str, Any] = {}
    rows = np.pad(places, ((0, 0), (0, 11)))
    for _ in range(steps):
        env.core.world.drones["position"][0] = places
        env.core.world.drones["velocity"][0] = 0.0
        infos = env.step({a: rows[int(a[6:])] for a in env.agents})[4]
        if not env.agents:
            break
    return infos


@pytest.mark.parametrize(("crash", "reached"), [(False, 3), (True, 1)])
def test_stages_are_of_the_whole_team(crash, reached):
    """One courier is flown into the floor after the first stage; the two others do all three."""
    agent, plain = load("pid"), {"interactions": "none", "world": "ideal"}
    env = make("delivery_v0", num_drones=3, **plain, **agent.requires)
    observations, _ = env.reset(seed=1)
    agent.reset(env, 1)
    stood = set()
    while env.agents:
        actions = agent.act(observations, env.view)
        stage = int(env.core.world.environments["stage"][0])
        if crash and stage > 0 and "drone_0" in actions:
            actions["drone_0"][:3] += [0.0, 0.0, -1.0]
        observations, *_, infos = env.step(actions)
        away = np.linalg.norm(env.view.state.position - env.view.goals, axis=1)
        stood |= {stage} if (away[1:] < 0.02).all() else set()
    metrics = next(iter(infos.values()))["episode_metrics"]
    assert stood == {0, 1, 2} and metrics["collided_floor"] == crash
    assert (metrics["stages_reached"], metrics["stages"]) == (reached, 3)
    assert metrics["success"] is not crash
    assert metrics["worst_height_error_m"] is not None


@pytest.mark.parametrize("named", [False, True])
def test_any_drone_may_take_any_place(named):
    """Independent of goals: success follows from the set of places that are taken."""
    success = Success(0.06, 0.5, named=named)
    task = ColumnsTask(column_team("stack", None), payload_kg=(0.0, 0.0), success=success)
    config = EnvConfig(physics="batch", action="setpoint", interactions="none")
    env = SwarmParallelEnv(task, config)
    env.reset(seed=0)
    places = env.view.goals.copy()
    mixed = places[np.random.default_rng(1).permutation(8)]
    infos = stand(env, mixed, 40)
    assert env.agents == [] if not named else len(env.agents) == 8
    assert (env.core.metrics()["worst_height_error_m"] is None) is not named
    if named:
        np.testing.assert_array_equal(env.view.goals, places)
        return
    assert infos["drone_0"]["episode_metrics"]["success"]
    assert infos["drone_0"]["episode_metrics"]["length_s"] == pytest.approx(0.5, abs=0.05)
    np.testing.assert_array_equal(env.view.goals, mixed)  # and nobody lost its place
    env.reset(seed=0)
    stand(env, places + np.array([0.0, 0.0, 0.07]), 40)  # near, but not near enough
    assert len(env.agents) == 8
    np.testing.assert_array_equal(env.view.goals, places)


def test_a_drone_that_stands_at_its_goal_keeps_it():
    core = SwarmCore(ColumnsTask(column_team("stack", 4)), make("columns_v0").core.config)
    core.reset([0])
    goals = core.world.drones["goal"][0].copy()
    core.world.drones["position"][0] = goals[[0, 0, 3, 2]]  # the second stands in the first's
    terms = core.step(np.zeros((1, 4, 3))).reward_terms
    assert terms[0, 0, 2:].tolist() == [0.0, 0.0]  # an exchange is no progress
    np.testing.assert_array_equal(core.world.drones["goal"][0], goals[[0, 1, 3, 2]])
    np.testing.assert_array_equal(core.world.goals[0, 0], goals[[0, 1, 3, 2]])


def test_the_heavy_go_on_top():
    places = np.array([[0, 0, z] for z in (0.4, 0.8, 1.2)] + [[1, 0, z] for z in (0.8, 0.4)])
    chosen = place_heavy_on_top(places, parse_team("LSS*SS*"))  # spare 78 31 54 31 54 g
    assert chosen[:, 2].tolist() == [0.4, 1.2, 0.8, 0.8, 0.4]
    assert chosen[:, 0].tolist() == [0, 0, 0, 1, 1]


def test_what_cannot_be_is_refused():
    for refused, text in (
        (lambda: make("columns_v0", num_drones=20), "use fewer drones or a smaller gap_m"),
        (lambda: make("columns_v0", gap_m=(0.1, 0.2)), "use a larger gap"),
        (lambda: make("delivery_v0", num_drones=10), "use at most 9"),
        (lambda: make("delivery_v0", team="S*LS*"), "couriers dock at 0.093 m, but .* 0.095 m"),
    ):
        with pytest.raises(ValueError, match=text):
            refused()
    for task in ("columns_v0", "delivery_v0"):
        env = make(task)
        env.reset(seed=0)
        with pytest.raises(ValueError, match="a goal is given"):
            env.reset(seed=0, options={"goal": env.view.goals.copy()})


def test_teams_of_one_fly_in_every_interface():
    for task in ("columns_v0", "delivery_v0"):
        joint = make_joint(task, num_drones=1, physics="batch", horizon_s=0.1)
        rows, _ = joint.reset(seed=0)
        assert joint.observation_space.contains(rows)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["air-stack-8-v3", "air-sprint-8-v3", "air-delivery-7-v2"])
def test_aerodynamics_decide(name):
    """Of 8 episodes each; docs/tasks/columns.md has the results of many more."""

    def rate(agent: str, interactions: str) -> float:
        task, flown = TASKS[name], load(agent)
        setting = {**task.setting, "interactions": interactions, **flown.requires}
        env = make_scored(task.environment, setting)
        return float(np.mean([fly_episode(env, flown, seed)["success"] for seed in range(8)]))

    aware = "heavy-on-top" if "stack" in name else "downwash-aware"
    assert rate("pid", "none") >= 0.75
    assert rate("pid", "learned") <= 0.5
    assert rate(aware, "learned") >= 0.75


AGENT = load("straight-line")


def gates(**options: Any) -> SwarmParallelEnv:
    given = {"physics": "batch", "world": "ideal", "interactions": "none", "num_drones": 2}
    return swarm_envs.make("gates_v0", **{**given, **AGENT.requires, **options})


def test_columns_stand_between_posts_there_and_back():
    task = GatesTask(parse_team("SSS"), gap_m=(0.3, 0.4))
    tops, sides = set(), set()
    for seed in range(20):
        start, goals, *_ = task.place(np.random.default_rng(seed))
        assert goals.shape == (8, 3, 3)
        for column in (start, *goals):
            assert np.ptp(column[:, :2], axis=0).max() == 0.0
            gaps = np.diff(np.sort(column[:, 2]))
            assert gaps[0] == pytest.approx(gaps[1]) and 0.3 <= gaps[0] <= 0.4
            assert 0.4 <= column[:, 2].min() <= 0.8
            assert column[:, 2].argsort().tolist() == start[:, 2].argsort().tolist()
        np.testing.assert_array_equal(goals[:4], goals[:3:-1])
        for x, y in goals[:, 0, :2]:
            rows = task.obstacle_rows  # a column's begins with its kind and its centre
            beside = np.sort(np.hypot(x - rows[:, 1], y - rows[:, 2]))
            np.testing.assert_allclose(beside[:2], 0.35)
        tops.add(int(start[:, 2].argmax()))
        sides.add(float(start[0, 0]))
    assert tops == {0, 1, 2} and sides == {-1.65, 1.65}
    assert len(task.obstacles) == 8
    assert task.with_team(parse_team("LLL")).obstacles == task.obstacles


def test_a_gate_counts_when_all_are_in_it_at_once():
    env = gates()
    observations, _ = env.reset(seed=3)
    AGENT.reset(env, 3)
    places, passed, alone = env.core.world.goals[0].copy(), 0, 0
    while env.agents:
        np.testing.assert_array_equal(env.view.goals, places[passed])
        actions = AGENT.act(observations, None)
        if passed == 1 and env.view.time < 6.0:
            actions["drone_1"] = -np.clip(env.view.state.velocity[1], -0.2, 0.2).astype(np.float32)
        observations, _, ends, _, infos = env.step(actions)
        inside = np.linalg.norm(env.view.state.position - places[passed], axis=1) < 0.05
        alone += bool(inside[0] and not inside[1])
        passed += bool(inside.all())
        terms = infos["drone_0"]["reward_terms"]
        assert terms["success"] == (1.0 / 8.0 if inside.all() else 0.0)
    metrics = infos["drone_0"]["episode_metrics"]
    assert ends["drone_0"] and metrics["success"] and passed == 8 and alone > 20
    assert metrics["places_passed"] == 16
    assert metrics["gates_per_min"] == pytest.approx(8 / (metrics["length_s"] / 60.0))


def test_unfinished_slaloms_are_scored_by_the_clock():
    positions: list[np.ndarray] = []
    env = gates(horizon_s=5.0)
    metrics = fly_episode(
        env, AGENT, 3, lambda env: positions.append(env.view.state.position.copy())
    )
    passed = 0
    for position in positions[1:]:
        away = np.linalg.norm(position - env.core.world.goals[0, passed], axis=1)
        passed += bool((away < 0.05).all())
    assert not metrics["success"] and 1 <= passed < 8
    assert metrics["gates_per_min"] == pytest.approx(passed / (5.0 / 60.0))


def test_who_is_left_flies_on_and_counts_for_less():
    env = gates(horizon_s=20.0)
    observations, _ = env.reset(seed=3)
    AGENT.reset(env, 3)
    while env.agents:
        actions = AGENT.act(observations, None)
        if "drone_1" in env.agents:
            actions["drone_1"] = np.array([0.0, 0.0, -1.0], np.float32)
        observations, *_ = env.step(actions)
    metrics = env.core.metrics()
    assert metrics["collided_floor"] == 1 and not metrics["success"]
    assert metrics["places_passed"] == 8
    assert metrics["gates_per_min"] == pytest.approx(4 / (metrics["length_s"] / 60.0))


def test_what_it_refuses():
    with pytest.raises(ValueError, match=r"a column of 6 drones .* but must stay below 2\.2 m"):
        GatesTask(parse_team("SSSSSS"))
    with pytest.raises(ValueError, match="goals are the gates; leave it out"):
        GatesTask(parse_team("S")).place(np.random.default_rng(0), goal=np.ones((1, 3)))
