"""Artificial potentials that keep random walks apart and off the floor (Khatib, 1986).

U(c) = strength / 2 (1/c - 1/reach)^2 for clearances c < reach, else 0.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from swarm_envs.compiled import kernel
from swarm_envs.state import FloatArray

_LEAST = 1e-3


class Potential(NamedTuple):
    """A potential of the clearance to what repels."""

    reach: float
    """Clearance below which it repels, m."""
    strength: float
    """m^4/s^2."""
    limit: float
    """Largest acceleration, m/s^2."""


@kernel
def repulsion(clearance: float, potential: Potential) -> float:
    """Acceleration -dU/dc away from what is at a clearance c, m, within its limit, m/s^2."""
    c = max(clearance, _LEAST)
    if c >= potential.reach:
        return 0.0
    slope = potential.strength * (1.0 / c - 1.0 / potential.reach) / (c * c)
    return min(slope, potential.limit)


@kernel
def push_apart(
    position: FloatArray,
    radius: FloatArray,
    neighbor: Potential,
    floor: Potential,
    out: FloatArray,
) -> None:
    """Write the acceleration by which E teams of N drones repel each other and the floor.

    Args:
        position: (E, N, 3) m, z up from the floor.
        radius: (N,) of the drones' spheres, m.
        neighbor: potential of the clearance between two spheres.
        floor: potential of the clearance of a sphere from the floor.
        out: (E, N, 3) m/s^2, overwritten.
    """
    out[:] = 0.0
    for e in range(position.shape[0]):
        p, push = position[e], out[e]
        for i in range(p.shape[0]):
            push[i, 2] += repulsion(p[i, 2] - radius[i], floor)
            for j in range(i):
                x, y, z = p[i, 0] - p[j, 0], p[i, 1] - p[j, 1], p[i, 2] - p[j, 2]
                distance = math.sqrt(x * x + y * y + z * z)
                size = repulsion(distance - (radius[i] + radius[j]), neighbor)
                scale = size / max(distance, 1e-6)
                for k, part in enumerate((x, y, z)):
                    push[i, k] += scale * part
                    push[j, k] -= scale * part
