"""The interaction volume: which pairs are evaluated, and how their contribution fades out."""

from __future__ import annotations

from swarm_envs.compiled import borrowing_kernel
from swarm_envs.neighbors import FEW, sort_along_x, within_box
from swarm_envs.state import FloatArray, IntArray


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


@borrowing_kernel
def find_pairs(
    window: FloatArray,
    drones: int,
    position: FloatArray,
    order: IntArray,
    pairs: IntArray,
    weight: FloatArray,
) -> int:
    """List all ordered pairs inside the interaction volume; return how many there are.

    Args:
        window: (4,) as in `pair_weight`.
        drones: number of drones in each environment, N.
        position: (M, 3) m, M a multiple of N.
        order: (M,) of each environment any permutation of 0 to N - 1; sorted along x if N is large.
        pairs: (2, M (N - 1)) drones `i` and `j`, written: those of an `i` together, `j` ascending.
        weight: (M (N - 1),) their weights, written.
    """
    count = 0
    for first in range(0, position.shape[0], drones):
        end = first + drones
        here, sorted_here = position[first:end], order[first:end]
        if drones > FEW:
            sort_along_x(here, sorted_here)
        for place in range(drones):
            if drones > FEW:
                i = sorted_here[place]
                near = pairs[1]
                close = within_box(here, sorted_here, place, window[1], window[3], near, count)
            else:
                i, close = place, drones - 1
            begin = count
            for c in range(close):
                j = pairs[1, begin + c] if drones > FEW else c + (c >= i)
                dx = here[j, 0] - here[i, 0]
                if abs(dx) < window[1]:
                    dy, dz = here[j, 1] - here[i, 1], here[j, 2] - here[i, 2]
                    left = pair_weight(window, dx, dy, dz)
                    if left > 0.0:
                        pairs[0, count], pairs[1, count] = first + i, first + j
                        weight[count] = left
                        count += 1
    return count
