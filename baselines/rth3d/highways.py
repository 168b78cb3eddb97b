"""Highways: the slots of a grid and the lanes beside them (Sec. III-B).

The paper's grid is m1 >= m2 >= m3, each a multiple of 3. Here any axis may be the long, the short
or the high one. The plane of the first two is divided into cells of 3 x 3 vertices; the rest at the
far edge of a side that is no multiple of 3 has robots only before and after the shuffles. A *slot*
is a vertex in the middle column (x = 3i + 1) of a cell, three per cell and plane. Between shuffles
robots are on slots, so that each has free lanes on both sides. If an obstacle is in the middle of a
cell, the whole row y = 3j + 1 has no slots.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import product

import numpy as np
import numpy.typing as npt

from swarm_envs.baselines.rth3d.compaction import Paths
from swarm_envs.baselines.rth3d.grid import (
    Coordinates,
    GridInstance,
    NoHighways,
    Shape,
    Vertices,
    check_obstacles,
    check_pattern,
    check_shape,
    numbers,
    points,
)
from swarm_envs.state import BoolArray

CELL = 3  # The side of a cell

_UPRIGHT = ((0, 1, 2), (1, 0, 2))
_ALL = (*_UPRIGHT, (0, 2, 1), (2, 0, 1), (1, 2, 0), (2, 1, 0))
Axes = tuple[int, int, int]  # The order of the axes


@dataclass(frozen=True, eq=False)
class Highways:
    """The slots and lanes of a grid whose axes are in the order long, short, high."""

    axes: Axes  # The axes of the given grid in that order
    shape: Shape  # The shape of the grid in that order
    obstacles: BoolArray  # The obstacles in that order

    @property
    def cells(self) -> int:
        """The number of cells along the long axis."""
        return self.shape[0] // CELL

    @cached_property
    def rows(self) -> npt.NDArray[np.int32]:
        """The coordinates along the short axis that have slots."""
        usable = np.arange(self.shape[1] // CELL * CELL, dtype=np.int32)
        blocked = np.asarray(self.obstacles[: self.cells * CELL].any(axis=(0, 2)))
        return usable[~blocked[: len(usable)]]

    @property
    def capacity(self) -> int:
        """The number of slots, the most robots that the highways carry."""
        return self.cells * len(self.rows) * self.shape[2]

    @property
    def length(self) -> int:
        """The steps m1 + 2 m2 + 2 m3 of the shuffles, up to a constant (Proposition IV.2)."""
        return self.shape[0] + 2 * self.shape[1] + 2 * self.shape[2]

    @cached_property
    def slots(self) -> npt.NDArray[np.int32]:
        """The vertices of the slots (cells, rows, heights)."""
        x = CELL * np.arange(self.cells) + 1
        grid = np.meshgrid(x, self.rows, np.arange(self.shape[2]), indexing="ij")
        return numbers(np.stack(grid, axis=-1), self.shape)

    def vertices(self, places: Coordinates) -> Vertices:
        """Return the vertices (n,) of coordinates (n, 3) on the given grid."""
        return numbers(places[:, list(self.axes)], self.shape)

    def renumber(self, paths: Paths) -> Paths:
        """Return paths (T + 1, n) with the vertices numbered as on the given grid, in place."""
        every = points(np.arange(np.prod(self.shape), dtype=np.int32), self.shape)
        back = list(np.argsort(self.axes))
        m1, m2, m3 = (self.shape[k] for k in back)
        given = numbers(every[:, back], (m1, m2, m3))
        for row in paths:
            row[:] = given[row]
        return paths


def _highways(shape: Shape, obstacles: BoolArray) -> list[Highways]:
    """Return highways for every order of the axes; with columns, the high axis is z."""
    orders = _UPRIGHT if obstacles.any() else _ALL
    return [
        Highways(axes, tuple(shape[k] for k in axes), obstacles.transpose(axes))  # type: ignore[arg-type]
        for axes in orders
    ]


def choose_highways(instance: GridInstance) -> Highways:
    """Return the highways with the shortest shuffles of those that carry all robots.

    Raises:
        NoHighways: None can carry them.
    """
    check_pattern(instance.obstacles)
    found = _highways(instance.shape, instance.obstacles)
    count, most = len(instance.starts), max(h.capacity for h in found)
    if most == 0:
        raise NoHighways(
            f"the grid of shape {instance.shape} is too thin: highways need two sides of at least "
            "3 vertices, along x and y if there are obstacles; use method='auto'"
        )
    able = [highways for highways in found if highways.capacity >= count]
    if not able:
        raise NoHighways(
            f"there are {count} robots, a density of {instance.density:.4f}, but the highways of a "
            f"grid of shape {instance.shape} carry {most} at most (density "
            f"{most / np.prod(instance.shape):.4f}); use fewer, or method='auto'"
        )
    return min(able, key=lambda h: (h.length, -h.capacity, h.shape[2]))


def max_density(shape: Sequence[int], obstacles: npt.ArrayLike | None = None) -> float:
    """Return the largest density, robots per vertex, that RTH3D supports on a grid.

    It is 1/3 if two sides (with obstacles, those along x and y) are multiples of 3, 2/9 between
    buildings, less if strips at the edges are too narrow for highways, and 0 if the grid is too
    thin.

    Raises:
        ValueError: The shape is invalid, or obstacles break the pattern.
    """
    sides = check_shape(shape)
    walls = check_obstacles(obstacles, sides)
    check_pattern(walls)
    most = max(highways.capacity for highways in _highways(sides, walls))
    return most / float(np.prod(sides))


def _images(highways: Highways) -> list[Vertices]:
    """Return images (V,) of the vertices under reflections that keep slots and obstacles.

    The first is the identity.
    """
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


def reflection(highways: Highways, starts: Vertices, goals: Vertices) -> Vertices | None:
    """Return the reflection of the set of starts onto that of the goals, or None.

    Of several it is the one that maps the most starts to the robots' own goals.
    """
    images = [i for i in _images(highways) if _same(i[starts], goals, len(i))]
    return max(images, key=lambda image: int((image[starts] == goals).sum()), default=None)


def reflected(paths: Paths, image: Vertices, goals: Vertices) -> Paths:
    """Return paths (T + 1, n) from the goals, the images of paths from the starts."""
    holder = np.empty(len(image), dtype=np.int32)
    holder[image[paths[0]]] = np.arange(paths.shape[1], dtype=np.int32)
    return image[paths[:, holder[goals]]]
