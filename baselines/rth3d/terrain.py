"""The grid of PIBT's kernels: its vertices, obstacles, and lengths of paths to the goals."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from swarm_envs.baselines.rth3d.grid import (
    Array,
    GridInstance,
    breaks_pattern,
    numbers,
)
from swarm_envs.baselines.rth3d.path_lengths import (
    STAY,
    Ints,
    Neighbors,
    neighbor_table,
    path_lengths_to,
)
from swarm_envs.compiled import equation
from swarm_envs.state import BoolArray

_MOST_LENGTHS = 250_000_000  # The most lengths that are stored, four bytes each

# One array for all, because reference counting of a kernel's arrays at each call took three
# quarters of PIBT's time.
_CELL = np.dtype(
    [
        *((name, np.int32) for name in ("x", "y", "z")),
        ("now", np.int32),  # The robot there, or -1
        ("taken", np.int32),  # The robot that has taken it for the next step, -1, or `WALL`
        ("column", np.int32),  # Its column of `Terrain.lengths`, or -1
        ("along_x", np.int32),  # Number of obstacles at smaller or equal x in the same row
        ("along_y", np.int32),  # Number of obstacles at smaller or equal y in the same column
    ]
)
WALL = np.iinfo(np.int32).max
"""The value of `taken` at obstacles."""
OPEN, PATTERN, ANY = range(3)  # Obstacles: none, columns that follow the pattern, others


class Grid(NamedTuple):
    """The shape of the grid, for distances and neighbors."""

    obstacles: int  # `OPEN`, `PATTERN` or `ANY`
    m1: int
    m2: int
    m3: int


class Terrain(NamedTuple):
    """The grid, and the lengths of paths to the goals."""

    cells: Array  # (V,) the vertices, of `_CELL`
    # (n, F) length of the shortest path from free vertices to each robot's goal; (0, 0) if a
    # formula gives it
    lengths: Ints
    table: Neighbors  # (V, 7) neighbors, or (0, 7) if all vertices have at least three
    grid: Grid


def survey(instance: GridInstance) -> Terrain:
    """Return the terrain of an instance, without robots.

    Raises:
        NoPlanExists: Obstacles cut a robot off from its goal.
        ValueError: The lengths of paths would not fit into memory.
    """
    walls, shape = instance.obstacles, instance.shape
    columns = np.asarray(walls.any(axis=2), dtype=np.int32)[:, :, None]
    table = neighbor_table(shape, walls)
    narrow = bool(((table[:, :6] >= 0).sum(axis=1)[table[:, STAY] >= 0] < 3).any())
    cells = np.empty(shape, dtype=_CELL)
    cells["x"], cells["y"], cells["z"] = np.indices(shape, dtype=np.int32, sparse=True)
    cells["now"], cells["taken"] = -1, np.where(walls, WALL, -1)
    cells["column"] = -1
    cells["column"][~walls] = np.arange(np.count_nonzero(~walls))
    for axis, name in enumerate(("along_x", "along_y")):
        cells[name] = np.cumsum(columns, axis=axis, dtype=np.int32)
    grid = Grid(_kind(walls), *shape)
    lengths = np.zeros((0, 0), dtype=np.int32)
    if grid.obstacles == ANY:
        _check_memory(instance)
        goals = cells["column"].ravel()[numbers(instance.goals, shape)]
        lengths = path_lengths_to(_among_free(table), goals)
    return Terrain(cells.ravel(), lengths, table if narrow else table[:0], grid)


def _kind(obstacles: BoolArray) -> int:
    if breaks_pattern(obstacles):
        return ANY
    return PATTERN if obstacles.any() else OPEN


def _check_memory(instance: GridInstance) -> None:
    count, free = len(instance.goals), np.count_nonzero(~instance.obstacles)
    if count * free > _MOST_LENGTHS:
        raise ValueError(
            f"obstacles off the pattern need the paths of {count} robots on {free} vertices, but "
            f"at most {_MOST_LENGTHS} lengths are stored; use fewer robots or a smaller grid"
        )


def _among_free(table: Neighbors) -> Neighbors:
    """Return the neighbors (F, 7) of each free vertex, numbered among the free ones."""
    free = table[:, STAY] >= 0
    index = np.append(np.cumsum(free, dtype=np.int32) - 1, np.int32(-1))  # -1 for no neighbor
    return index[table[free]]


@equation
def neighbor(grid: Grid, cell: Array, here: int, k: int) -> int:
    """Return neighbor k of a vertex, itself for k = 6; -1 if it would be outside."""
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
