"""The safety filter: what it keeps apart, its solver and barrier; agents that avoid each other."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from scipy.optimize import linprog

from examples import tune_agents
from examples.tune_agents import (
    TUNED,
    Case,
    TuneOptions,
    neighbor_of,
    numbers_of,
    tune_agent,
    with_numbers,
)
from swarm_envs import crowd_v0, make, swap_v1
from swarm_envs.agents import Safety, SafetyFilter, fly_episode, load
from swarm_envs.agents.avoiding import CruiseAgent, RoundaboutAgent
from swarm_envs.agents.barrier import (
    ESCAPE,
    TOLERANCE,
    least_broken,
    nearest_feasible_point,
    new_workspace,
    velocity_barrier,
)
from swarm_envs.agents.evaluation import TIMED, evaluate_agent, frozen_seeds
from swarm_envs.agents.protocol import BatchAgent
from swarm_envs.baselines.mlr_dmpc.condensed_qp import solve_qp
from swarm_envs.envs.parallel import SwarmParallelEnv
from swarm_envs.state import FloatArray
from swarm_envs.tasks.obstacles import Column
from tests.helpers.flights import flown


def test_two_that_meet_head_on_pass_each_other_on_the_right():
    start = np.array([[-1.5, 0, 1], [1.5, 0, 1]])
    starts = {"start": start, "goal": start[::-1].copy()}
    for name, safe in (("straight-line", False), ("straight-line+filter", True)):
        agent = load(name)
        env = swap_v1.parallel_env(num_drones=2, physics="batch", **agent.requires)
        side: list[float] = []

        def watch(env: SwarmParallelEnv, side: list[float] = side) -> None:
            position = env.view.state.position
            if abs(position[0, 0] - position[1, 0]) < 0.1:
                side.append(position[0, 1] - position[1, 1])

        metrics = fly_episode(env, agent, 0, watch, options=starts)
        assert metrics["success"] == safe
        assert (metrics["collided_drones"] == 0) == safe
        if safe:
            assert max(side) < -0.12  # the one that flies along x passes on its right, at less y
            assert metrics["minimum_separation_m"] > 0.17
        env.close()


def test_who_is_far_from_everything_is_left_alone():
    agent = load("straight-line")
    both = []
    for one in (agent, SafetyFilter(agent)):
        env = swap_v1.parallel_env(num_drones=2, **{**one.requires, "physics": "batch"})
        ways = {"start": np.array([[-1.0, -1, 1], [-1, 1, 1]])}
        ways["goal"] = ways["start"] + [1.5, 0, 0]
        both.append(fly_episode(env, one, 0, options=ways))
        env.close()
    assert both[0] == both[1]


def test_a_filtered_policy_flies_in_batches_as_it_flies_alone():
    agent, seeds = load("swap-dagger+filter"), frozen_seeds(3, TIMED + 3)
    assert isinstance(agent, SafetyFilter)
    assert isinstance(agent, BatchAgent)
    env = swap_v1.parallel_env(
        num_drones=4, horizon_s=1.5, **{**agent.requires, "physics": "batch"}
    )
    assert env.core.config.num_neighbors == 20  # though the policy observes seven
    for episode in list(evaluate_agent(env, agent, seeds))[TIMED:]:
        assert episode["metrics"] == fly_episode(env, agent, episode["seed"])
    counted = agent.statistics()
    assert 0.0 < counted["acted"] < 0.5
    assert counted["decisions"] > 3 * 15
    env.close()


@pytest.mark.parametrize(("name", "most"), [("straight-line+filter", 1), ("hover", 0)])
def test_collisions_collapse(name, most):
    seeds = frozen_seeds(5, 64)
    found = flown(name, "swap_v1", seeds, num_drones=4, layout="random", force_rate=48)
    assert sum(metrics["collided_drones"] > 0 for metrics in found) <= most  # without: 25 of 64


class Wishes:
    """Each drone always asks for the same action, its own of (N, 3)."""

    privileged = False

    def __init__(self, decision_rate: int, actions: npt.ArrayLike) -> None:
        self.requires: Mapping[str, Any] = {
            "action": "acceleration",
            "decision_rate": decision_rate,
        }
        self._actions = np.array(actions, np.float32)

    def reset(self, env, seed):
        pass

    def act(self, observations, view):
        return dict(zip(observations, self._actions, strict=True))


def test_who_comes_fast_from_behind_seven_others_is_seen_in_time():
    own = load("swap-dagger+filter")
    assert isinstance(own, SafetyFilter)
    angles = np.deg2rad(np.linspace(50.0, 310.0, 7))  # of seven around the first, with a gap
    around = np.stack([0.6 * np.cos(angles), 0.6 * np.sin(angles), 0.0 * angles], axis=1)
    start = np.vstack([np.zeros(3), around, (2.4, 0.0, 0.0)]) + np.array((-1.0, 0.0, 1.2))
    apart = []
    for watched in (7, own.safety.num_neighbors):
        wishes = Wishes(20, [*np.zeros((8, 3)), (-1.0, 0.0, 0.0)])  # the last comes
        agent = SafetyFilter(wishes, Safety(num_neighbors=watched))
        env = swap_v1.parallel_env(num_drones=9, horizon_s=3.0, **agent.requires)
        flown = fly_episode(env, agent, 0, options={"start": start})
        apart.append(flown["minimum_separation_m"])
        env.close()
    assert apart[0] + 0.03 < apart[1]  # the first gives way before the other is among the seven


def test_walls_are_kept_away_from():
    for safety, crashes in ((Safety(), 0), (Safety(walls=False), 1)):
        agent = SafetyFilter(Wishes(10, [(1.0, 0.3, -1.0), (-1.0, -0.3, 1.0)]), safety)
        assert not isinstance(agent, BatchAgent)
        options = {**agent.requires, "physics": "batch", "horizon_s": 4.0}
        env = swap_v1.parallel_env(num_drones=2, **options)
        metrics = fly_episode(env, agent, 1)
        touched = metrics["collided_wall"] + metrics["collided_floor"]
        assert (touched > 0) == bool(crashes)
        env.close()


@pytest.mark.parametrize(
    ("name", "hits", "arrives"),
    [
        ("straight-line", True, False),
        ("straight-line+filter", False, False),
        ("fast-line", False, True),
    ],
)
def test_obstacles_are_kept_away_from(name, hits, arrives):
    agent, post = load(name), (Column((0.0, 0.0), 0.3),)
    env = swap_v1.parallel_env(
        num_drones=2, obstacles=post, **{**agent.requires, "physics": "batch"}
    )
    start = np.array([[-1.5, 0.0, 1.0], [-1.5, 1.5, 1.0]])
    metrics = fly_episode(
        env, agent, 0, options={"start": start, "goal": start + 3.0 * np.eye(3)[0]}
    )
    assert (metrics["collided_obstacle"] > 0) == hits
    assert metrics["success"] == arrives
    env.close()


def test_what_cannot_be_filtered_is_refused():
    with pytest.raises(ValueError, match=r"needs action='acceleration', but the agent requires"):
        load("detour+filter")
    assert isinstance(load("orca"), SafetyFilter)
    with pytest.raises(ValueError, match="'orca' already has a filter"):
        load("orca+filter")
    with pytest.raises(ValueError, match=r"'straight-line\+filter' already has a filter"):
        load("straight-line+filter+filter")
    agent = load("hover+filter")
    env = swap_v1.parallel_env(num_drones=2, **agent.requires)
    env.reset(seed=0)
    agent.reset(env, 0)
    agent.agent.act_batch = lambda rows: np.full((*rows.shape[:-1], 3), np.nan)  # type: ignore
    agent.agent.act = lambda rows, view: {k: np.full(3, np.nan) for k in rows}  # type: ignore
    with pytest.raises(ValueError, match="must be finite"):
        agent.act(env.reset(seed=0)[0], None)
    env.close()


BOX = np.concatenate([np.eye(3), -np.eye(3)])


def program(
    rng: np.random.Generator, rows: int, tight: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """A target, and rows of which the first six are a box."""
    normals = rng.normal(size=(rows, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    bound = np.concatenate([np.full(6, -5.0), rng.normal(tight, 2.0, rows)])
    return rng.normal(0.0, 4.0, 3), np.concatenate([BOX, normals]), bound


def test_the_nearest_point_is_that_of_a_quadratic_program():
    rng, work, out = np.random.default_rng(0), new_workspace(20), np.zeros(3)
    found = 0
    for k in range(200):
        target, rows, bound = program(rng, k % 10, -2.0)
        theirs = solve_qp(-target, rows, bound, np.zeros(len(rows), dtype=np.bool_))
        assert nearest_feasible_point(target, rows, bound, len(rows), work, out) == theirs.solved
        if theirs.solved:
            assert out == pytest.approx(theirs.y, abs=1e-6)
            found += 1
    assert 100 < found < 200  # some can be satisfied, some cannot


def test_what_cannot_be_satisfied_is_broken_the_least():
    rng, work, out = np.random.default_rng(1), new_workspace(20), np.zeros(3)
    broken = 0
    for k in range(200):
        target, rows, bound = program(rng, 2 + k % 8, 1.0)
        worst = least_broken(target, rows, bound, 6, len(rows), work, out)
        slack = np.concatenate([np.zeros(6), np.ones(len(rows) - 6)])
        least = linprog(  # the smallest s with rows @ x + s >= bound, the box kept
            [0, 0, 0, 1],
            A_ub=-np.column_stack([rows, slack]),
            b_ub=-bound,
            bounds=[(None, None)] * 3 + [(0, None)],
        )
        assert worst == pytest.approx(least.fun, abs=1e-6)
        assert (rows @ out >= bound - worst * slack - 2 * TOLERANCE).all()
        broken += worst > 0
    assert 20 < broken < 200


def test_equal_and_opposite_rows_and_a_target_that_is_fine():
    work, out = new_workspace(8), np.zeros(3)
    rows = np.array([[1.0, 0, 0], [-1.0, 0, 0], [1.0, 0, 0], [0, 0, -1.0]])
    bound = np.array([1.0, -1.0, 1.0, -2.0])
    assert nearest_feasible_point(np.array([3.0, 4.0, 5.0]), rows, bound, 4, work, out)
    assert out == pytest.approx([1.0, 4.0, 2.0])
    assert nearest_feasible_point(np.array([1.0, 4.0, 2.0]), rows, bound, 4, work, out)
    assert out.tolist() == [1.0, 4.0, 2.0]
    bound[1] = -0.5  # x >= 1 and x <= 0.5
    assert not nearest_feasible_point(np.zeros(3), rows, bound, 4, work, out)


def closest(x: FloatArray, v: FloatArray, horizon: float) -> float:
    """Smallest distance within the horizon, on a fine grid of times."""
    times = np.linspace(0.0, horizon, 4001)
    return float(np.linalg.norm(x - times[:, None] * v, axis=1).min())


def test_the_barrier_is_the_distance_to_velocities_that_collide():
    rng, reach, horizon = np.random.default_rng(2), 0.22, 0.8
    inside = 0
    for _ in range(200):
        x = rng.normal(size=3)
        x *= rng.uniform(0.25, 1.5) / np.linalg.norm(x)
        v = rng.normal(0.0, 0.5, 3) + 2.0 * x
        *n, h = velocity_barrier(tuple(x), tuple(v), reach, horizon)
        normal = np.array(n)
        assert np.linalg.norm(normal) == pytest.approx(1.0)
        assert (closest(x, v, horizon) < reach - 1e-4) <= (h < 1e-3)
        assert (closest(x, v, horizon) > reach + 1e-4) <= (h > -1e-3)
        on_edge = v - h * normal  # the nearest velocity that just misses, or just touches
        assert closest(x, on_edge, horizon) == pytest.approx(reach, abs=2e-4)
        for _ in range(20):  # and no nearer one is on the other side
            turn = rng.normal(size=3)
            other = v + 0.95 * abs(h) * turn / np.linalg.norm(turn)
            assert (closest(x, other, horizon) < reach) == (h < 0)
        inside += h < 0
    assert 30 < inside < 170


def test_no_accepted_velocity_brings_drones_nearer_that_are_too_near():
    """Nor through each other."""
    rng, reach = np.random.default_rng(4), 0.25
    accepted = 0
    for _ in range(2000):
        x = rng.normal(size=3)
        x *= rng.uniform(0.02, 1.0) * reach / np.linalg.norm(x)
        v = rng.normal(0.0, 1.5, 3)
        *n, h = velocity_barrier(tuple(x), tuple(v), reach, 0.7)
        least = closest(x, v, ESCAPE)
        assert np.linalg.norm(n) == pytest.approx(1.0)
        if h >= 0.0:
            accepted += 1
            assert least == pytest.approx(np.linalg.norm(x))  # apart from the first moment on
            assert np.linalg.norm(x - ESCAPE * v) >= reach - 1e-9
    assert accepted > 200


@pytest.mark.parametrize(("name", "most"), [("straight-line+filter", 13), ("fast-line", 12)])
def test_too_many_straight_ways_through_one_place_are_refused(name, most):
    agent = load(name)
    for drones, layout in ((16, "random"), (most, "circle")):
        env = make("swap_v1", num_drones=drones, layout=layout, **agent.requires)
        env.reset(seed=0)
        agent.reset(env, 0)
    env = swap_v1.parallel_env(num_drones=most + 1, layout="circle", **agent.requires)
    env.reset(seed=0)
    why = rf"{most + 1} drones .* at most {most}; use the agent 'roundabout'"
    with pytest.raises(ValueError, match=why):
        agent.reset(env, 0)


def test_a_margin_that_lets_drones_touch_is_refused():
    with pytest.raises(ValueError, match=r"margin_m is 0.02, but must be at least aside_m, 0.03"):
        Safety(margin_m=0.02)
    assert Safety(margin_m=0.0, aside_m=0.0).margin_m == 0.0


@pytest.mark.parametrize("name", ["fast-line", "orca", "roundabout"])
def test_they_see_no_truth_and_swap_four(name):
    agent = load(name)
    assert not agent.privileged
    env = swap_v1.parallel_env(num_drones=4, **{**agent.requires, "physics": "batch"})
    episodes = list(evaluate_agent(env, agent, frozen_seeds(11, 24), timed=2))
    assert all(each["metrics"]["success"] for each in episodes)
    assert episodes[3]["metrics"] == fly_episode(env, agent, episodes[3]["seed"])
    env.close()


@pytest.mark.parametrize("drones", [8, 16])
def test_the_roundabout_solves_the_circle(drones):
    options = {"num_drones": drones, "layout": "circle"}
    found = flown("roundabout", "swap_v1", frozen_seeds(12, 8), timed=1, **options)
    assert all(metrics["success"] for metrics in found)


@pytest.mark.parametrize("layout", ["forest", "buildings"])
def test_they_fly_around_obstacles(layout):
    """Without avoidance they reach three goals a minute, and none is left in the end."""
    options = {"num_drones": 16, "layout": layout}
    found = flown("roundabout", "crowd_v0", frozen_seeds(11, 4), timed=1, **options)
    assert np.mean([metrics["throughput_per_min"] for metrics in found]) > 16.0
    assert all(metrics["success"] and not metrics["collided_obstacle"] for metrics in found)


def test_who_flies_into_an_obstacle_turns_right():
    line = CruiseAgent()
    env = crowd_v0.parallel_env(num_drones=16, **line.requires)
    row = np.stack(list(env.reset(seed=3)[0].values()))[:1]
    line.reset(env, 3)
    where = {field.name: field.where for field in env.observation_layout}
    wanted = np.array([[1.5, 0.0, 0.3]])
    for ahead, (x, y, z) in ((2.0, wanted[0]), (0.2, (0.0, -1.5, 0.3)), (-0.2, wanted[0])):
        for k in range(3):
            row[:, where[f"obstacle_{k}.mask"]] = k == 0
        row[:, where["obstacle_0.offset"]] = (ahead, 0.0, 0.0)
        assert line._around(row, wanted) == pytest.approx(np.array([[x, y, z]]), abs=1e-6)
    env.close()


def test_who_is_alone_flies_straight_at_the_cruise_speed():
    """And who meets several others turns right, slows down and keeps off their height."""
    line, turn = CruiseAgent(), RoundaboutAgent()
    env = swap_v1.parallel_env(num_drones=8, layout="circle", **turn.requires)
    rows = np.stack(list(env.reset(seed=3)[0].values()))
    line.reset(env, 3)
    turn.reset(env, 3)
    where = {field.name: field.where for field in env.observation_layout}
    way = rows[:, where["task.goal"]]
    straight, turned = line.wanted(rows, way), turn.wanted(rows, way)
    speed = np.linalg.norm(straight, axis=1)
    assert speed == pytest.approx(line.cruise.speed_mps, abs=1e-5)
    assert straight / speed[:, None] == pytest.approx(way / np.linalg.norm(way, axis=1)[:, None])
    cross = way[:, 0] * turned[:, 1] - way[:, 1] * turned[:, 0]
    assert (cross < 0.0).all()  # to the right of the way
    assert (np.linalg.norm(turned[:, :2], axis=1) < speed).all()
    assert np.ptp(turned[:, 2]) > 0.3
    for k in range(7):
        rows[:, where[f"neighbor_{k}.mask"]] = 0.0
    assert turn.wanted(rows, way) == pytest.approx(straight)
    env.close()


def test_a_tuning_keeps_the_best_of_its_trials(tmp_path, monkeypatch):
    def worth(candidate, seeds, cases):
        return -abs(candidate.cruise.speed_mps - 1.5)

    monkeypatch.setattr(tune_agents, "value_of", worth)
    trials = tmp_path / "trials.jsonl"
    best, value = tune_agent(TuneOptions(agent="roundabout", out=trials, trials=12))
    assert value > -0.3  # the shipped one, and nearer ones where they are found
    found = [json.loads(line) for line in trials.read_text().splitlines()]
    assert len(found) == 12 and value == max(trial["value"] for trial in found)
    assert numbers_of(best) in [trial["numbers"] for trial in found]


def test_a_candidate_is_measured_by_flights():
    def circle(drones: int) -> list[Case]:
        setting = {"layout": "circle", "num_drones": drones, "physics": "batch", "horizon_s": 12.0}
        return [Case("swap_v1", setting)]

    line, seeds = TUNED["fast-line"], frozen_seeds(5, 4)
    value = tune_agents.value_of(line, seeds, circle(2))
    assert 0.7 < value < 1.0  # all succeed, in two or three seconds; some may be near misses
    assert tune_agents.value_of(line, [1], circle(16)) == pytest.approx(-0.24)  # refused
    (sprint,) = tune_agents.cases_of("downwash-aware", ["air-sprint-8-v3"])
    assert 0.9 < tune_agents.value_of(TUNED["downwash-aware"], [1], [sprint]) < 1.0


@pytest.mark.parametrize("name", TUNED)
def test_a_neighbor_has_other_numbers_and_the_same_rules(name):
    candidate, rng = TUNED[name], np.random.default_rng(1)
    other = neighbor_of(candidate, rng)
    assert type(other) is type(candidate)
    assert numbers_of(other) != numbers_of(candidate)
    assert with_numbers(candidate, numbers_of(candidate)) == candidate
    assert with_numbers(candidate, numbers_of(other)) == other
