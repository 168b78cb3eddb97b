"""Scores over the tasks of a family: aggregates and performance profiles, with intervals.

As Agarwal et al. propose (Deep reinforcement learning at the edge of the statistical precipice,
NeurIPS 2021, and its library rliable): the interquartile mean of the scores of all episodes of all
tasks, and the share of them above each threshold; intervals by the stratified bootstrap, which
draws anew within each task. Tasks weigh the same, however many episodes were flown of each.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from swarm_envs.agents.scores import CONFIDENCE, RESAMPLES
from swarm_envs.state import FloatArray

THRESHOLDS = tuple(float(k) / 50.0 for k in range(51))
"""Scores at which profiles are given."""
_AT_ONCE = 4_000_000
"""Numbers that a bootstrap holds at once."""


def interquartile_mean(values: FloatArray, weights: FloatArray) -> FloatArray:
    """Mean of the middle half by weight of values (..., n) with weights (n,), not negative.

    Where a quarter of the weight ends within a value, that part of the value counts.
    """
    order = np.argsort(values, axis=-1, kind="stable")
    share = weights[order] / weights.sum()
    end = np.cumsum(share, axis=-1)
    inside = np.minimum(end, 0.75) - np.maximum(end - share, 0.25)
    return (np.take_along_axis(values, order, -1) * np.maximum(inside, 0.0)).sum(axis=-1) / 0.5


def aggregate(scores: Sequence[FloatArray]) -> tuple[float, list[float]]:
    """Interquartile mean of scores, one array (n,) for each task, and its interval.

    Raises:
        ValueError: there is no task, or one without episodes.
    """
    weights = _weights(scores)
    value = float(interquartile_mean(np.concatenate(scores), weights))
    drawn = [interquartile_mean(part, weights) for part in _resamples(scores)]
    return value, _interval(np.concatenate(drawn)[:, None])[:, 0].tolist()


def profile(scores: Sequence[FloatArray]) -> dict[str, list[float]]:
    """Share of episodes that score more than each of `THRESHOLDS`, or as much at the last.

    Returns:
        `fraction`, and `low` and `high`, the ends of its pointwise interval.

    Raises:
        ValueError: there is no task, or one without episodes.
    """
    weights = _weights(scores)
    fraction = _above(np.concatenate(scores)[None], weights)[0]
    drawn = np.concatenate([_above(part, weights) for part in _resamples(scores)])
    low, high = _interval(drawn)
    return {"fraction": fraction.tolist(), "low": low.tolist(), "high": high.tolist()}


def _above(values: FloatArray, weights: FloatArray) -> FloatArray:
    """(B, T) weighted share of values (B, n) above each threshold, in [0, 1]."""
    share = weights / weights.sum()
    last = np.nextafter(THRESHOLDS[-1], 0.0)
    columns = [(values > min(t, last)) @ share for t in THRESHOLDS]
    return np.clip(np.stack(columns, axis=1), 0.0, 1.0)


def _weights(scores: Sequence[FloatArray]) -> FloatArray:
    """(n,) of all episodes, so that each task weighs 1."""
    if not scores or any(len(part) == 0 for part in scores):
        raise ValueError("there is no score to put together: name a task, and fly an episode of it")
    return np.concatenate([np.full(len(part), 1.0 / len(part)) for part in scores])


def _resamples(scores: Sequence[FloatArray]) -> Iterator[FloatArray]:
    """`RESAMPLES` resamples (B, n), drawn within each task, in parts; the same in every run."""
    rng = np.random.default_rng(0)
    size = max(1, _AT_ONCE // sum(map(len, scores)))
    for done in range(0, RESAMPLES, size):
        rows = min(size, RESAMPLES - done)
        drawn = [part[rng.integers(0, len(part), (rows, len(part)))] for part in scores]
        yield np.concatenate(drawn, axis=1)


def _interval(drawn: FloatArray) -> FloatArray:
    """(2, T) percentile interval of draws (B, T)."""
    tail = 50.0 * (1.0 - CONFIDENCE)
    return np.asarray(np.percentile(drawn, [tail, 100.0 - tail], axis=0))
