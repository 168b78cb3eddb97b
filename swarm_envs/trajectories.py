"""Reference trajectories with exact derivatives: pure functions of time, over any leading axes.

Positions are (..., 3); times broadcast against their leading axes, so that a (3,) start with (T,)
times gives (T, 3), and (N, 3) starts with one time give (N, 3).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from swarm_envs.errors import as_numbers, check_number
from swarm_envs.state import FloatArray

__all__ = ["Reference", "ramped_line", "rest_to_rest"]


class Reference(NamedTuple):
    """A desired motion at given times. World frame, SI units."""

    position: FloatArray
    """(..., 3) position, m."""
    velocity: FloatArray
    """(..., 3) its derivative, m/s."""
    acceleration: FloatArray
    """(..., 3) its second derivative, m/s^2."""
    jerk: FloatArray
    """(..., 3) its third derivative, m/s^3."""


def rest(position: FloatArray) -> Reference:
    """The motion that stays at a position (..., 3), m."""
    still = np.zeros_like(position)
    return Reference(position, still, still, still)


def rest_to_rest(
    start: npt.ArrayLike, goal: npt.ArrayLike, duration: npt.ArrayLike, t: npt.ArrayLike
) -> Reference:
    """Straight minimum-snap motion between two points at rest: a polynomial of 7th order in time.

    Velocity, acceleration and jerk are zero at both ends; before the start and after the end the
    motion rests there.

    Args:
        start: (..., 3) where it starts, m.
        goal: (..., 3) where it ends, m.
        duration: (...) time from start to goal, s.
        t: (...) times since the start, s.

    Raises:
        ValueError: a position does not end in three finite numbers, or the duration is not
            positive and finite.
    """
    time = _positive("duration", duration)
    u = np.clip(_times(t) / time, 0.0, 1.0)
    value = u**4 * (35.0 - 84.0 * u + 70.0 * u**2 - 20.0 * u**3)
    first = 140.0 * u**3 * (1.0 - u) ** 3
    second = 420.0 * u**2 * (1.0 - u) ** 2 * (1.0 - 2.0 * u)
    third = 840.0 * u * (1.0 - u) * (1.0 - 5.0 * u + 5.0 * u**2)
    return _along_line(start, goal, time, (value, first, second, third))


def ramped_line(
    start: npt.ArrayLike,
    goal: npt.ArrayLike,
    duration: npt.ArrayLike,
    t: npt.ArrayLike,
    ramp: float = 0.2,
) -> Reference:
    """Straight motion at constant speed, with quintic ramps of the speed at both ends.

    Jerk is continuous; before the start and after the end the motion rests there.

    Args:
        start: (..., 3) where it starts, m.
        goal: (..., 3) where it ends, m.
        duration: (...) time from start to goal, s.
        t: (...) times since the start, s.
        ramp: share of the duration that each of the two ramps takes, in (0, 0.5].

    Raises:
        ValueError: a position does not end in three finite numbers, the duration is not positive
            and finite, or the ramp lies outside (0, 0.5].
    """
    check_number("ramp", ramp, above=0.0, at_most=0.5)
    time = _positive("duration", duration)
    u = np.clip(_times(t) / time, 0.0, 1.0)
    full = 1.0 - ramp  # what the two halves of the warped time sum to
    value, first, second, third = _ramped_time(1.0 - u, ramp)
    down, up = (full - value, first, -second, third), _ramped_time(u, ramp)
    profile = [np.where(u > 0.5, after, before) / full for after, before in zip(down, up)]
    return _along_line(start, goal, time, profile)


def _ramped_time(t: FloatArray, ramp_time: float) -> tuple[FloatArray, ...]:
    """Time that stands still before zero and runs at full rate after ramp_time; three slopes."""
    x = np.clip(t / ramp_time, 0.0, 1.0)
    begun = np.where(t < ramp_time, x**4 * (2.5 - 3.0 * x + x**2), x - 0.5) * ramp_time
    value = begun + np.maximum(t - ramp_time, 0.0)
    first = x**3 * (10.0 - 15.0 * x + 6.0 * x**2)
    second = 30.0 * x**2 * (1.0 - x) ** 2 / ramp_time
    third = 60.0 * x * (1.0 - x) * (1.0 - 2.0 * x) / ramp_time**2
    return value, first, second, third


def _along_line(
    start: npt.ArrayLike, goal: npt.ArrayLike, duration: FloatArray, profile: Sequence[FloatArray]
) -> Reference:
    """The motion of which a share, and its slopes by the share of the duration, are given."""
    origin, end = _points("start", start), _points("goal", goal)
    try:
        np.broadcast_shapes(origin.shape[:-1], end.shape[:-1], profile[0].shape)
    except ValueError:
        raise ValueError(
            f"start {origin.shape}, goal {end.shape}, duration and t {profile[0].shape} do not "
            "fit together: each leads with as many, or with one"
        ) from None
    way = end - origin
    with np.errstate(over="ignore"):  # what takes for ever has no derivatives
        slopes = [part / duration**k for k, part in enumerate(profile[1:], start=1)]
    value = profile[0][..., None]
    # Weighted so that the end is met to the last bit.
    position = origin * (1.0 - value) + end * value
    parts = np.broadcast_arrays(position, *(slope[..., None] * way for slope in slopes))
    return Reference(*map(np.array, parts))  # each with its own memory


def _points(name: str, value: npt.ArrayLike) -> FloatArray:
    array = as_numbers(name, value)
    if array.ndim == 0 or array.shape[-1] != 3:
        raise ValueError(f"{name} has shape {array.shape}, but must end in 3: x, y, z")
    if not np.isfinite(array).all():
        raise ValueError(f"{name} is {array.tolist()}, but must be finite")
    return array


def _times(t: npt.ArrayLike) -> FloatArray:
    array = as_numbers("t", t)
    if np.isnan(array).any():
        raise ValueError(f"t is {t!r}, but must hold no NaN")
    return array


def _positive(name: str, value: npt.ArrayLike) -> FloatArray:
    array = as_numbers(name, value)
    if not (np.isfinite(array) & (array > 0.0)).all():
        raise ValueError(f"{name} is {value!r}, but must be positive and finite")
    return array
