"""Shuffles on highways: all robots move along one axis to their slots at once (Sec. III-B).

Across the long axis (short and high shuffles) a robot steps from the middle lane x = 3i + 1 of its
strip into one of the two lanes next to it, on one side to go up, on the other to go down; runs; and
steps back: m + 1 steps at most (the paper has m + 5 for any shuffle). Along the long axis, the
robots of a cell first change lanes (3 steps), run, park in the row between the lanes, and form a
column again (2 steps).

A cell is 3 x 3 vertices, long axis first. Its robots are on the column x = 1, at y = 0, 1, 2, or
at y = 0, 2 around an obstacle. When lanes are changed, a robot that continues to larger x moves to
the lane y = 0, to smaller x to y = 2, and one that stays to the row y = 1 between them.
"""

from __future__ import annotations

from functools import cache
from itertools import product
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from swarm_envs.baselines.rth3d.grid import Array
from swarm_envs.baselines.rth3d.path_lengths import Ints
from swarm_envs.compiled import kernel

STEPS = 3  # The steps of a change of lanes
LANE = {0: 1, 1: 0, 2: 2}
"""The lane of a robot by its heading: 0 for staying, 1 for going up, 2 for going down."""

_MOVES = ((0, 0), (1, 0), (-1, 0), (0, 1), (0, -1))
_Walk = npt.NDArray[np.int64]


@cache
def _walks(row: int, heading: int, obstacle: bool) -> tuple[tuple[_Walk, int], ...]:
    """Return walks (STEPS + 1, 2) from (1, row) into the right lane, each with its cost."""
    found = []
    for moves in product(_MOVES, repeat=STEPS):
        walk = np.cumsum([(1, row), *moves], axis=0)
        inside = ((walk >= 0) & (walk < 3)).all()
        if not inside or walk[-1, 1] != LANE[heading]:
            continue
        if obstacle and (walk == 1).all(axis=1).any():
            continue
        progress = (walk[-1, 0] - 1) * (0, 1, -1)[heading]
        found.append((walk, 2 * sum(move != (0, 0) for move in moves) - int(progress)))
    return tuple(sorted(found, key=lambda pair: (pair[1], pair[0].tolist())))


def _apart(first: _Walk, second: _Walk) -> bool:
    """Return True if two walks never share a vertex and never swap."""
    same = (first == second).all(axis=1).any()
    there = (first[1:] == second[:-1]).all(axis=1)
    back = (first[:-1] == second[1:]).all(axis=1)
    return not (same or (there & back).any())


def _cheapest(rows: tuple[int, ...], headings: tuple[int, ...], obstacle: bool) -> list[_Walk]:
    """Return the collision-free walks of all robots of a cell with the least cost."""
    best: tuple[float, list[_Walk]] = (np.inf, [])

    def extend(chosen: list[_Walk], cost: int) -> None:
        nonlocal best
        if len(chosen) == len(rows):
            best = (cost, chosen)
            return
        k = len(chosen)
        for walk, own in _walks(rows[k], headings[k], obstacle):
            least = sum(
                _walks(r, h, obstacle)[0][1] for r, h in zip(rows[k + 1 :], headings[k + 1 :])
            )
            if cost + own + least >= best[0]:
                break
            if all(_apart(walk, other) for other in chosen):
                extend([*chosen, walk], cost + own)

    extend([], 0)
    return best[1]


