"""Aggregates and profiles against scipy, against counting, and against what is known."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import trim_mean

from swarm_envs.training.scoreboard.standings import (
    THRESHOLDS,
    aggregate,
    performance_profile,
    weighted_interquartile_mean,
)


def draws(seed: int, *sizes: int) -> list[np.ndarray]:
    rng = np.random.default_rng(seed)
    return [rng.beta(2.0, 3.0, size) for size in sizes]


def test_of_equal_weights_it_is_the_trimmed_mean():
    (values,) = draws(0, 40)
    assert weighted_interquartile_mean(values, np.ones(40)) == pytest.approx(
        trim_mean(values, 0.25)
    )
    both = np.stack([values, values[::-1] ** 2])
    assert weighted_interquartile_mean(both, np.ones(40)) == pytest.approx(
        trim_mean(both, 0.25, axis=1)
    )


def test_a_weight_of_three_is_a_value_that_occurs_three_times():
    (values,) = draws(1, 13)
    weights = np.array([3, 1, 1, 2, 1, 1, 1, 4, 1, 1, 2, 1, 1])
    repeated = np.repeat(values, weights)
    assert len(repeated) % 4 == 0
    assert weighted_interquartile_mean(values, weights.astype(float)) == pytest.approx(
        trim_mean(repeated, 0.25)
    )


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
    assert value == pytest.approx(0.5)
    assert interval == pytest.approx([0.5, 0.5])


def test_a_profile_counts_what_is_above_each_threshold():
    parts = draws(4, 24, 48)
    found = performance_profile(parts)
    for threshold, fraction in zip(THRESHOLDS, found["fraction"], strict=True):
        counted = np.mean([(part > threshold).mean() for part in parts])
        assert fraction == pytest.approx(counted if threshold < 1.0 else 0.0)
    assert all(np.diff(found["fraction"]) <= 1e-12)
    ends = zip(found["low"], found["fraction"], found["high"], strict=True)
    assert all(low - 1e-9 <= fraction <= high + 1e-9 for low, fraction, high in ends)


def test_perfect_scores_reach_the_last_threshold():
    assert performance_profile([np.ones(5)])["fraction"] == [1.0] * len(THRESHOLDS)
    assert performance_profile([np.zeros(5)])["fraction"] == [0.0] * len(THRESHOLDS)


def test_the_same_scores_give_the_same_bytes():
    assert aggregate(draws(5, 30, 9)) == aggregate(draws(5, 30, 9))
    assert performance_profile(draws(5, 30, 9)) == performance_profile(draws(5, 30, 9))


@pytest.mark.parametrize("scores", [[], [np.ones(3), np.ones(0)]])
def test_nothing_to_put_together_is_refused(scores):
    with pytest.raises(ValueError, match="no score to put together"):
        aggregate(scores)
