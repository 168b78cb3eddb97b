"""What episodes add up to: rates and averages, each with an interval."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from swarm_envs.state import FloatArray

CONFIDENCE = 0.95
"""Of all intervals."""
RESAMPLES = 2000
"""Bootstrap resamples."""

COLLISIONS = {
    "drone": "collided_drones",
    "floor": "collided_floor",
    "wall": "collided_wall",
    "obstacle": "collided_obstacle",
    "tumbling": "tumbled",
}
"""Kinds of crash, and the metric that counts drones that ended so."""

_OF_SUCCESSES = ("time_to_goal_s", "energy_j")
_OF_ALL = (
    "minimum_separation_m",
    "worst_tracking_error_m",
    "rms_tracking_error_m",
    "worst_height_error_m",
    "worst_force_g",
    "length_s",
)


def interquartile_mean(values: FloatArray, axis: int = -1) -> FloatArray:
    """Mean of the middle half: of n values, a quarter (rounded down) is left out at each end."""
    from scipy.stats import trim_mean

    return np.asarray(trim_mean(values, 0.25, axis=axis))


def bootstrap_interval(
    values: FloatArray, statistic: Callable[..., FloatArray] = interquartile_mean
) -> list[float]:
    """Percentile bootstrap interval of a statistic of values (n,); the same values, the same ends.

    One value has no spread to draw from: both ends are that value.
    """
    from scipy.stats import bootstrap

    if len(values) < 2:
        return [float(values[0])] * 2
    result = bootstrap(
        (values,),
        statistic,
        n_resamples=RESAMPLES,
        confidence_level=CONFIDENCE,
        method="percentile",
        vectorized=True,
        batch=max(1, 500_000 // len(values)),
        rng=np.random.default_rng(0),
    )
    return [float(end) for end in result.confidence_interval]


def rate_interval(count: int, total: int) -> list[float]:
    """Wilson's interval of a rate: unlike a bootstrap's it has a width at 0 and 1 too."""
    from scipy.stats import binomtest

    ends = binomtest(count, total).proportion_ci(CONFIDENCE, method="wilson")
    return [float(ends.low), float(ends.high)]


def score(episodes: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """What an agent's episodes add up to.

    Rates (with Wilson's intervals): `success_rate`; `collision_rate`, of episodes in which any
    drone collided, left the arena or tumbled; `collision_rate_by_kind`, of which several may hold;
    `near_miss_rate`, of episodes with a near miss that no crash followed. Interquartile means
    (with bootstrap intervals): `time_to_goal_s` and `energy_j` of the successes, the others of all
    episodes that have them, null where none has; of separation also the smallest, of errors also
    the largest. `act_ms`: time of one decision for the whole team, median and 99th percentile of
    the `timed_decisions`: those of episodes that were flown one by one.

    Args:
        episodes: of `swarm_envs.agents.evaluation`.

    Raises:
        ValueError: there is none.
    """
    if not episodes:
        raise ValueError("there is no episode to score; fly at least one")
    metrics = [episode["metrics"] for episode in episodes]
    crashed = [any(m[name] for name in COLLISIONS.values()) for m in metrics]
    flags = {
        "success_rate": [m["success"] for m in metrics],
        "collision_rate": crashed,
        "near_miss_rate": [
            m["near_misses"] > 0 and not bad for m, bad in zip(metrics, crashed, strict=True)
        ],
    }
    numbers: dict[str, Any] = {"episodes": len(metrics)}
    intervals: dict[str, list[float]] = {}
    for name, flag in flags.items():
        numbers[name] = sum(flag) / len(flag)
        intervals[name] = rate_interval(sum(flag), len(flag))
    numbers["collision_rate_by_kind"] = {
        kind: sum(m[name] > 0 for m in metrics) / len(metrics) for kind, name in COLLISIONS.items()
    }
    successes = [m for m in metrics if m["success"]]
    for names, of in ((_OF_SUCCESSES, successes), (_OF_ALL, metrics)):
        for name in names:
            values = np.array([m[name] for m in of if m[name] is not None], dtype=np.float64)
            numbers[name] = float(interquartile_mean(values)) if len(values) else None
            if len(values):
                intervals[name] = bootstrap_interval(values)
    numbers |= _extremes(metrics)
    numbers["act_ms"] = _compute(episodes)
    numbers["timed_decisions"] = sum(len(episode["act_us"]) for episode in episodes)
    return {**numbers, "intervals": intervals}


def _extremes(metrics: Sequence[dict[str, Any]]) -> dict[str, float | None]:
    """The worst of all episodes."""
    found: dict[str, float | None] = {}
    for new, name, worst in (
        ("smallest_separation_m", "minimum_separation_m", min),
        ("largest_tracking_error_m", "worst_tracking_error_m", max),
    ):
        values = [float(m[name]) for m in metrics if m[name] is not None]
        found[new] = worst(values) if values else None
    return found


def _compute(episodes: Sequence[dict[str, Any]]) -> dict[str, float | None]:
    spent = np.concatenate([np.asarray(episode["act_us"], np.float64) for episode in episodes])
    names = {"p50": 50.0, "p99": 99.0}
    if not len(spent):
        return dict.fromkeys(names)
    return {name: float(np.percentile(spent, share)) / 1e3 for name, share in names.items()}
