"""The interaction volume: which pairs are evaluated, and how their contribution fades out."""

from __future__ import annotations

from swarm_envs.compiled import borrowing_kernel
from swarm_envs.state import FloatArray


@borrowing_kernel
def fade(distance: float, full: float, end: float) -> float:
    """Weight 1 up to `full`, 0 from `end`, a quintic smoothstep between: twice differentiable."""
    if distance <= full:
        return 1.0
    if distance >= end:
        return 0.0
    u = (distance - full) / (end - full)
    return 1.0 - u * u * u * (10.0 + u * (6.0 * u - 15.0))


@borrowing_kernel
def pair_weight(window: FloatArray, dx: float, dy: float, dz: float) -> float:
    """Weight of a pair at offset (dx, dy, dz), m: 1 well inside the volume, 0 at its edge.

    Args:
        window: (4,) lateral full and end, vertical full and end, m.
        dx: offset in x, m.
        dy: offset in y, m.
        dz: offset in z, m.
    """
    if abs(dx) >= window[1] or abs(dy) >= window[1] or abs(dz) >= window[3]:
        return 0.0
    lateral = fade(abs(dx), window[0], window[1]) * fade(abs(dy), window[0], window[1])
    return lateral * fade(abs(dz), window[2], window[3])


@borrowing_kernel
def clamp(value: float, low: float, high: float) -> float:
    """The value, moved into [low, high]."""
    return min(max(value, low), high)