@cache
def lane_changes(held: int) -> npt.NDArray[np.int8]:
    """Return all changes of lanes in a cell that holds 3 robots, or 2 around an obstacle.

    They are (3 ** held, held, STEPS, 2): the position of each robot in the cell after each step,
    for every combination of headings, whose index is the sum of heading k times 3 ** k.
    """
    rows = (0, 1, 2) if held == 3 else (0, 2)
    found = np.empty((3**held, held, STEPS, 2), dtype=np.int8)
    for code in range(3**held):
        headings = tuple(code // 3**k % 3 for k in range(held))
        for k, walk in enumerate(_cheapest(rows, headings, held == 2)):
            found[code, k] = walk[1:]
    return found


class Shift(NamedTuple):
    """A shuffle across the long axis, by the distance of each item."""

    distance: Ints  # (n,) edges along the axis, with sign
    stride: int  # Difference of the numbers of two neighbors along the axis

    @property
    def duration(self) -> int:
        """The number of steps until the last robot has stepped back."""
        longest = int(np.abs(self.distance).max(initial=0))
        return longest + 2 if longest else 0

    def of(self, items: Ints) -> Shift:
        """Return the shuffle of some items (n,) alone."""
        return Shift(self.distance[items], self.stride)


class LongShift(NamedTuple):
    """A shuffle along the long axis, by the moves of each item."""

    change: Ints
    """(n, STEPS) difference of its vertex's number after each step of the change of lanes."""
    run: Ints  # (n,) vertices to run, with sign
    park: Ints  # (n,) difference of its vertex's number when it parks
    leave: Ints  # (n, 2) difference in each of the last two steps

    @property
    def duration(self) -> int:
        """The number of steps until all columns are formed."""
        if not self.change.any() and not self.run.any():
            return 0
        return STEPS + int(np.abs(self.run).max(initial=0)) + 1 + 2

    def of(self, items: Ints) -> LongShift:
        """Return the shuffle of some items (n,) alone."""
        return LongShift(*(part[items] for part in self))


@kernel
def write_shift(
    paths: Array, begin: int, duration: int, distance: Array, side: int, stride: int
) -> None:
    """Write a shuffle across the long axis into rows begin + 1 ... begin + duration."""
    for t in range(1, duration + 1):
        for i in range(distance.shape[0]):
            vertex, d = paths[begin, i], distance[i]
            length = abs(d)
            if length and t <= length + 1:
                sign = 1 if d > 0 else -1
                vertex += sign * (side + (t - 1) * stride)
            elif length:
                vertex += d * stride
            paths[begin + t, i] = vertex


@kernel
def write_long_shift(
    paths: Array,
    begin: int,
    duration: int,
    change: Array,
    run: Array,
    park: Array,
    leave: Array,
    stride: int,
) -> None:
    """Write a shuffle along the long axis into rows begin + 1 ... begin + duration."""
    lanes = change.shape[1]
    for t in range(1, duration + 1):
        for i in range(run.shape[0]):
            vertex = paths[begin, i]
            if t <= lanes:
                vertex += change[i, t - 1]
            else:
                length = abs(run[i])
                vertex += change[i, lanes - 1]
                if t <= lanes + length:
                    vertex += stride * (t - lanes if run[i] > 0 else lanes - t)
                else:
                    vertex += stride * run[i] + park[i]
                if t >= duration - 1:
                    vertex += leave[i, 0]
                if t == duration:
                    vertex += leave[i, 1]
            paths[begin + t, i] = vertex


@kernel
def _park(items: Array, source: Array, goal: Array, place: Array, spot: Array, last: int) -> None:
    """Assign robots of a cell to vertices of the row between the lanes, farthest robots first."""
    taken = 0 if items.shape[0] == 3 else 2
    for item in items:
        spot[item] = -1
        if goal[item] == source[item]:
            spot[item] = place[item, last, 0]
            taken |= 1 << spot[item]
    for _ in range(items.shape[0]):
        farthest, longest = -1, 0
        for item in items:
            length = abs(3 * (goal[item] - source[item]) - place[item, last, 0])
            if spot[item] < 0 and length > longest:
                farthest, longest = item, length
        if farthest < 0:
            return
        up = goal[farthest] > source[farthest]
        free = 0 if up else 2
        while taken >> free & 1:
            free += 1 if up else -1
        taken |= 1 << free
        spot[farthest] = free


@kernel
def park_in_cells(
    table: Array, source: Array, goal: Array, changes: Array, place: Array, spot: Array
) -> None:
    """Plan the long shuffle of all strips with `held` robots per cell.

    `table` (S, held, q) is the item in each slot of each strip; `source` and `goal` (items,) are
    its present and target cells. Writes `place` (items, STEPS, 2), its position in its cell during
    the change of lanes, and `spot` (items,), the x in its target cell at which it parks, or -1 if
    its strip rests.
    """
    strips, held, cells = table.shape
    last = changes.shape[2] - 1
    arrived = np.empty((cells, held), dtype=np.int32)
    filled = np.empty(cells, dtype=np.int32)
    for s in range(strips):
        filled[:] = 0
        moving = False
        for c in range(cells):
            code, digit = 0, 1
            for k in range(held):
                item = table[s, k, c]
                heading = 0 if goal[item] == c else 1 if goal[item] > c else 2
                code += digit * heading
                digit *= 3
                arrived[goal[item], filled[goal[item]]] = item
                filled[goal[item]] += 1
            moving = moving or code > 0
            for k in range(held):
                place[table[s, k, c]] = changes[code, k]
        for c in range(cells):
            if moving:
                _park(arrived[c], source, goal, place, spot, last)
            else:
                spot[table[s, :, c]] = -1
