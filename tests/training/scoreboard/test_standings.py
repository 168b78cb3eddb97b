"""Tasks and roster; what is measured of episodes; aggregates, profiles and tables of text."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.stats import trim_mean

import swarm_envs
from docs.benchmark_tables import BEGIN, END, put_into, success_rates, update_page
from swarm_envs.agents import fly_episode, load
from swarm_envs.agents.evaluation import evaluate_agent, frozen_seeds
from swarm_envs.agents.registry import FILTER, SHIPPED
from swarm_envs.physics import bullet_available
from swarm_envs.training.scoreboard import tasks
from swarm_envs.training.scoreboard.metrics import (
    METRICS,
    fastest_times,
    row_of,
    score_of,
    values_of,
)
from swarm_envs.training.scoreboard.roster import LEAST, ROSTER, choose_agents, episodes_of
from swarm_envs.training.scoreboard.standings import (
    THRESHOLDS,
    aggregate,
    align_columns,
    performance_profile,
    standings,
    weighted_interquartile_mean,
)
from swarm_envs.training.scoreboard.tasks import SEED, TASKS, choose_tasks, digest, make_scored
from tests.helpers.pages import DOCS

STANDING = {"value": 0.456, "interval": [0.4, 0.5], "tasks": 1, "of": 2}


def cell(task: str, agent: str, status: str, rate: float = 0.0) -> dict[str, Any]:
    values = {"success_rate": {"value": rate}} if status == "flown" else {}
    return {"task": task, "agent": agent, "status": status, "values": values, "episodes": 8}


CONTENT = {
    "manifest": {
        "command": "swarm-envs benchmark --out '/home/me/a b' --workers 2",
        "cpu_s": 121.0,
        "machine": {"cores": 2, "cpu": "A"},
        "versions": {"swarm_envs": "9"},
    },
    "tasks": [{"id": f"swap-circle-{n}-v2", "task": "swap"} for n in (2, 4)]
    + [{"id": "ring-5-v2", "task": "ring"}],
    "agents": [{"name": "a", "privileged": True}, {"name": "b", "privileged": False}],
    "cells": [
        cell("swap-circle-2-v2", "a", "flown", 0.875),
        cell("swap-circle-4-v2", "a", "unsupported"),
        cell("ring-5-v2", "a", "unsupported"),
        cell("swap-circle-2-v2", "b", "failed"),
        cell("swap-circle-4-v2", "b", "flown", 1.0),
        cell("ring-5-v2", "b", "flown", 0.0),
    ],
    "aggregates": {"swap": {"a": STANDING, "b": {**STANDING, "tasks": 2}}, "ring": {}},
}


def test_rows_are_what_the_cells_say():
    assert standings(CONTENT) == [
        ["agent", "swap", "ring"],
        ["a*", "0.46 [0.40, 0.50] (1 of 2)", "-"],
        ["b", "0.46 [0.40, 0.50]", "-"],
    ]
    assert success_rates(CONTENT, "swap") == [
        ["agent", "circle 2", "circle 4"],
        ["a*", "88", "-"],
        ["b", "failed", "100"],
    ]
    assert success_rates(CONTENT, "ring") == [["agent", "5"], ["b", "0"]]


def test_tables_for_terminals_and_for_pages():
    rows = [["agent", "x"], ["longer*", "1"]]
    assert align_columns(rows) == ["agent    x", "longer*  1"]


def test_a_page_gets_the_results_and_keeps_the_rest(tmp_path):
    page = tmp_path / "page.md"
    page.write_text(f"before\n{BEGIN}\nold\n{END}\nafter\n", encoding="utf-8")
    (tmp_path / "scores.json").write_text(json.dumps(CONTENT), encoding="utf-8")
    update_page([str(tmp_path), "--into", str(page)])
    first = page.read_text(encoding="utf-8")
    assert first.startswith(f"before\n{BEGIN}\n") and first.endswith(f"\n{END}\nafter\n")
    assert "old" not in first
    assert "`swarm-envs benchmark --out board --workers 2`: 48 episodes, 2 CPU minutes" in first
    assert "| b | failed | 100 |" in first
    update_page([str(tmp_path), "--into", str(page)])
    assert page.read_text(encoding="utf-8") == first


def test_a_page_without_a_place_for_results_is_refused():
    with pytest.raises(ValueError, match="must have one '<!-- results -->'"):
        put_into("nothing here", "x")
    page = (DOCS / "generated" / "benchmark.md").read_text(encoding="utf-8")
    assert put_into(page, "x").count("\nx\n") == 1


def draws(seed: int, *sizes: int) -> list[np.ndarray]:
    rng = np.random.default_rng(seed)
    return [rng.beta(2.0, 3.0, size) for size in sizes]


@pytest.mark.parametrize(
    "weights", [np.ones(40), np.array([3, 1, 1, 2, 1, 1, 1, 4, 1, 1, 2, 1, 1])]
)
def test_whole_weights_are_values_that_occur_so_often(weights):
    (values,) = draws(0, len(weights))
    both = np.stack([values, values[::-1] ** 2])
    repeated = np.repeat(both, weights.astype(int), axis=1)
    assert repeated.shape[1] % 4 == 0  # else the trimmed mean leaves out other shares
    found = weighted_interquartile_mean(both, weights.astype(float))
    assert found == pytest.approx(trim_mean(repeated, 0.25, axis=1))


def test_values_that_end_a_quarter_count_in_part():
    values = np.array([0.0, 1.0, 2.0])  # quarters end within the outer two
    expected = (0.0 * (1 / 3 - 1 / 4) + 1.0 / 3 + 2.0 * (1 / 3 - 1 / 4)) / 0.5
    assert weighted_interquartile_mean(values, np.ones(3)) == pytest.approx(expected)


def test_tasks_weigh_the_same_however_many_episodes_were_flown():
    few, many = draws(2, 16, 64)
    value, _ = aggregate([few, many])
    assert value == pytest.approx(trim_mean(np.concatenate([np.repeat(few, 4), many]), 0.25))


def test_an_interval_holds_the_truth_about_as_often_as_it_says():
    """Of two tasks whose scores are alike but for a shift; the truth is that of 80,000 draws."""
    first, second = draws(3, 40_000, 40_000)
    truth = trim_mean(np.concatenate([first, second + 0.2]), 0.25)
    held = 0
    for seed in range(80):
        first, second = draws(100 + seed, 40, 20)
        _, (low, high) = aggregate([first, second + 0.2])
        held += low <= truth <= high
    assert 0.87 <= held / 80 <= 0.99  # 95 % give or take three standard errors


def test_the_bootstrap_draws_within_tasks():
    """Each task is constant: however it is drawn, nothing varies, and the interval is a point."""
    value, interval = aggregate([np.full(10, 0.2), np.full(30, 0.8)])
    assert [value, *interval] == pytest.approx([0.5, 0.5, 0.5])


def test_a_profile_counts_what_is_above_each_threshold():
    parts = draws(4, 24, 48)
    found = performance_profile(parts)
    for threshold, fraction in zip(THRESHOLDS, found["fraction"], strict=True):
        counted = np.mean([(part > threshold).mean() for part in parts])
        assert fraction == pytest.approx(counted if threshold < 1.0 else 0.0)
    ends = zip(found["low"], found["fraction"], found["high"], strict=True)
    assert all(low - 1e-9 <= fraction <= high + 1e-9 for low, fraction, high in ends)
    for score in (0.0, 1.0):  # perfect scores reach the last threshold
        fractions = performance_profile([np.full(5, score)])["fraction"]
        assert fractions == [score] * len(THRESHOLDS)


@pytest.mark.parametrize("scores", [[], [np.ones(3), np.ones(0)]])
def test_nothing_to_put_together_is_refused(scores):
    with pytest.raises(ValueError, match="no score to put together"):
        aggregate(scores)


SWAP, STACKED = TASKS["swap-circle-4-v2"], TASKS["swap-stacked-L2S-v2"]
RING, TOUR = TASKS["ring-5-v2"], TASKS["formation-tour-8-v2"]


def flown(task, agent: str, seed: int) -> dict[str, Any]:
    made = load(agent)
    env = swarm_envs.make(task.environment, **{**task.setting, **made.requires})
    metrics = fly_episode(env, made, seed)
    env.close()
    return {"seed": seed, "metrics": metrics, "act_us": [3, 1]}


def test_nobody_crosses_a_circle_of_3_m_faster_than_physics_allows():
    """0.4 s from rest to 2 m/s at 5 m/s^2, in which 0.4 m are flown; the same at the end."""
    assert fastest_times(SWAP, [3, 4]) == pytest.approx({3: 2 * 0.4 + 2.2 / 2.0, 4: 1.9})


def test_where_a_reference_moves_nobody_must_be_faster_than_it():
    """It comes within 0.1 m of its goal in the last of the 3-4 s that a stacked swap takes."""
    env = swarm_envs.make(STACKED.environment, **STACKED.setting)
    env.reset(seed=11)
    (found,) = fastest_times(STACKED, [11]).values()
    gap = [
        np.linalg.norm(env.view.reference(t).position - env.view.goals, axis=1).max()
        for t in (found - 0.03, found + 0.03, 4.0)
    ]
    env.close()
    assert gap[0] > 0.1 > gap[1] > gap[2]
    assert gap[2] == pytest.approx(0.0, abs=1e-9)


def test_a_score_of_time_is_one_at_best_and_nothing_without_success():
    metrics = {"success": True, "time_to_goal_s": 3.8}
    assert score_of(SWAP, metrics, 1.9) == pytest.approx(0.5)
    assert score_of(SWAP, {**metrics, "time_to_goal_s": 1.8}, 1.9) == 1.0
    assert score_of(SWAP, {**metrics, "success": False}, 1.9) == 0.0


def test_scores_of_shapes_and_of_tracking():
    assert score_of(TOUR, {"success": False, "stages": 4, "stages_reached": 3}) == 0.75
    ring = {"success": True, "worst_tracking_error_m": 0.06}
    assert score_of(RING, ring) == pytest.approx(0.6)
    assert score_of(RING, {**ring, "success": False}) == 0.0


def test_a_row_is_what_the_episode_was():
    episode = flown(SWAP, "detour", 5)
    row, metrics = row_of(SWAP, "detour", 7, episode, 1.9), episode["metrics"]
    assert (row["task_id"], row["agent"], row["episode"], row["seed"]) == (SWAP.id, "detour", 7, 5)
    assert row["success"] and not row["collided"] and not row["refused"]
    assert row["makespan_s"] == metrics["time_to_goal_s"]
    assert row["score"] == pytest.approx(1.9 / metrics["time_to_goal_s"])
    assert row["energy_j"] == metrics["energy_j"]
    assert row["near_miss"] == (metrics["near_misses"] > 0)


def test_a_crash_is_no_near_miss_and_has_no_makespan():
    row = row_of(SWAP, "straight-line", 0, flown(SWAP, "straight-line", 5), 1.9)
    assert row["collided"] and not row["near_miss"] and not row["success"]
    assert row["makespan_s"] is None and row["score"] == 0.0


def test_a_tour_s_makespan_is_the_time_of_its_last_shape():
    row = row_of(TOUR, "tracking+compensated", 0, flown(TOUR, "tracking+compensated", 2), None)
    assert row["success"] and row["score"] == 1.0
    assert 18.0 < row["makespan_s"] < 24.0


def test_refused_episodes_count_as_not_done_and_measure_nothing():
    refused = {"seed": 4, "metrics": {"refused": "too close"}, "act_us": []}
    good = flown(SWAP, "detour", 5)
    rows = [row_of(SWAP, "x", 0, refused, 1.9), row_of(SWAP, "x", 1, good, 1.9)]
    assert rows[0].keys() == rows[1].keys()
    values = values_of(rows, [1, 2, 3])
    assert values["success_rate"]["value"] == 0.5
    assert values["collision_rate"]["value"] == 0.0
    assert values["energy_j"]["value"] == good["metrics"]["energy_j"]
    assert values["act_us_p50"] == {"value": 2.0, "interval": None}
    nothing = values_of(rows[:1], [])
    assert nothing["minimum_separation_m"] == {"value": None, "interval": None}
    assert nothing["act_us_p99"] == {"value": None, "interval": None}


def test_a_cell_adds_up_its_rows():
    template = row_of(SWAP, "detour", 0, flown(SWAP, "detour", 5), 1.9)
    rows = [
        {**template, "success": k < 6, "makespan_s": float(k) if k < 6 else None, "energy_j": k}
        for k in range(8)
    ]
    values = values_of(rows, [])
    assert values["success_rate"]["value"] == 0.75
    assert values["success_rate"]["interval"] == pytest.approx([0.409, 0.928], abs=1e-3)  # Wilson
    assert values["makespan_s"]["value"] == pytest.approx(2.5)  # of 0 to 5, without 0 and 5
    assert values["energy_j"]["value"] == pytest.approx(2.5)  # of successes alone
    low, high = values["makespan_s"]["interval"]
    assert 0.0 <= low < 2.5 < high <= 5.0


def test_every_metric_is_told_and_named_once():
    names = [metric.name for metric in METRICS]
    assert len(set(names)) == len(names)
    row = row_of(SWAP, "detour", 0, flown(SWAP, "detour", 5), 1.9)
    assert {m.column or m.name for m in METRICS if m.statistic != "percentile"} <= set(row)
    assert set(values_of([row], [1])) == set(names)


DIGESTS = {
    "swap-random-2-v2": "3fafa2d1edc3a7bf",
    "swap-random-4-v2": "e5c18ebf83392ddb",
    "swap-random-SSLL-v2": "1eda464943fa208c",
    "swap-random-8-v2": "a3a10fc25bb085f1",
    "swap-random-16-v2": "03e590b4f7d44c2b",
    "swap-circle-2-v2": "5e969300754f99f7",
    "swap-circle-4-v2": "3078ec7f005d7425",
    "swap-circle-8-v2": "c070564c009d80fc",
    "swap-circle-16-v2": "65a4dbf5a41afa3a",
    "swap-stacked-L2S-v2": "17d4e7a21f992f9d",
    "swap-stacked-4-v2": "b84508eb4ceac6e0",
    "ring-4-v2": "53305b44f6277c35",
    "ring-5-v2": "3b8751b5c68275ec",
    "ring-8-v2": "dc6597b6309b6c81",
    "ring-16-v2": "5692b8740fed2369",
    "formation-tour-8-v2": "07fb59f87102702f",
    "formation-tour-16-v2": "f00d07d6d565ebf8",
    "formation-shuffle-8-v2": "019fb262b9f343cc",
    "formation-shuffle-16-v2": "9cb8f0157d01c41a",
    "air-stack-8-v3": "ca5c1b3a8be90eb3",
    "air-sprint-8-v3": "4ed68b21d7221661",
    "air-delivery-7-v2": "4944700c54317696",
    "air-gates-4-v2": "ea193493af787a38",
    "crowd-open-64-v2": "a86fe3758dc090a5",
    "crowd-forest-16-v2": "ee1bb27bb238a852",
    "crowd-forest-64-v2": "0e1bde184ff25b7d",
    "crowd-buildings-32-v2": "087b5882277b5521",
    "crowd-moving-8-v2": "bb314ece79982697",
    "crowd-swaps-8-v2": "c6aa71ad2df95b0a",
    "crowd-chase-8-v2": "8d6bc505d4c040c2",
    "crowd-random-32-v2": "d6e003aaea740e9c",
    "crowd-random-64-v2": "bcd7a113dfb7b872",
    "crowd-circle-32-v2": "2d8e3002ec28c289",
    "robust-random-8-hall-v2": "13b19e5a9a684fae",
    "robust-ring-5-hall-v2": "0325196ded80d578",
    "robust-ring-16-hall-v2": "3fd43760ae523fe3",
    "robust-shuffle-8-hall-v2": "19d863558878c78b",
    "robust-random-8-noise-v2": "ec78160219feb158",
    "robust-circle-8-noise-v2": "48bade76fd308fbe",
    "robust-random-LLLLSSSS-v2": "1fbd43cb8c9876ed",
    "robust-random-4-bullet-v2": "4bd3bec5ba680b39",
    "transfer-random-8-none-v2": "3fa12f8e6b8a2177",
    "transfer-random-8-wake-v2": "d3a87a043a42f559",
    "transfer-stacked-L2S-wake-v2": "de6ace113bc1ddf3",
    "transfer-ring-5-wake-v2": "14db2a7c487bfd88",
    "air-mixed-6-v3": "1512d8e965de3b3e",
}
"""What each id has stood for since it was first used. A line here is never changed: what is flown
otherwise gets a row with the next version in place of the old one."""
NEVER_AGAIN = {"robust-circle-8-hall-v2", "air-stack-8-v2", "air-sprint-6-v2"}
"""Ids that stood for something once, and must not stand for anything else."""
SEEDS = [2727543821, 2207150826, 508070823]


def test_no_id_stands_for_anything_else_than_before():
    assert {name: digest(task) for name, task in TASKS.items()} == DIGESTS
    assert not NEVER_AGAIN & set(TASKS)


def test_a_digest_sees_what_was_changed(monkeypatch):
    task = TASKS["swap-circle-4-v2"]
    others = [
        replace(task, options={"layout": "circle", "num_drones": 5}),
        replace(task, environment="formation_v1"),
        replace(task, score="shapes"),
    ]
    assert digest(replace(task, episodes=1, label="another", clock_s=1.0)) == DIGESTS[task.id]
    seen = [DIGESTS[task.id], *map(digest, others)]
    for name, value in (("SEED", SEED + 1), ("_force_model", lambda name: "0" * 64)):
        with monkeypatch.context() as patch:
            patch.setattr(tasks, name, value)
            seen.append(digest(task))
    assert len(set(seen)) == 6


def test_the_frozen_seeds_are_the_same_everywhere():
    assert frozen_seeds(SEED, 256)[:3] == frozen_seeds(SEED, 3) == SEEDS


@pytest.mark.parametrize("task", TASKS.values(), ids=list(TASKS))
def test_every_row_says_what_flies(task):
    classic = r"(swap|ring|formation)-([a-z]+-)?[0-9LS]+-v2"
    new = rf"{task.task}-[a-z]+-[0-9LS]+(-[a-z]+)?-v[23]"
    assert re.fullmatch(classic if task.task == "classic" else new, task.id)
    if task.setting["physics"] == "bullet" and not bullet_available():
        pytest.skip("no pybullet")
    env = make_scored(task.environment, json.loads(json.dumps(task.setting)))
    env.reset(seed=0)
    assert len(env.agents) == task.drones <= 64
    assert env.physics_name == task.setting["physics"]
    assert env.view.horizon_s == task.clock_s
    assert env.core.config.force_rate == 240
    env.close()


def test_every_task_has_a_certificate():
    for task in TASKS.values():
        name, _, clock_s = task.certificate.partition("@")
        assert name in SHIPPED
        assert not clock_s or float(clock_s) > task.clock_s


@pytest.mark.slow
@pytest.mark.parametrize("name", TASKS)
def test_the_certificate_solves_its_task(name):
    task = TASKS[name]
    agent_name, _, clock_s = task.certificate.partition("@")
    agent, longer = load(agent_name), {"horizon_s": float(clock_s)} if clock_s else {}
    env = make_scored(task.environment, {**task.setting, **longer, **agent.requires})
    flown = [*evaluate_agent(env, agent, frozen_seeds(SEED, 20), timed=1)]
    env.close()
    assert sum(each["metrics"]["success"] for each in flown) >= 0.95 * len(flown)


def test_every_agent_that_ships_is_in_the_roster():
    assert set(SHIPPED) <= set(ROSTER)
    assert {name.removesuffix(FILTER) for name in ROSTER} == set(SHIPPED)
    labels = [place.label for place in ROSTER.values()]
    assert len(set(labels)) == len(labels)


def test_slow_agents_fly_the_first_of_the_episodes_of_fast_ones():
    swap, tour = TASKS["swap-circle-4-v2"], TASKS["formation-tour-8-v2"]
    for name, episodes in (("swap-dagger", 256), ("detour", 64), ("neural-swarm-planner", 32)):
        assert episodes_of(name, swap) == episodes
    assert episodes_of("neural-swarm-planner", tour) == LEAST
    assert episodes_of("some/file.py:Mine", swap) == 64


def test_patterns_choose_in_the_table_s_order():
    chosen = choose_tasks(["ring-*-v2", "swap-circle-4-v2"])
    assert [task.id for task in chosen] == [
        "swap-circle-4-v2",
        *(name for name in TASKS if re.match("ring-.*-v2", name)),
    ]
    assert choose_tasks(["*"]) == list(TASKS.values())
    names = choose_agents(["a/b.py:Mine", "crowd-dagger*", "hover", "a/b.py:Mine", "detour+filter"])
    wanted = ["hover", "crowd-dagger", "crowd-dagger+filter"]
    assert names == [*wanted, "a/b.py:Mine", "detour+filter"]


@pytest.mark.parametrize("choose", [choose_tasks, choose_agents])
def test_what_is_no_name_is_refused_with_the_nearest(choose):
    wrong, right = {
        choose_tasks: ("swap-circle-4", "swap-circle-4-v2"),
        choose_agents: ("swap-daggr", "swap-dagger"),
    }[choose]
    with pytest.raises(ValueError, match=f"did you mean '{right}'"):
        choose(["*", wrong])
    with pytest.raises(ValueError, match="is named"):
        choose([])


def test_the_page_explains_every_column_and_names_every_task():
    page = (DOCS / "benchmark.md").read_text(encoding="utf-8")
    measured = page.partition("## Metrics")[2]
    assert all(f"`{metric.name}`" in measured for metric in METRICS)
    shown = page.partition("## Tasks")[2].partition("## Metrics")[0]
    for name in TASKS:
        first, size, version = name.rsplit("-", 2)
        assert f"`{name}`" in shown or (f"`{first}-" in shown and f"`-{size}`" in shown), name
        assert version in shown
