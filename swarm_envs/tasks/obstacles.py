"""Static obstacles, boxes and columns, which are the same in every episode.

Every task takes `obstacles=(...)`. A contact counts as a crash; starts, goals and references are
free of obstacles. Obstacles have no aerodynamic effect: they cause no ground effect and block no
downwash.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from swarm_envs.errors import (
    check_array,
    check_integer,
    check_name,
    check_number,
    check_type,
    parse_pairs,
)
from swarm_envs.physics.contact import BOX, COLUMN, ROW, distances, no_obstacles
from swarm_envs.state import FloatArray

__all__ = [
    "Box",
    "Column",
    "Obstacle",
    "buildings",
    "check_inside",
    "obstacle_distances",
    "obstacle_rows",
    "parse_obstacles",
]

Point = tuple[float, float, float]  # x, y, z, m


@dataclass(frozen=True)
class Box:
    """A box with edges along x, y and z. Raises ValueError if it has no volume."""

    low: Point
    """Lower corner (x, y, z), m."""
    high: Point
    """Upper corner (x, y, z), m."""

    def __post_init__(self) -> None:
        """Raise ValueError for a box without volume."""
        low, high = check_array("Box.low", self.low, (3,)), check_array("Box.high", self.high, (3,))
        if not (low < high).all():
            raise ValueError(
                f"Box.low is {self.low} and Box.high is {self.high}, but each coordinate of low "
                "must be smaller than that of high; exchange them, or enlarge the box"
            )

    @property
    def row(self) -> tuple[float, ...]:
        """The row (7,) for the contact kernels."""
        return (BOX, *map(float, self.low), *map(float, self.high))

    @property
    def corners(self) -> tuple[Point, Point]:
        """The lower and upper corner (x, y, z), m."""
        return self.low, self.high


@dataclass(frozen=True)
class Column:
    """A vertical cylinder on the floor. Raises ValueError for invalid sizes."""

    center: tuple[float, float]
    """Position of the axis (x, y), m."""
    radius: float
    """Radius, m."""
    height: float = 10.0
    """Height, m; by default higher than any arena."""

    def __post_init__(self) -> None:
        """Raise ValueError for invalid values."""
        for name in ("radius", "height"):
            check_number(name, getattr(self, name), above=0.0, unit="m")
        check_array("Column.center", self.center, (2,))

    @property
    def row(self) -> tuple[float, ...]:
        """The row (7,) for the contact kernels."""
        x, y = self.center
        return (COLUMN, float(x), float(y), float(self.radius), 0.0, float(self.height), 0.0)

    @property
    def corners(self) -> tuple[Point, Point]:
        """The lower and upper corner (x, y, z) of the smallest box around it, m."""
        (x, y), r = self.center, self.radius
        return (x - r, y - r, 0.0), (x + r, y + r, self.height)


Obstacle = Box | Column
"""A static obstacle."""


def buildings(
    columns: int = 2,
    rows: int = 2,
    *,
    spacing: float = 1.2,
    width: float = 0.4,
    height: float = 10.0,
    center: tuple[float, float] = (0.0, 0.0),
) -> tuple[Box, ...]:
    """Return square towers on a grid, as in Fig. 1 of the RTH3D paper.

    By default, the width is a third of the spacing, as there: towers occupy the cells
    (3 i + 1, 3 j + 1) of a grid.

    Args:
        columns: number of towers along x.
        rows: number of towers along y.
        spacing: distance between the centers of adjacent towers, m.
        width: width of a tower, m.
        height: height of a tower, m; by default higher than any arena.
        center: center of the grid (x, y), m.

    Raises:
        ValueError: a number or size is not positive, or towers would touch.
    """
    counts = check_integer("columns", columns, 1), check_integer("rows", rows, 1)
    if not 0.0 < width < spacing < np.inf:
        raise ValueError(
            f"width is {width} and spacing is {spacing}, but must satisfy 0 < width < spacing; "
            "change one of them"
        )
    x_centers, y_centers = (
        [c + spacing * (k - (n - 1) / 2) for k in range(n)]
        for c, n in zip(center, counts, strict=True)
    )
    half = width / 2
    return tuple(
        Box((x - half, y - half, 0.0), (x + half, y + half, height))
        for x in x_centers
        for y in y_centers
    )


def check_inside(obstacles: Sequence[Obstacle], arena: FloatArray) -> None:
    """Raise ValueError if no obstacle lies inside the arena with the corners (2, 3), m.

    Some may lie outside, such as those of a city for teams of several sizes.
    """
    obstacle_rows(obstacles)  # raises for other objects
    boxes = (np.array(obstacle.corners) for obstacle in obstacles)
    inside = [(high > arena[0]).all() and (low < arena[1]).all() for low, high in boxes]
    if obstacles and not any(inside):
        lowest, highest = (tuple(corner) for corner in arena.tolist())
        raise ValueError(
            f"no obstacle lies inside the arena, which is from {lowest} to {highest} m, but "
            f"outside, such as {obstacles[0]}; move one, or leave them out"
        )


def parse_obstacles(text: str) -> tuple[Obstacle, ...]:
    """Return the obstacles of a string such as `buildings=2:2,column=1:1:0.15,box=0:0:0:1:1:2`.

    `buildings` takes columns and rows, `column` x, y and radius, `box` two corners, m.

    Raises:
        ValueError: it has another name, or invalid numbers.
    """
    found: list[Obstacle] = []
    for name, numbers in parse_pairs("obstacles", text, "buildings=2:2,column=1:1:0.15"):
        form = _NUMBERS[check_name("obstacle", name, _NUMBERS)]
        if len(numbers) != len(form):
            raise ValueError(
                f"obstacle {name} has {len(numbers)} numbers, but must have {len(form)}: "
                f"{name}={':'.join(form)}"
            )
        if name == "buildings":
            if not all(number.is_integer() for number in numbers):
                raise ValueError(f"buildings has {numbers}, but must have two integers")
            found += buildings(int(numbers[0]), int(numbers[1]))
        elif name == "column":
            found.append(Column((numbers[0], numbers[1]), numbers[2]))
        else:
            x, y, z, *high = numbers
            found.append(Box((x, y, z), (high[0], high[1], high[2])))
    return tuple(found)


_NUMBERS = {
    "buildings": ("COLUMNS", "ROWS"),
    "column": ("X", "Y", "RADIUS"),
    "box": ("X", "Y", "Z", "X2", "Y2", "Z2"),
}


def obstacle_rows(obstacles: Sequence[Obstacle]) -> FloatArray:
    """Return the rows (M, 7) of obstacles for the contact kernels.

    Raises:
        TypeError: one is neither a `Box` nor a `Column`.
    """
    check_type("obstacles", obstacles, Sequence)
    for obstacle in obstacles:
        if not isinstance(obstacle, Box | Column):
            raise TypeError(
                f"obstacles hold {obstacle!r:.80}, but must be Box or Column, such as "
                "Column(center=(0.0, 0.0), radius=0.2)"
            )
    rows = [obstacle.row for obstacle in obstacles]
    return np.array(rows, dtype=np.float64).reshape(-1, ROW) if rows else no_obstacles()


def obstacle_distances(rows: FloatArray, points: FloatArray) -> FloatArray:
    """Return distances (..., M), m, from points (..., 3) to obstacles (M, 7); 0 inside."""
    flat = np.ascontiguousarray(points, dtype=np.float64).reshape(-1, 3)
    out = np.empty((len(flat), len(rows)))
    distances(rows, flat, out)
    return out.reshape(*np.shape(points)[:-1], len(rows))
