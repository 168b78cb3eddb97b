"""Bounded shapes that rewards are made of, and the terms that all tasks share.

Every term lies in [0, 1], or in [-1, 1] where it has a sign, so weights alone set the scale.
Arrays lead with (E, N): environments, drones.
"""

from __future__ import annotations

import numpy as np

from swarm_envs.state import FloatArray


def bell(x: FloatArray, width: float) -> FloatArray:
    """exp(-(x / width)^2): 1 at zero, 0.37 at `width`."""
    return np.asarray(np.exp(-np.square(x / width)))


def ramp(x: FloatArray, zero_at: float, one_at: float) -> FloatArray:
    """Linear from 0 at `zero_at` to 1 at `one_at`, constant beyond both."""
    return np.minimum(np.maximum((x - zero_at) / (one_at - zero_at), 0.0), 1.0)


def progress(before: FloatArray, now: FloatArray, farthest: float) -> FloatArray:
    """Decrease of a distance, as a share of the most a drone can cover: within [-1, 1].

    Args:
        before: (E, N) distance to the goal at the last decision, m.
        now: (E, N) distance to the goal now, m.
        farthest: distance covered at the speed limit between decisions, m.
    """
    return np.minimum(np.maximum((before - now) / farthest, -1.0), 1.0)


def proximity(clearance: FloatArray) -> FloatArray:
    """1 where drones touch, 0 from 2.5 times the sum of their radii on.

    Args:
        clearance: (E, N) distance to the nearest drone over the sum of radii.
    """
    return ramp(clearance, 2.5, 1.0)
