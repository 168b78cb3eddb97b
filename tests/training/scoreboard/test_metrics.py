"""Measures of an episode, and aggregates of the episodes of an agent on a task."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import swarm_envs
from swarm_envs.agents import fly_episode, load
from swarm_envs.training.scoreboard.metrics import (
    COLUMNS,
    METRICS,
    fastest_times,
    row_of,
    score_of,
    values_of,
)
from swarm_envs.training.scoreboard.tasks import TASKS

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
    places = [env.view.reference(t).position for t in (found - 0.03, found + 0.03, 4.0)]
    gap = [np.linalg.norm(place - env.view.goals, axis=1).max() for place in places]
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
    assert (row["task"], row["agent"], row["episode"], row["seed"]) == (SWAP.id, "detour", 7, 5)
    assert row["success"] and not row["collided"] and row["refusal"] is None
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
    assert rows[0].keys() == rows[1].keys() == COLUMNS.keys()
    assert rows[0]["refusal"] == "too close"
    values = values_of(rows)
    assert values["success_rate"]["value"] == 0.5
    assert values["collision_rate"]["value"] == 0.0
    assert values["energy_j"]["value"] == good["metrics"]["energy_j"]
    assert values["act_us_p50"] == {"value": 2.0, "interval": None}
    nothing = values_of(rows[:1])
    assert nothing["minimum_separation_m"] == {"value": None, "interval": None}
    assert nothing["act_us_p99"] == {"value": None, "interval": None}


def test_a_cell_adds_up_its_rows():
    template = row_of(SWAP, "detour", 0, flown(SWAP, "detour", 5), 1.9)
    rows = [
        {**template, "success": k < 6, "makespan_s": float(k) if k < 6 else None, "energy_j": k}
        for k in range(8)
    ]
    values = values_of(rows)
    assert values["success_rate"]["value"] == 0.75
    assert values["success_rate"]["interval"] == pytest.approx([0.409, 0.928], abs=1e-3)  # Wilson
    assert values["makespan_s"]["value"] == pytest.approx(2.5)  # of 0 to 5, without 0 and 5
    assert values["energy_j"]["value"] == pytest.approx(2.5)  # of successes alone
    low, high = values["makespan_s"]["interval"]
    assert 0.0 <= low < 2.5 < high <= 5.0


def test_every_metric_has_a_column():
    assert len({metric.name for metric in METRICS}) == len(METRICS)
    assert {metric.column or metric.name for metric in METRICS} <= set(COLUMNS)
