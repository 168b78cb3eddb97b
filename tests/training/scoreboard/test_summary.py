"""Aggregates and profiles against independent computations; tables, the file and plots."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image
from scipy.stats import trim_mean

from swarm_envs.training.scoreboard.metrics import COLUMNS
from swarm_envs.training.scoreboard.plots import plot_scores, plot_success
from swarm_envs.training.scoreboard.results import Cell, Results, read_results
from swarm_envs.training.scoreboard.summary import (
    THRESHOLDS,
    aggregate,
    align_columns,
    markdown,
    standings,
    success_rates,
    summarize,
    weighted_interquartile_mean,
)


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
    value = aggregate([few, many])["value"]
    assert value == pytest.approx(trim_mean(np.concatenate([np.repeat(few, 4), many]), 0.25))


def test_the_bootstrap_draws_within_tasks():
    """Each task is constant: however it is drawn, nothing varies, and the interval is a point."""
    found = aggregate([np.full(10, 0.2), np.full(30, 0.8)])
    assert [found["value"], *found["interval"]] == pytest.approx([0.5, 0.5, 0.5])


def test_a_profile_counts_what_is_above_each_threshold():
    parts = draws(4, 24, 48)
    found = aggregate(parts)
    for threshold, fraction in zip(THRESHOLDS, found["fraction"], strict=True):
        counted = np.mean([(part > threshold).mean() for part in parts])
        assert fraction == pytest.approx(counted if threshold < 1.0 else 0.0)
    ends = zip(found["low"], found["fraction"], found["high"], strict=True)
    assert all(low - 1e-9 <= fraction <= high + 1e-9 for low, fraction, high in ends)
    for score in (0.0, 1.0):  # perfect scores reach the last threshold
        fractions = aggregate([np.full(5, score)])["fraction"]
        assert fractions == [score] * len(THRESHOLDS)


THREE_TASKS = (
    [
        0.4265, 0.4082, 0.6492, 0.3551, 0.1284, 0.1907, 0.5637, 0.2296, 0.1093, 0.4892, 0.0542,
        0.6575, 0.3544, 0.2243, 0.488, 0.3258, 0.3928, 0.1837, 0.2153, 0.2061, 0.2606, 0.102,
        0.462, 0.4176,
    ],
    [
        0.3929, 0.5172, 0.6456, 0.7741, 0.5095, 0.7981, 0.772, 0.4598, 0.8875, 0.4003, 0.5236,
        0.3713, 0.4232, 0.2873, 0.3188, 0.6944, 0.6086, 0.9592, 0.5156, 0.2478, 0.2904, 0.4878,
        0.3011, 0.3079,
    ],
    [
        0.438, 0.3476, 0.3585, 0.3968, 0.5215, 0.2706, 0.7521, 0.6368, 0.7046, 0.7153, 0.9701,
        0.6376, 0.6571, 0.702, 0.6581, 0.7684, 0.5421, 0.5871, 0.5942, 0.2911, 0.3447, 0.8566,
        0.4543, 0.6717,
    ],
)  # fmt: skip
"""Scores of 24 episodes of each."""


def test_aggregates_are_those_of_rliable():
    """Its version 1.2.0 on the same scores, with 50,000 and 20,000 resamples where ours has 2,000:

    `get_interval_estimates` of `aggregate_iqm`, and `create_performance_profile`.
    """
    found = aggregate([np.array(scores) for scores in THREE_TASKS])
    assert found["value"] == pytest.approx(0.46435278, abs=1e-8)
    assert found["interval"] == pytest.approx([0.41074438, 0.51855278], abs=4e-3)
    profile = {name: found[name][10:50:10] for name in ("fraction", "low", "high")}
    assert profile["fraction"] == pytest.approx([66 / 72, 43 / 72, 22 / 72, 4 / 72])
    step = 1.01 / 72  # an end may fall one episode beside
    assert profile["low"] == pytest.approx([62 / 72, 35 / 72, 15 / 72, 1 / 72], abs=step)
    assert profile["high"] == pytest.approx([70 / 72, 51 / 72, 29 / 72, 8 / 72], abs=step)


@pytest.mark.parametrize("scores", [[], [np.ones(3), np.ones(0)]])
def test_nothing_to_aggregate_is_refused(scores):
    with pytest.raises(ValueError, match="no score to aggregate"):
        aggregate(scores)


def test_one_episode_has_no_spread():
    found = aggregate([np.array([0.25])])
    assert (found["value"], found["interval"]) == (0.25, [0.25, 0.25])


def row(agent: str, task: str, k: int, score: float, refusal: str | None = None) -> dict[str, Any]:
    about = {"agent": agent, "task": task, "seed": k, "episode": k, "refusal": refusal}
    flags = {"success": score > 0.0, "collided": False, "near_miss": False, "score": score}
    return {**dict.fromkeys(COLUMNS), **about, **flags}


def results() -> Results:
    """Two agents on three tasks of two families: `a` flies one task, `b` fails on one."""
    swaps, ring = ("swap-circle-2-v2", "swap-circle-4-v2"), "ring-5-v2"
    families = {**dict.fromkeys(swaps, "swap"), ring: "ring"}
    about = {
        "command": "swarm-envs benchmark --out board",
        "versions": {"swarm_envs": "9"},
        "machine": {"cores": 2, "cpu": "A"},
        "tasks": {name: {"family": family} for name, family in families.items()},
        "agents": {"a": {"privileged": True}, "b": {"privileged": False}},
    }
    cells = [
        Cell(swaps[0], "a", [row("a", swaps[0], k, 0.5 * (k > 0)) for k in range(8)]),
        Cell(swaps[0], "b", failure="KeyError: 'x'"),
        Cell(swaps[1], "a", [row("a", swaps[1], k, 0.0, "too many") for k in range(2)]),
        Cell(swaps[1], "b", [row("b", swaps[1], k, 0.25, "odd"[: 3 * k] or None) for k in (0, 1)]),
        Cell(ring, "a", mismatch="it flies swap"),
        Cell(ring, "b", [row("b", ring, k, 0.0) for k in range(4)]),
    ]
    return Results(about, cells)


def test_the_tables_are_what_the_cells_say():
    content = summarize(results())
    assert standings(content) == [
        ["agent", "swap", "ring"],
        ["a*", "0.50 [0.38, 0.50] (1 of 2)", "-"],  # 3 zeros of 8 in 7 % of resamples, 4 in 1 %
        ["b", "0.12 [0.12, 0.12]", "0.00 [0.00, 0.00]"],
    ]
    rows = [["agent", "circle 2", "circle 4"], ["a*", "88", "-"], ["b", "failed", "100"]]
    assert success_rates(content, "swap") == rows
    assert success_rates(content, "ring") == [["agent", "5"], ["b", "0"]]
    text = markdown(content)
    assert text.startswith("`swarm-envs benchmark --out board`: 13 episodes, 2 processors (A)")
    assert "| b | failed | 100 |" in text and "| a\\* | 88 | - |" in text
    assert align_columns([["agent", "x"], ["longer*", "1"]]) == ["agent    x", "longer*  1"]


def test_a_cell_says_why_it_was_not_flown():
    found = {(c["task"], c["agent"]): c for c in summarize(results())["cells"]}
    said = [(cell["status"], cell["reason"], cell["episodes"]) for cell in found.values()]
    assert said == [
        ("flown", "", 8),
        ("failed", "KeyError: 'x'", 0),
        ("unsupported", "too many", 0),
        ("flown", "refused 1 of 2 episodes: odd", 1),
        ("unsupported", "it flies swap", 0),
        ("flown", "", 4),
    ]


def test_the_file_has_everything(tmp_path):
    pytest.importorskip("pyarrow")
    made = results()
    folder = tmp_path / os.fsdecode(b"\xdcbung")  # no Unicode, which pyarrow would refuse
    folder.mkdir()
    made.write(folder / "episodes.parquet")
    read = read_results(folder)
    assert read.about == made.about
    assert summarize(read) == summarize(made)
    with pytest.raises(FileNotFoundError, match=r"there is no file .*none"):
        read_results(tmp_path / "none")
    (tmp_path / "other").write_text("no Parquet")
    with pytest.raises(ValueError, match="is no file of a benchmark"):
        read_results(tmp_path / "other")


def test_plots_show_every_family(tmp_path: Path):
    content = summarize(results())
    for plot in (plot_success, plot_scores):
        plot(tmp_path / "plot.png", content)
        image = np.asarray(Image.open(tmp_path / "plot.png").convert("L"))
        upper, lower = np.array_split(image < 128, 2)
        assert upper.any() and lower.any()
