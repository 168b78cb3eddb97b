"""The Rubik table of RTH3D, and MatchingXY, XY-Fitting and Z-Fitting on it (Sec. II-B, III-A).

*Items* move between the balanced configurations S1 and G1, one from every slot of the highways:
robots, and virtual robots in slots without one, whose paths are not written. An item's color is the
(x, y) of its target slot. The long axis is the paper's x, the short one y, the high one z.

The steps of shuffles are in `shuffles`, the perfect matchings in `matching` and `paper_lba`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from swarm_envs.baselines.rth3d.compaction import Paths
from swarm_envs.baselines.rth3d.grid_plan import PlanningClock
from swarm_envs.baselines.rth3d.highways import CELL, Highways
from swarm_envs.baselines.rth3d.path_lengths import Ints
from swarm_envs.baselines.rth3d.shuffles import (
    STEPS,
    LongShift,
    Shift,
    lane_changes,
    park_in_cells,
    write_long_shift,
    write_shift,
)
from swarm_envs.baselines.rth3d.unlabeled_mrpp import Balanced

Matching = Callable[[Ints, npt.NDArray[np.bool_]], Ints]
"""A function that returns levels (G, K, D) from items' targets and a mask of robots."""
Shuffles = dict[str, Shift | LongShift]
"""Shuffles by name, in their order."""


@dataclass(frozen=True, eq=False)
class RubikTable:
    """Items, numbered by their first slot, and their target slots."""

    highways: Highways
    goal: Ints  # (items,) the target slot of each item; slot (c, r, z) has number (c R + r) Z + z
    real: npt.NDArray[np.bool_]  # (items,) True for robots, False for virtual robots
    robots: Ints  # (n,) the item of each robot

    @property
    def rows(self) -> int:
        """The number of rows of slots."""
        return len(self.highways.rows)

    @property
    def heights(self) -> int:
        """The number of planes."""
        return self.highways.shape[2]

    @property
    def cells(self) -> int:
        """The number of cells along the long axis."""
        return self.highways.cells

    def place(self, items: Ints) -> tuple[Ints, Ints, Ints]:
        """Return cell, row and height of slots (n,)."""
        column, height = np.divmod(items, self.heights)
        cell, row = np.divmod(column, self.rows)
        return cell, row, height


def rubik_table(highways: Highways, balanced: Balanced) -> RubikTable:
    """Return the table of all slots, with virtual robots in slots without a robot.

    The goal of a virtual robot is its own slot, or with reflected goals the slot's image, if no
    robot ends there; the remaining goals are assigned in order. The paper draws these goals at
    random (Sec. V-B), though in the proof of Corollary IV.1 they are the starts, as here.
    """
    slots = highways.slots.reshape(-1)
    slot = np.full(int(np.prod(highways.shape)), -1, dtype=np.int32)
    slot[slots] = np.arange(highways.capacity, dtype=np.int32)
    first, last = slot[balanced.first[-1]], slot[balanced.last[-1]]
    preferred = slot[balanced.image[slots]]
    goal = np.full(len(preferred), -1, dtype=np.int32)
    goal[first] = last
    real = goal >= 0
    taken = np.zeros(len(preferred), dtype=np.bool_)
    taken[last] = True
    granted = np.flatnonzero(~real & ~taken[preferred])
    goal[granted], taken[preferred[granted]] = preferred[granted], True
    goal[goal < 0] = np.flatnonzero(~taken)
    return RubikTable(highways, goal, real, first)


def matching_xy(table: RubikTable, match: Matching, clock: PlanningClock) -> tuple[Ints, Shift]:
    """Return each item's height in S2, and the z-shuffle to it (Algorithm 2).

    In S2, by perfect matchings of columns and colors, every plane has every color once.
    """
    with clock.phase("match heights") as record:
        shape = (1, table.cells * table.rows, table.heights)
        aims = table.goal.reshape(shape) // table.heights
        height = match(aims, table.real.reshape(shape)).reshape(-1)
        record(0)
    _, _, before = table.place(np.arange(len(height), dtype=np.int32))
    return height, Shift(height - before, 1)


