"""The grid as PIBT's kernels see it: its vertices, obstacles, and ways to the goals."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from swarm_envs.baselines.rth3d.grid import (
    Array,
    Coordinates,
    GridInstance,
    breaks_pattern,
    numbers,
)
from swarm_envs.baselines.rth3d.ways import STAY, Neighbors, neighbor_table, ways_to
from swarm_envs.compiled import equation

_Ints = npt.NDArray[np.int32]
_MOST_WAYS = 250_000_000  # lengths that are kept at most, four bytes each

# What belongs together lies together, in one array. An array more that a kernel is given is counted
# twice at each of its calls, which took three quarters of PIBT's time.
_CELL = np.dtype(
    [
        *((name, np.int32) for name in ("x", "y", "z")),
        ("now", np.int32),  # who is there, or -1
        ("taken", np.int32),  # who has taken it for the next step, -1, or `WALL`
        ("column", np.int32),  # its column of `ways`
        ("along_x", np.int32),  # obstacles at smaller or equal x in the same row
        ("along_y", np.int32),  # obstacles at smaller or equal y in the same column
    ]
)
WALL = np.iinfo(np.int32).max
"""Who has taken an obstacle's vertex, for all time."""
OPEN, PATTERN, ANY = range(3)  # obstacles: none, columns that follow the pattern, others


class Grid(NamedTuple):
    """What the shape says of distances, and of who is next to whom."""

    obstacles: int  # `OPEN`, `PATTERN` or `ANY`
    m1: int
    m2: int
    m3: int


class Terrain(NamedTuple):
    """The grid, and how far it is to the goals."""

    cells: Array  # (V,) of `_CELL`: each vertex
    # (n, F) length of the shortest way from free vertices to each robot's goal; (0, 0) where a
    # formula says it
    ways: _Ints
    table: Neighbors  # (V, 7) neighbours, or (0, 7) where all vertices have three and more
    grid: Grid


def survey(instance: GridInstance) -> Terrain:
    """The terrain of an instance, no robot on it.

    Raises:
        NoPlanExists: obstacles cut a robot off from its goal.
        ValueError: the lengths of ways would not fit into memory.
    """
    walls, shape = instance.obstacles, instance.shape
    columns = np.asarray(walls.any(axis=2), dtype=np.int32)[:, :, None]
    table = neighbor_table(shape, walls)
    narrow = bool(((table[:, :6] >= 0).sum(axis=1)[table[:, STAY] >= 0] < 3).any())
    cells = np.empty(shape, dtype=_CELL)
    cells["x"], cells["y"], cells["z"] = np.indices(shape, dtype=np.int32, sparse=True)
    cells["now"], cells["taken"] = -1, np.where(walls, WALL, -1)
    ways, column = _ways_to_goals(instance, table)
    cells["column"] = column.reshape(shape) if len(ways) else -1
    for axis, name in enumerate(("along_x", "along_y")):
        cells[name] = np.cumsum(columns, axis=axis, dtype=np.int32)
    obstacles = ANY if len(ways) else PATTERN if walls.any() else OPEN
    grid = Grid(obstacles, *shape)
    return Terrain(cells.ravel(), ways, table if narrow else table[:0], grid)


def _ways_to_goals(instance: GridInstance, table: Neighbors) -> tuple[_Ints, _Ints]:
    """(n, F) length of the shortest way from each free vertex to each goal, and (V,) its column.

    None, (0, 0) and (0,), where obstacles follow the pattern.
    """
    if not breaks_pattern(instance.obstacles):
        return np.zeros((0, 0), dtype=np.int32), np.zeros(0, dtype=np.int32)
    free = np.flatnonzero(table[:, STAY] >= 0)
    count = len(instance.goals)
    if count * len(free) > _MOST_WAYS:
        raise ValueError(
            f"obstacles off the pattern need the ways of {count} robots on {len(free)} vertices, "
            f"but at most {_MOST_WAYS} numbers are kept; take fewer robots or a smaller grid"
        )
    column = np.full(len(table), -1, dtype=np.int32)
    column[free] = np.arange(len(free))
    return free_ways(instance, instance.goals), column


def free_ways(instance: GridInstance, goals: Coordinates) -> _Ints:
    """(n, F) length of the shortest way from each free vertex to each of goals (n, 3)."""
    table = neighbor_table(instance.shape, instance.obstacles)
    free = np.flatnonzero(table[:, STAY] >= 0)
    column = np.full(len(table) + 1, -1, dtype=np.int32)  # -1 stands for no neighbour
    column[free] = np.arange(len(free))
    return ways_to(column[table[free]], column[numbers(goals, instance.shape)])


@equation
def neighbor(grid: Grid, cell: Array, here: int, k: int) -> int:
    """Neighbour k of a vertex, which is its seventh itself; -1 if it would be outside."""
    step, axis = 2 * (k & 1) - 1, k >> 1
    if axis == 0:
        side, at, to = grid.m1, cell["x"] + step, here + step * grid.m2 * grid.m3
    elif axis == 1:
        side, at, to = grid.m2, cell["y"] + step, here + step * grid.m3
    elif axis == 2:
        side, at, to = grid.m3, cell["z"] + step, here + step
    else:
        return here
    return to if 0 <= at < side else -1
