"""RTH3D: balance, match, shuffle, for robots on a grid whose axes are long, short, high (Sec. III).

All phases of Algorithms 1-3: balancing; heights; rows; the long axis; rows; heights; balancing
backwards. What moves between the balanced configurations are *items*, one in every slot: robots,
and where there are fewer than slots, virtual robots, which nothing is written of.

The paper's grid is m1 >= m2 >= m3, each a multiple of 3. Here any axis may be the long, the short
or the high one. The plane of the first two is cut into cells of 3 x 3 vertices; what is left over
at the far edge of a side that is no multiple of 3 holds robots only before and after the shuffles.
A *slot* is a vertex in the middle column (x = 3i + 1) of a cell, three to a cell and plane: robots
between shuffles are on slots, so that each has free lanes on both sides. With an obstacle
in the middle of a cell, the whole row y = 3j + 1 has no slots.

Where goals are the starts reflected (rings and mirrors, Sec. V-C), both sides are balanced alike,
each the other's image: columns then belong into columns as a whole, and two shuffles vanish.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import product
from typing import Any

import numpy as np
import numpy.typing as npt

from swarm_envs.baselines.rth3d.compaction import Paths
from swarm_envs.baselines.rth3d.grid import (
    GridInstance,
    NoHighways,
    Shape,
    Vertices,
    check_obstacles,
    check_pattern,
    check_shape,
    numbers,
)
from swarm_envs.baselines.rth3d.grid_plan import PlanningClock
from swarm_envs.baselines.rth3d.matching import Items
from swarm_envs.baselines.rth3d.shuffles import (
    STEPS,
    LongShift,
    Shift,
    lane_changes,
    park_in_cells,
    write_long_shift,
    write_shift,
)
from swarm_envs.baselines.rth3d.ways import Ints, neighbor_table
from swarm_envs.state import BoolArray

CELL = 3  # Side of a cell

_UPRIGHT = ((0, 1, 2), (1, 0, 2))
_ALL = (*_UPRIGHT, (0, 2, 1), (2, 0, 1), (1, 2, 0), (2, 1, 0))
Axes = tuple[int, int, int]  # The order of the axes


@dataclass(frozen=True, eq=False)
class Highways:
    """Slots and lanes of a grid whose axes are in the order long, short, high."""

    axes: Axes  # Which axis of the given grid is the long, the short, the high one
    shape: Shape  # The grid in that order
    obstacles: BoolArray  # In that order too

    @property
    def cells(self) -> int:
        """Cells along the long axis."""
        return self.shape[0] // CELL

    @cached_property
    def rows(self) -> npt.NDArray[np.int32]:
        """Along the short axis, the coordinates that have slots."""
        usable = np.arange(self.shape[1] // CELL * CELL, dtype=np.int32)
        blocked = np.asarray(self.obstacles[: self.cells * CELL].any(axis=(0, 2)))
        return usable[~blocked[: len(usable)]]

    @property
    def capacity(self) -> int:
        """Slots: the most robots that the highways carry."""
        return self.cells * len(self.rows) * self.shape[2]

    @property
    def length(self) -> int:
        """m1 + 2 m2 + 2 m3: what the shuffles take, but for a constant (Proposition IV.2)."""
        return self.shape[0] + 2 * self.shape[1] + 2 * self.shape[2]

    @cached_property
    def slots(self) -> npt.NDArray[np.int32]:
        """(cells, rows, heights) the slots' vertices."""
        x = CELL * np.arange(self.cells) + 1
        grid = np.meshgrid(x, self.rows, np.arange(self.shape[2]), indexing="ij")
        return numbers(np.stack(grid, axis=-1), self.shape)


def _highways(shape: Shape, obstacles: BoolArray) -> list[Highways]:
    """Every order of the axes; the high one stays upright where columns stand."""
    orders = _UPRIGHT if obstacles.any() else _ALL
    return [
        Highways(axes, tuple(shape[k] for k in axes), obstacles.transpose(axes))  # type: ignore[arg-type]
        for axes in orders
    ]


def choose_highways(instance: GridInstance) -> Highways:
    """The order of the axes whose shuffles are the shortest, of those that carry all robots.

    Raises:
        NoHighways: none does; the message says how many they would carry.
    """
    check_pattern(instance.obstacles)
    found = _highways(instance.shape, instance.obstacles)
    count, most = len(instance.starts), max(h.capacity for h in found)
    if most == 0:
        raise NoHighways(
            f"the grid of shape {instance.shape} is too thin: highways need two sides of at least "
            "3 vertices, upright ones where there are obstacles; method='auto' needs none"
        )
    able = [highways for highways in found if highways.capacity >= count]
    if not able:
        raise NoHighways(
            f"there are {count} robots, a density of {instance.density:.4f}, but the highways of a "
            f"grid of shape {instance.shape} carry {most} at most (density "
            f"{most / np.prod(instance.shape):.4f}); take fewer, or method='auto'"
        )
    return min(able, key=lambda h: (h.length, -h.capacity, h.shape[2]))


