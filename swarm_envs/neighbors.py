"""Search for near drones: all pairs in small teams; in large ones a sweep of drones sorted along x.

Both methods find the same drones in the same order, so that results are bitwise equal.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from swarm_envs.compiled import part
from swarm_envs.state import FloatArray, IntArray
from swarm_envs.tables import Records

FEW = 24  # Largest number of drones for which all pairs are compared


@part
def sort_along_x(position: FloatArray, order: IntArray) -> None:
    """Sort the `order` of drones (N,) by the x of `position` (N, 3), and equal ones by index.

    Insertion sort is fast here, since the order of the last step is nearly sorted.
    """
    for a in range(1, order.shape[0]):
        i = order[a]
        x, b = position[i, 0], a
        while b > 0:
            j = order[b - 1]
            if position[j, 0] < x or (position[j, 0] == x and j < i):
                break
            order[b] = j
            b -= 1
        order[b] = i


@part
def insert_sorted(value: int, count: int, values: IntArray) -> None:
    """Insert a value among the first `count` of `values`, which are sorted."""
    place = count
    while place > 0 and values[place - 1] > value:
        values[place] = values[place - 1]
        place -= 1
    values[place] = value


@part
def within_box(
    position: FloatArray,
    order: IntArray,
    place: int,
    lateral: float,
    vertical: float,
    found: IntArray,
) -> int:
    """Write the sorted indices of the drones in a box around one to `found`; return their number.

    The drone is that at index `place` of `order` (N,), which is sorted along x. The box extends
    `lateral` meters to each side in x and y, and `vertical` meters in z. `position` is (N, 3), m.
    """
    i, count = order[place], 0
    for step in (-1, 1):
        b = place + step
        while 0 <= b < order.shape[0]:
            j = order[b]
            if not abs(position[j, 0] - position[i, 0]) < lateral:
                break
            beside = abs(position[j, 1] - position[i, 1]) < lateral
            level = abs(position[j, 2] - position[i, 2]) < vertical
            if beside & level:  # one rarely taken branch is faster than two
                insert_sorted(j, count, found)
                count += 1
            b += step
    return count


@part
def nearest(
    i: int, position: FloatArray, drones: Records, found: IntArray, square: FloatArray
) -> int:
    """Write indices (K,) and squared distances, m^2, of the drones nearest to `i`; return a number.

    Nearest drones are first, equally near ones in the order of their indices. Drones whose episode
    has ended are left out; the returned number is that of the drones found, at most K.
    """
    count, places, bound = 0, found.shape[0], math.inf if found.shape[0] > 0 else -1.0
    for j in range(position.shape[0]):
        dx = position[j, 0] - position[i, 0]
        dy, dz = position[j, 1] - position[i, 1], position[j, 2] - position[i, 2]
        d = dx * dx + dy * dy + dz * dz
        # Of equally near drones, earlier ones have the smaller index
        if j != i and d < bound and drones[j].active > 0.0:
            place = count if count < places else places - 1
            count = place + 1
            while place > 0 and square[place - 1] > d:
                found[place], square[place] = found[place - 1], square[place - 1]
                place -= 1
            found[place], square[place] = j, d
            if count == places:
                bound = square[count - 1]
    return count


@part
def nearest_sorted(
    i: int,
    place: int,
    position: FloatArray,
    drones: Records,
    order: IntArray,
    found: IntArray,
    square: FloatArray,
) -> int:
    """Do the same as `nearest` in a large team; drone `i` is at index `place` of the `order`."""
    count: Any = np.int64(0)  # a literal 0 would compile `_offer` twice
    places, bound = found.shape[0], math.inf if found.shape[0] > 0 else -1.0
    for step in (-1, 1):
        b = place + step
        while 0 <= b < order.shape[0]:
            j = order[b]
            dx, d = position[j, 0] - position[i, 0], squared_distance(position, i, j)
            if dx * dx > bound:
                break
            if d <= bound and drones[j].active > 0.0:
                count = _offer(j, d, count, found, square)
                if count == places:
                    bound = square[count - 1]
            b += step
    return count


@part
def _offer(j: int, d: float, count: int, found: IntArray, square: FloatArray) -> int:
    """Insert drone `j`, at squared distance `d`, among the `count` nearest; return their number."""
    place = count
    while place > 0 and (
        square[place - 1] > d or (square[place - 1] == d and found[place - 1] > j)
    ):
        place -= 1
    if place == found.shape[0]:
        return count
    count = min(count + 1, found.shape[0])
    for k in range(count - 1, place, -1):
        found[k], square[k] = found[k - 1], square[k - 1]
    found[place], square[place] = j, d
    return count


@part
def squared_distance(position: FloatArray, i: int, j: int) -> float:
    """Return the squared distance of two drones' centers, m^2."""
    dx = position[j, 0] - position[i, 0]
    dy = position[j, 1] - position[i, 1]
    dz = position[j, 2] - position[i, 2]
    return dx * dx + dy * dy + dz * dz
