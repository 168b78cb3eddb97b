"""Bounded shapes that rewards are made of, and their weighted sum.

Every term lies in [0, 1], or in [-1, 1] where it has a sign, so weights alone set the scale.
"""

from __future__ import annotations

import math

from swarm_envs.compiled import kernel
from swarm_envs.state import BoolArray, FloatArray


@kernel
def bell(x: float, width: float) -> float:
    """exp(-(x / width)^2): 1 at zero, 0.37 at `width`."""
    return math.exp(-((x / width) ** 2))


@kernel
def ramp(x: float, zero_at: float, one_at: float) -> float:
    """Linear from 0 at `zero_at` to 1 at `one_at`, constant beyond both."""
    return min(max((x - zero_at) / (one_at - zero_at), 0.0), 1.0)


@kernel
def progress(before: float, now: float, farthest: float) -> float:
    """Decrease of a distance, as a share of the most a drone can cover: within [-1, 1].

    Args:
        before: distance to the goal at the last decision, m.
        now: distance to the goal now, m.
        farthest: distance covered at the speed limit between decisions, m.
    """
    return min(max((before - now) / farthest, -1.0), 1.0)


@kernel
def proximity(clearance: float) -> float:
    """1 where drones touch, 0 from 2.5 times the sum of their radii on.

    Args:
        clearance: distance to the nearest drone over the sum of radii.
    """
    return ramp(clearance, 2.5, 1.0)


@kernel
def weigh(terms: FloatArray, weights: FloatArray, running: BoolArray, rewards: FloatArray) -> None:
    """Sum weighted terms, in their order: compiled, so that no batch changes the last bit.

    Args:
        terms: (T, E, N).
        weights: (T,).
        running: (E,) environments that fly; the others get nothing.
        rewards: (E, N), written.
    """
    for e in range(rewards.shape[0]):
        for i in range(rewards.shape[1]):
            total = 0.0
            for t in range(terms.shape[0]):
                total += weights[t] * terms[t, e, i]
            rewards[e, i] = total if running[e] else 0.0