def max_density(shape: Sequence[int], obstacles: npt.ArrayLike | None = None) -> float:
    """Largest density, robots per vertex, that RTH3D supports on a grid.

    1/3 where two sides, upright ones if there are obstacles, are multiples of 3, and 2/9 between
    buildings; less where strips at the edges are too narrow for highways; 0 if it is too thin.

    Raises:
        ValueError: the shape is none, or obstacles break the pattern.
    """
    sides = check_shape(shape)
    walls = check_obstacles(obstacles, sides)
    check_pattern(walls)
    most = max(highways.capacity for highways in _highways(sides, walls))
    return most / float(np.prod(sides))


Image = npt.NDArray[np.int32]  # (V,) the vertex that each vertex is reflected to


def _images(highways: Highways) -> list[Image]:
    """Reflections of the grid that keep its slots and obstacles; the first is the identity."""
    vertex = np.arange(np.prod(highways.shape), dtype=np.int32).reshape(highways.shape)
    found = []
    for flips in product((False, True), repeat=3):
        axes = tuple(axis for axis, flipped in enumerate(flips) if flipped)
        image = np.flip(vertex, axes).reshape(-1)
        kept = np.array_equal(np.flip(highways.obstacles, axes), highways.obstacles)
        if kept and _same(image[highways.slots.ravel()], highways.slots.ravel(), len(image)):
            found.append(image)
    return found


def _same(first: Vertices, second: Vertices, total: int) -> bool:
    return np.array_equal(np.bincount(first, minlength=total), np.bincount(second, minlength=total))


def reflection(highways: Highways, starts: Vertices, goals: Vertices) -> Image | None:
    """The reflection of the grid that makes the set of goals from that of the starts, if any.

    Of several, the one that takes the most robots to their own goals.
    """
    images = [i for i in _images(highways) if _same(i[starts], goals, len(i))]
    return max(images, key=lambda image: int((image[starts] == goals).sum()), default=None)


def reflected(paths: Paths, image: Image, goals: Vertices) -> Paths:
    """Paths (T + 1, n) from the goals that are the image of paths from the starts."""
    holder = np.empty(len(image), dtype=np.int32)
    holder[image[paths[0]]] = np.arange(paths.shape[1], dtype=np.int32)
    return image[paths[:, holder[goals]]]


Matching = Callable[[Ints, npt.NDArray[np.bool_]], Items]
"""Levels (G, K, D) from where items belong, and which of them are robots."""


@dataclass(frozen=True, eq=False)
class _Table:
    """The Rubik table: items, numbered by their first slot, and the slots they belong into."""

    highways: Highways
    goal: Ints  # (items,) the slot that each item belongs into; slot (c, r, z) is (c R + r) Z + z
    real: npt.NDArray[np.bool_]  # (items,) whether the item is a robot

    @property
    def rows(self) -> int:
        return len(self.highways.rows)

    @property
    def heights(self) -> int:
        return self.highways.shape[2]

    @property
    def cells(self) -> int:
        return self.highways.cells


def _fill_up(first: Ints, last: Ints, wish: Ints) -> tuple[Ints, npt.NDArray[np.bool_]]:
    """Goals of all items: of robots as given, of virtual ones the slot (items,) wished if free."""
    goal = np.full(len(wish), -1, dtype=np.int32)
    goal[first] = last
    real = goal >= 0
    taken = np.zeros(len(wish), dtype=np.bool_)
    taken[last] = True
    granted = np.flatnonzero(~real & ~taken[wish])
    goal[granted], taken[wish[granted]] = wish[granted], True
    goal[goal < 0] = np.flatnonzero(~taken)
    return goal, real


def _split_heights(table: _Table, match: Matching) -> Ints:
    """The height at which each item crosses the plane (Algorithm 2)."""
    shape = (1, table.cells * table.rows, table.heights)
    aims = table.goal.reshape(shape) // table.heights
    return match(aims, table.real.reshape(shape)).reshape(-1)


