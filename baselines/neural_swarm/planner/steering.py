"""Steering of a double integrator with drag: bursts of constant control, coasting between.

For min of the integral of ||u|| (eq. 6) between two states in a given time, thrust at both ends and
coast between: by the maximum principle an optimal control acts where the adjoint of v is largest,
and for linear drag that adjoint runs along a line in exp(drag t), so its norm is largest at an end.
Controls are held over edges of several knots, so an impulse becomes a burst of one edge or more.
"""

from __future__ import annotations

import math

import numpy as np

from swarm_envs.compiled import kernel
from swarm_envs.state import FloatArray

LONGEST_BURST = 8
"""Edges in the longest burst that is tried."""
COAST, PUSH = 0, 1
"""Which of `responses`: a velocity without control, or a control held from rest."""
PLACE, SPEED = 0, 1
"""What of a response: the position, m, or the speed, m/s."""


def responses(drag: FloatArray, dt: float, steps: int) -> FloatArray:
    """What a unit velocity and a unit control do after up to K steps of dt, s: (2, K + 1, 2, 3).

    [COAST] after starting at 1 m/s without control, [PUSH] after starting at rest with 1 m/s^2
    held; for each the [PLACE] (m) and [SPEED] (m/s) along each axis, with linear `drag` (3,) per
    mass, 1/s. The acceleration is held over a step.
    """
    table = np.zeros((2, steps + 1, 2, 3))
    table[COAST, 0, SPEED] = 1.0
    for mode in (COAST, PUSH):
        for k in range(steps):
            place, speed = table[mode, k]
            acceleration = mode - drag * speed
            table[mode, k + 1, PLACE] = place + dt * speed + 0.5 * dt * dt * acceleration
            table[mode, k + 1, SPEED] = speed + dt * acceleration
    return table


@kernel
def impulse_cost(table: FloatArray, steps: int, way: FloatArray, velocity: FloatArray) -> float:
    """Least integral of ||u|| from a velocity (3,) to rest, a way (3,) further: two impulses.

    A lower bound where nothing but drag acts; exactly so in the limit of short steps, as a held
    control is not dragged within its step. `table` is from `responses`; the result is in m/s.
    """
    first, last = 0.0, 0.0
    for k in range(3):
        needed = way[k] / table[COAST, steps, PLACE, k]
        first += (needed - velocity[k]) ** 2
        last += (needed * table[COAST, steps, SPEED, k]) ** 2
    return math.sqrt(first) + math.sqrt(last)


@kernel
def reach_burst(
    table: FloatArray,
    edge: int,
    edges: int,
    limit: float,
    way: FloatArray,
    velocity: FloatArray,
    control: FloatArray,
) -> bool:
    """Find the shortest burst after which coasting leads to a place in time, at any velocity.

    The place lies a `way` (3,), m, and so many `edges` of so many steps ahead; `limit` is the
    largest |u| along an axis, m/s^2. `control` (3,) becomes the burst's, m/s^2. Returns whether
    there is one; else the control is the longest burst's, beyond the limit.
    """
    total = edges * edge
    for burst in range(1, min(edges, LONGEST_BURST) + 1):
        on, off, largest = burst * edge, total - burst * edge, 0.0
        for k in range(3):
            gain = table[PUSH, on, PLACE, k]
            gain += table[PUSH, on, SPEED, k] * table[COAST, off, PLACE, k]
            control[k] = (way[k] - table[COAST, total, PLACE, k] * velocity[k]) / gain
            largest = max(largest, abs(control[k]))
        if largest <= limit:
            return True
    return False


@kernel
def rest_bursts(
    table: FloatArray,
    edge: int,
    edges: int,
    limit: float,
    way: FloatArray,
    velocity: FloatArray,
    control: FloatArray,
) -> float:
    """Find the cheapest pair of bursts, now and last, that lead to a place at rest in time.

    Arguments are as of `reach_burst`, with at least 2 edges; `control` becomes the first burst's.
    Returns the integral of ||u|| over both, in steps times m/s^2; infinite if there are none.
    """
    best, total = np.inf, edges * edge
    longest = min(edges - 1, LONGEST_BURST)
    for first in range(1, longest + 1):
        for last in range(1, min(edges - first, longest) + 1):
            on, end = first * edge, last * edge
            largest, norm_first, norm_last = 0.0, 0.0, 0.0
            x = y = z = 0.0
            for k in range(3):
                pushed = table[PUSH, on, SPEED, k]
                a = table[PUSH, on, PLACE, k] + pushed * table[COAST, total - on, PLACE, k]
                b = table[PUSH, end, PLACE, k]
                c = pushed * table[COAST, total - on, SPEED, k]
                d = table[PUSH, end, SPEED, k]
                place = way[k] - table[COAST, total, PLACE, k] * velocity[k]
                speed = -table[COAST, total, SPEED, k] * velocity[k]
                determinant = a * d - b * c
                now = (place * d - b * speed) / determinant
                then = (a * speed - c * place) / determinant
                largest = max(largest, abs(now), abs(then))
                norm_first += now * now
                norm_last += then * then
                if k == 0:
                    x = now
                elif k == 1:
                    y = now
                else:
                    z = now
            cost = on * math.sqrt(norm_first) + end * math.sqrt(norm_last)
            if largest <= limit and cost < best:
                best = cost
                control[0], control[1], control[2] = x, y, z
    return best
