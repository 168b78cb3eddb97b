"""Static obstacles: boxes and columns in metres, the same in every episode.

Every task takes `obstacles=(...)`. Touching one ends the episode; starts, goals and references are
drawn free of them. The air does not know them: they make no ground effect and block no downwash.
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
        """Refuse boxes without volume."""
        low, high = check_array("Box.low", self.low, (3,)), check_array("Box.high", self.high, (3,))
        if not (low < high).all():
            raise ValueError(
                f"Box.low is {self.low} and Box.high {self.high}, but each coordinate must grow"
            )

    @property
    def row(self) -> tuple[float, ...]:
        """Its row (7,) for the compiled contact test."""
        return (BOX, *map(float, self.low), *map(float, self.high))


@dataclass(frozen=True)
class Column:
    """An upright cylinder that stands on the floor. Raises ValueError for impossible sizes."""

    center: tuple[float, float]
    """Where it stands (x, y), m."""
    radius: float
    """Its radius, m."""
    height: float = 10.0
    """Its height, m; by default higher than any arena."""

    def __post_init__(self) -> None:
        """Refuse a place that is none."""
        for name in ("radius", "height"):
            check_number(name, getattr(self, name), above=0.0, unit="m")
        check_array("Column.center", self.center, (2,))

    @property
    def row(self) -> tuple[float, ...]:
        """Its row (7,) for the compiled contact test."""
        x, y = self.center
        return (COLUMN, float(x), float(y), float(self.radius), 0.0, float(self.height), 0.0)


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
    """Square towers on a grid, as in Fig. 1 of the RTH3D paper.

    There they are in the cells (3 i + 1, 3 j + 1) of the grid, so that a third of each side is
    built up: `width` is a third of `spacing` by default.

    Args:
        columns: towers along x.
        rows: towers along y.
        spacing: distance between neighbouring centres, m.
        width: of a tower, m.
        height: of a tower, m; by default higher than any arena, so that none is flown over.
        center: of the grid (x, y), m.

    Raises:
        ValueError: a number or size is not positive, or towers would touch.
    """
    counts = check_integer("columns", columns, 1), check_integer("rows", rows, 1)
    if not 0.0 < width < spacing < np.inf:
        raise ValueError(
            f"width is {width} and spacing {spacing}, but they must satisfy 0 < width < spacing"
        )
    places = [
        [c + spacing * (k - (n - 1) / 2) for k in range(n)]
        for c, n in zip(center, counts, strict=True)
    ]
    half = width / 2
    return tuple(
        Box((x - half, y - half, 0.0), (x + half, y + half, height))
        for x in places[0]
        for y in places[1]
    )


def parse_obstacles(text: str) -> tuple[Obstacle, ...]:
    """Obstacles of a text such as `buildings=2:2,column=1:1:0.15,box=0:0:0:1:1:2`.

    `buildings` takes columns and rows, `column` x, y and radius, `box` both corners, m.

    Raises:
        ValueError: it names something else, or numbers that no obstacle has.
    """
    found: list[Obstacle] = []
    for name, numbers in parse_pairs("obstacles", text, "buildings=2:2,column=1:1:0.15"):
        wanted = _NUMBERS[check_name("obstacle", name, _NUMBERS)]
        if len(numbers) != len(wanted):
            raise ValueError(
                f"obstacle {name} has {len(numbers)} numbers, but must have {len(wanted)}: "
                f"{name}={':'.join(wanted)}"
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
    """Rows (M, 7) of obstacles for the compiled contact test.

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
    """Distance (..., M), m, from points (..., 3) to obstacles (M, 7); zero inside."""
    flat = np.ascontiguousarray(points, dtype=np.float64).reshape(-1, 3)
    out = np.empty((len(flat), len(rows)))
    distances(rows, flat, out)
    return out.reshape(*np.shape(points)[:-1], len(rows))