def _split_rows(table: _Table, height: Ints, match: Matching) -> Ints:
    """The row in which each item crosses its plane along the long axis (Algorithm 3)."""
    items = np.arange(len(height))
    shape = (table.heights, table.cells, table.rows)
    cell, row = np.divmod(items // table.heights, table.rows)
    at = np.empty(shape, dtype=np.int32)
    at[height, cell, row] = items
    aims = table.goal[at] // (table.heights * table.rows)
    found = np.empty(len(items), dtype=np.int32)
    found[at] = match(aims, table.real[at])
    return found


def _cross(table: _Table, height: Ints, row: Ints) -> tuple[Ints, LongShift]:
    """Plan the long shuffle; return the items' rows after it, and the shift."""
    highways, items = table.highways, np.arange(len(height))
    source = (items // (table.heights * table.rows)).astype(np.int32)
    goal = (table.goal // (table.heights * table.rows)).astype(np.int32)
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
    """The long shuffle in numbers of vertices."""
    along, across = highways.shape[1] * highways.shape[2], highways.shape[2]
    rests, place = spot < 0, place.astype(np.int32)
    change = (place[..., 0] - 1) * along + (place[..., 1] - y[:, None]) * across
    change[rests] = 0
    run = np.where(goal == source, 0, CELL * (goal - source) + spot - place[:, -1, 0])
    park = np.sign(run) * across
    aside = np.where(rests, 0, spot - 1)
    leave = np.stack([aside * across, -aside * along], axis=1)
    return LongShift(*(a.astype(np.int32) for a in (change, run, park, leave)))


@dataclass(frozen=True, eq=False)
class _Balanced:
    """Paths into the slots, from the starts and from the goals."""

    first: Paths  # (T1 + 1, n) from the starts
    last: Paths  # (T2 + 1, n) from the goals
    # (V,) the reflection that makes `last` from `first`; the identity if there is none
    image: Image


def balance_both(
    highways: Highways,
    starts: Vertices,
    goals: Vertices,
    balance: Callable[..., Paths],
    clock: PlanningClock,
) -> _Balanced:
    """Balance the starts and the goals (Algorithm 1, line 2), alike where they are reflections."""
    table = neighbor_table(highways.shape, highways.obstacles)
    sinks = np.zeros(len(table), dtype=np.bool_)
    sinks[highways.slots] = True
    with clock.phase("balance starts") as record:
        first = balance(table, starts, sinks, lambda: clock.check("balance starts"))
        record(len(first) - 1)
    with clock.phase("balance goals") as record:
        image = reflection(highways, starts, goals)
        if image is None:
            last = balance(table, goals, sinks, lambda: clock.check("balance goals"))
        else:
            last = reflected(first, image, goals)
        record(len(last) - 1)
    return _Balanced(first, last, np.arange(len(table), dtype=np.int32) if image is None else image)


def shuffle(
    highways: Highways, balanced: _Balanced, match: Matching, clock: PlanningClock
) -> Paths:
    """The whole plan (T + 1, n) before compaction, phase after phase.

    `match` puts items into levels, as `assign_levels` does.
    """
    slot = np.full(int(np.prod(highways.shape)), -1, dtype=np.int32)
    slot[highways.slots.reshape(-1)] = np.arange(highways.capacity, dtype=np.int32)
    first, last = slot[balanced.first[-1]], slot[balanced.last[-1]]
    wish = slot[balanced.image[highways.slots.reshape(-1)]]
    table = _Table(highways, *_fill_up(first, last, wish))
    with clock.phase("match heights") as record:
        height = _split_heights(table, match)
        record(0)
    with clock.phase("match rows") as record:
        row = _split_rows(table, height, match)
        record(0)
    with clock.phase("change of lanes") as record:
        after, long = _cross(table, height, row)
        record(0)
    shifts = _shifts(table, height, row, after, long, first)
    return _write(highways, balanced, shifts, clock)


def _shifts(
    table: _Table, height: Ints, row: Ints, after: Ints, long: LongShift, robots: Ints
) -> dict[str, Shift | LongShift]:
    """The five shuffles of the robots alone, by name and in order."""
    y = table.highways.rows
    present = np.arange(len(height), dtype=np.int32)
    old_row, goal_row = (k // table.heights % table.rows for k in (present, table.goal))
    across, up = table.highways.shape[2], 1
    return {
        "heights": Shift((height - present % table.heights)[robots], up),
        "rows": Shift((y[row] - y[old_row])[robots], across),
        "long axis": LongShift(*(part[robots] for part in long)),
        "rows to goals": Shift((y[goal_row] - y[after])[robots], across),
        "heights to goals": Shift((table.goal % table.heights - height)[robots], up),
    }


def _write(
    highways: Highways,
    balanced: _Balanced,
    shifts: dict[str, Shift | LongShift],
    clock: PlanningClock,
) -> Paths:
    side = highways.shape[1] * highways.shape[2]
    lengths = [len(balanced.first) - 1, *(shift.duration for shift in shifts.values())]
    whole = sum(lengths) + len(balanced.last) - 1
    paths = np.empty((whole + 1, balanced.first.shape[1]), dtype=np.int32)
    paths[: lengths[0] + 1] = balanced.first
    begin = lengths[0]
    for name, shift in shifts.items():
        with clock.phase(name) as record:
            if isinstance(shift, LongShift):
                write_long_shift(paths, begin, shift.duration, *shift, side)
            else:
                write_shift(paths, begin, shift.duration, shift.distance, side, shift.stride)
            record(shift.duration)
        begin += shift.duration
    paths[begin:] = balanced.last[::-1]
    return paths