def xy_fitting(table: RubikTable, height: Ints, match: Matching, clock: PlanningClock) -> Shuffles:
    """Return the shuffles along y, x and y to the (x, y) of G1 (Algorithm 3).

    Their order is that of the paper's text; lines 19 and 20 have the last two in reverse order. Two
    more misprints: line 3 has s2i.y for s2i.z, line 15 has c for r.
    """
    with clock.phase("match rows") as record:
        row = rth2d(table, height, match)
        record(0)
    with clock.phase("change of lanes") as record:
        after, along = _x_shuffle(table, height, row)
        record(0)
    y, stride = table.highways.rows, table.highways.shape[2]
    _, before, _ = table.place(np.arange(len(row), dtype=np.int32))
    _, goal, _ = table.place(table.goal)
    return {
        "rows": Shift(y[row] - y[before], stride),
        "long axis": along,
        "rows to goals": Shift(y[goal] - y[after], stride),
    }


def z_fitting(table: RubikTable, height: Ints) -> Shift:
    """Return the z-shuffle from the heights of S2 to those of G1 (Algorithm 1, line 5)."""
    return Shift(table.goal % table.heights - height, 1)


def rth2d(table: RubikTable, height: Ints, match: Matching) -> Ints:
    """Return the row in which each item crosses its plane: RTH2D (Algorithm 3, lines 5 to 17).

    All planes are matched at once. An item's color is here its target cell.
    """
    items = np.arange(len(height), dtype=np.int32)
    shape = (table.heights, table.cells, table.rows)
    cell, row, _ = table.place(items)
    at = np.empty(shape, dtype=np.int32)
    at[height, cell, row] = items
    aims = table.goal[at] // (table.heights * table.rows)
    found = np.empty(len(items), dtype=np.int32)
    found[at] = match(aims, table.real[at])
    return found


def _x_shuffle(table: RubikTable, height: Ints, row: Ints) -> tuple[Ints, LongShift]:
    """Return the items' rows after the shuffle along the long axis, and the shuffle."""
    highways, items = table.highways, np.arange(len(height), dtype=np.int32)
    source, goal = table.place(items)[0], table.place(table.goal)[0]
    at = np.empty((table.heights, table.rows, table.cells), dtype=np.int32)
    at[height, row, source] = items
    place = np.empty((len(items), STEPS, 2), dtype=np.int8)
    spot = np.empty(len(items), dtype=np.int32)
    strip = highways.rows // CELL
    first_row = np.searchsorted(strip, strip)
    held = np.bincount(strip, minlength=1)[strip]
    for number in np.unique(held):
        rows = np.flatnonzero(held == number)
        tables = at[:, rows].reshape(-1, number, table.cells)
        park_in_cells(tables, source, goal, lane_changes(int(number)), place, spot)
    after = np.where(spot < 0, row, first_row[row] + np.where(held[row] == 3, spot, spot // 2))
    y = highways.rows[row] % CELL
    return after.astype(np.int32), _long_shift(highways, source, goal, y, place, spot)


def _long_shift(
    highways: Highways, source: Ints, goal: Ints, y: Ints, place: npt.NDArray[Any], spot: Ints
) -> LongShift:
    """Return the shuffle along the long axis in numbers of vertices."""
    along, across = highways.shape[1] * highways.shape[2], highways.shape[2]
    rests, place = spot < 0, place.astype(np.int32)
    change = (place[..., 0] - 1) * along + (place[..., 1] - y[:, None]) * across
    change[rests] = 0
    run = np.where(goal == source, 0, CELL * (goal - source) + spot - place[:, -1, 0])
    park = np.sign(run) * across
    aside = np.where(rests, 0, spot - 1)
    leave = np.stack([aside * across, -aside * along], axis=1)
    return LongShift(*(a.astype(np.int32) for a in (change, run, park, leave)))


def concatenate(
    table: RubikTable, balanced: Balanced, shuffles: Shuffles, clock: PlanningClock
) -> Paths:
    """Return the paths (T + 1, n) of the robots: to S1, by the shuffles to G1, to the goals."""
    highways = table.highways
    side = highways.shape[1] * highways.shape[2]
    own = {name: shuffle.of(table.robots) for name, shuffle in shuffles.items()}
    begin = len(balanced.first) - 1
    whole = begin + sum(shuffle.duration for shuffle in own.values()) + len(balanced.last)
    paths = np.empty((whole, balanced.first.shape[1]), dtype=np.int32)
    paths[: begin + 1] = balanced.first
    for name, shuffle in own.items():
        with clock.phase(name) as record:
            if isinstance(shuffle, LongShift):
                write_long_shift(paths, begin, shuffle.duration, *shuffle, side)
            else:
                write_shift(paths, begin, shuffle.duration, shuffle.distance, side, shuffle.stride)
            record(shuffle.duration)
        begin += shuffle.duration
    paths[begin:] = balanced.last[::-1]
    return paths
