"""How near two robots come between knots: the quantity that eq. (17) keeps above r."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from swarm_envs.state import FloatArray

_PIECES = 4
"""Straight pieces for a step's parabola: a quarter of 0.1 s at 5 m/s^2 bends by 0.4 mm."""


class Approach(NamedTuple):
    """The closest approach of pairs within each of T steps."""

    distance: FloatArray
    """(T, ...) smallest distance within the step, m."""
    offset: FloatArray
    """(T, ..., 3) offset there, m."""
    fraction: FloatArray
    """(T, ...) share of the step at which it occurs, in [0, 1]."""


def step_weights(fraction: FloatArray, dt: float) -> tuple[FloatArray, FloatArray]:
    """Weights of the velocities at a step's two ends in the position within it.

    With the acceleration held, p(tau) = p + a v + b v', where v and v' are the velocities at the
    ends, and a and b what is returned, s.

    Args:
        fraction: (...) share tau of the step, in [0, 1].
        dt: length of the step, s.
    """
    half = 0.5 * fraction**2
    return dt * (fraction - half), dt * half


def position_within(states: FloatArray, fraction: FloatArray, dt: float) -> FloatArray:
    """Positions (..., T, ..., 3) within each of T steps, m.

    Args:
        states: (T + 1, ..., 6) states at the knots.
        fraction: share of each step, that broadcasts against (T, ...).
        dt: time between knots, s.
    """
    first, second = step_weights(fraction[..., None], dt)
    start, end = states[:-1], states[1:]
    return np.asarray(start[..., :3] + first * start[..., 3:] + second * end[..., 3:])


def state_within(states: FloatArray, fraction: FloatArray, dt: float) -> FloatArray:
    """States (..., T, ..., 6) within each of T steps: as `position_within`, with velocities."""
    start, change = states[:-1, ..., 3:], np.diff(states[..., 3:], axis=0)
    position = position_within(states, fraction, dt)
    velocity = np.broadcast_to(start + fraction[..., None] * change, position.shape)
    return np.concatenate([position, velocity], axis=-1)


def closest_approach(states: FloatArray, dt: float) -> Approach:
    """The closest approach to the origin in every step of relative motions.

    Args:
        states: (T + 1, ..., 6) relative positions (m) and velocities (m/s) at the knots.
        dt: time between knots, s.
    """
    corner = np.linspace(0.0, 1.0, _PIECES + 1).reshape(-1, *(1,) * (states.ndim - 1))
    points = position_within(states, corner, dt)
    way = np.diff(points, axis=0)
    square = (way**2).sum(axis=-1)
    along = -(points[:-1] * way).sum(axis=-1) / np.where(square > 0.0, square, 1.0)
    share = np.clip(along, 0.0, 1.0)
    nearest = points[:-1] + share[..., None] * way
    best = np.linalg.norm(nearest, axis=-1).argmin(axis=0)[None]
    fraction = (best[0] + np.take_along_axis(share, best, axis=0)[0]) / _PIECES
    offset = position_within(states, fraction, dt)
    return Approach(np.linalg.norm(offset, axis=-1), offset, fraction)
