"""The scripted agents that avoid each other: what they solve, and that batches fly as one does."""

from __future__ import annotations

import numpy as np
import pytest

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
from swarm_envs import crowd_v0, swap_v1
from swarm_envs.agents import SafetyFilter, fly_episode, load
from swarm_envs.agents.avoiding import CruiseAgent, RoundaboutAgent
from swarm_envs.agents.evaluation import evaluate_agent, frozen_seeds

NAMES = ("fast-line", "orca", "roundabout")


@pytest.mark.parametrize("name", NAMES)
def test_they_see_no_truth_and_swap_four(name):
    agent = load(name)
    assert not agent.privileged
    env = swap_v1.parallel_env(num_drones=4, **{**agent.requires, "physics": "batch"})
    flown = list(evaluate_agent(env, agent, frozen_seeds(11, 24), timed=2))
    assert all(each["metrics"]["success"] for each in flown)
    assert flown[3]["metrics"] == fly_episode(env, agent, flown[3]["seed"])
    env.close()


@pytest.mark.parametrize("drones", [8, 16])
def test_the_roundabout_solves_the_circle(drones):
    agent = load("roundabout")
    setting = {"num_drones": drones, "layout": "circle", "physics": "batch"}
    env = swap_v1.parallel_env(**setting, **agent.requires)
    flown = list(evaluate_agent(env, agent, frozen_seeds(12, 8), timed=1))
    assert all(each["metrics"]["success"] for each in flown)
    env.close()


@pytest.mark.parametrize("layout", ["forest", "buildings"])
def test_they_fly_around_obstacles(layout):
    """Who does not reaches three goals a minute, and none is left in the end: all are left here."""
    agent = load("roundabout")
    options = {"num_drones": 16, "layout": layout, "physics": "batch"}
    env = crowd_v0.parallel_env(**options, **agent.requires)
    flown = [each["metrics"] for each in evaluate_agent(env, agent, frozen_seeds(11, 4), timed=1)]
    assert np.mean([metrics["throughput_per_min"] for metrics in flown]) > 16.0
    assert all(metrics["success"] and not metrics["collided_obstacle"] for metrics in flown)
    env.close()


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


def test_a_filter_is_not_put_around_a_filter():
    assert isinstance(load("orca"), SafetyFilter)
    with pytest.raises(ValueError, match="'orca' flies behind a filter already"):
        load("orca+filter")


def test_a_tuning_that_was_killed_goes_on_and_ends_the_same(tmp_path, monkeypatch):
    flown: list[object] = []

    def worth(candidate, seeds, cases):
        flown.append(candidate)
        return -abs(candidate.cruise.speed_mps - 1.5)

    monkeypatch.setattr(tune_agents, "value_of", worth)
    one, two = tmp_path / "one.jsonl", tmp_path / "two.jsonl"
    best, value = tune_agent(TuneOptions(agent="roundabout", out=one, trials=12))
    assert value > -0.3  # the shipped one, and nearer ones where they are found
    lines = one.read_text().splitlines(keepends=True)
    two.write_text("".join(lines[:5]) + lines[5][:40])  # killed while it wrote
    flown.clear()
    assert tune_agent(TuneOptions(agent="roundabout", out=two, trials=12)) == (best, value)
    assert len(flown) == 7
    assert two.read_bytes() == one.read_bytes()
    with pytest.raises(ValueError, match="is of another tuning"):
        tune_agent(TuneOptions(agent="orca", out=two, trials=12))


def test_a_candidate_is_measured_by_flights():
    def circle(drones: int) -> list[Case]:
        setting = {"layout": "circle", "num_drones": drones, "physics": "batch", "horizon_s": 12.0}
        return [Case("circle", "swap_v1", setting)]

    line, seeds = TUNED["fast-line"], frozen_seeds(5, 4)
    value = tune_agents.value_of(line, seeds, circle(2))
    assert 0.7 < value < 1.0  # all succeed, in two or three seconds; some may be near misses
    assert tune_agents.value_of(line, [1], circle(16)) == pytest.approx(-0.24)  # refused
    (sprint,) = tune_agents.cases_of("air-aware", ["air-sprint-6-v2"])
    assert 0.9 < tune_agents.value_of(TUNED["air-aware"], [1], [sprint]) < 1.0


@pytest.mark.parametrize("name", TUNED)
def test_a_neighbor_has_other_numbers_and_the_same_rules(name):
    candidate, rng = TUNED[name], np.random.default_rng(1)
    other = neighbor_of(candidate, rng)
    assert type(other) is type(candidate)
    assert numbers_of(other) != numbers_of(candidate)
    assert with_numbers(candidate, numbers_of(candidate)) == candidate
    assert with_numbers(candidate, numbers_of(other)) == other
