"""Reference trajectories with exact derivatives, as functions of time.

Positions are (..., 3). Times broadcast with their leading axes: a start (3,) with times (T,) gives
(T, 3), and starts (N, 3) with one time give (N, 3).
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
    """Return the motion at rest at a position (..., 3), m."""
    still = np.zeros_like(position)
    return Reference(position, still, still, still)


def rest_to_rest(
    start: npt.ArrayLike, goal: npt.ArrayLike, duration: npt.ArrayLike, t: npt.ArrayLike
) -> Reference:
    """Return a straight minimum-snap motion from rest to rest, a polynomial of 7th order in time.

    Velocity, acceleration and jerk are zero at both ends, and the motion is at rest before and
    after.

    Args:
        start: (..., 3) start position, m.
        goal: (..., 3) end position, m.
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
    """Return a straight motion at constant speed, with quintic ramps of the speed at both ends.

    The jerk is continuous, and the motion is at rest before and after.

    Args:
        start: (..., 3) start position, m.
        goal: (..., 3) end position, m.
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
    full = 1.0 - ramp  # the sum of both halves of the warped time
    value, first, second, third = _ramped_time(1.0 - u, ramp)
    down, up = (full - value, first, -second, third), _ramped_time(u, ramp)
    profile = [np.where(u > 0.5, after, before) / full for after, before in zip(down, up)]
    return _along_line(start, goal, time, profile)


def _ramped_time(t: FloatArray, ramp_time: float) -> tuple[FloatArray, ...]:
    """Return a time with rate 0 before t = 0 and rate 1 after ramp_time; and three derivatives."""
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
    """Return the motion with this share of the line; the profile has its derivatives too."""
    origin, end = _points("start", start), _points("goal", goal)
    try:
        np.broadcast_shapes(origin.shape[:-1], end.shape[:-1], profile[0].shape)
    except ValueError:
        raise ValueError(
            f"start {origin.shape}, goal {end.shape}, duration and t {profile[0].shape} do not "
            "broadcast; give leading axes of equal length, or of length one"
        ) from None
    path = end - origin
    with np.errstate(over="ignore"):  # for very long durations
        slopes = [part / duration**k for k, part in enumerate(profile[1:], start=1)]
    value = profile[0][..., None]
    # Weighted so that the end is reached to the last bit
    position = origin * (1.0 - value) + end * value
    parts = np.broadcast_arrays(position, *(slope[..., None] * path for slope in slopes))
    return Reference(*map(np.array, parts))  # copies, since broadcast views share memory


def _points(name: str, value: npt.ArrayLike) -> FloatArray:
    array = as_numbers(name, value)
    if array.ndim == 0 or array.shape[-1] != 3:
        raise ValueError(f"{name} has shape {array.shape}, but must end in 3: x, y, z")
    if not np.isfinite(array).all():
        raise ValueError(f"{name} is {array.tolist()}, but all numbers must be finite")
    return array


def _times(t: npt.ArrayLike) -> FloatArray:
    array = as_numbers("t", t)
    if np.isnan(array).any():
        raise ValueError(f"t is {t!r}, but must not contain NaN")
    return array


def _positive(name: str, value: npt.ArrayLike) -> FloatArray:
    array = as_numbers(name, value)
    if not (np.isfinite(array) & (array > 0.0)).all():
        raise ValueError(f"{name} is {value!r}, but must be positive and finite")
    return array
