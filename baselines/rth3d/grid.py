"""A labelled instance on a 6-connected grid: what is given, what is refused, what binds.

A vertex (x, y, z) of a grid of shape (m1, m2, m3) has the number (x m2 + y) m3 + z.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from swarm_envs.arguments import typed
from swarm_envs.state import BoolArray

Array = npt.NDArray[Any]
"""Of a kernel's arguments, which are typed when it is compiled."""
Coordinates = npt.NDArray[np.int32]
"""(n, 3) vertices as coordinates (x, y, z)."""
Vertices = npt.NDArray[np.int32]
"""(n,) vertices as numbers."""
Shape = tuple[int, int, int]
"""(m1, m2, m3): vertices along x, y, z."""

_LONGEST_SIDE = 32767  # paths are int16
_MOST_VERTICES = 2**28  # a flow over several steps numbers them in int32


@typed
@dataclass(frozen=True, eq=False)
class GridInstance:
    """Who starts where and must get where, on which grid. Made by `check_instance`."""

    shape: Shape
    """Vertices by axis."""
    starts: Coordinates
    """(n, 3), all different."""
    goals: Coordinates
    """(n, 3), all different; robot i must get from `starts[i]` to `goals[i]`."""
    obstacles: BoolArray
    """(m1, m2, m3), True where nobody may be."""

    @property
    def lower_bound(self) -> int:
        """Largest Manhattan distance of a robot to its goal: no plan's makespan is below."""
        return int(np.abs(self.starts - self.goals).sum(axis=1).max())

    @property
    def density(self) -> float:
        """Robots per vertex, those of obstacles included, as the paper counts."""
        return len(self.starts) / float(np.prod(self.shape))


def numbers(points: npt.NDArray[np.integer], shape: Shape) -> Vertices:
    """Numbers of vertices that are given as coordinates (..., 3)."""
    wide = points.astype(np.int64)
    found = (wide[..., 0] * shape[1] + wide[..., 1]) * shape[2] + wide[..., 2]
    return found.astype(np.int32)


def points(vertices: npt.NDArray[np.integer], shape: Shape) -> Coordinates:
    """Coordinates (..., 3) of vertices that are given by their numbers."""
    return np.stack(np.unravel_index(vertices, shape), axis=-1).astype(np.int32)


def check_shape(shape: Sequence[int]) -> Shape:
    """The shape as three integers; a grid of two sides is one vertex high.

    Raises:
        ValueError: not two or three integers of at least 1, or too many vertices to number.
    """
    sides = tuple(shape)
    valid = all(isinstance(m, int | np.integer) and not isinstance(m, bool) for m in sides)
    if len(sides) not in (2, 3) or not valid or min(sides) < 1:
        raise ValueError(f"shape is {shape!r}, but must be two or three integers of at least 1")
    found = tuple(int(m) for m in (*sides, 1)[:3])
    if max(found) > _LONGEST_SIDE or int(np.prod(found, dtype=np.int64)) > _MOST_VERTICES:
        raise ValueError(
            f"shape is {shape!r}, but a side may have {_LONGEST_SIDE} vertices at most, "
            f"and the grid {_MOST_VERTICES}"
        )
    return found[0], found[1], found[2]


def check_obstacles(obstacles: npt.ArrayLike | None, shape: Shape) -> BoolArray:
    """The obstacles as booleans of the grid's shape.

    Raises:
        ValueError: another shape, or not booleans.
    """
    if obstacles is None:
        return np.zeros(shape, dtype=np.bool_)
    found = np.asarray(obstacles)
    if found.dtype != np.bool_:
        raise ValueError(f"obstacles are of type {found.dtype}, but must be booleans")
    if found.ndim == 2 and shape[2] == 1:
        found = found[:, :, None]
    if found.shape != shape:
        raise ValueError(f"obstacles have shape {found.shape}, but the grid's is {shape}")
    return np.ascontiguousarray(found)


def follows_pattern(obstacles: BoolArray) -> bool:
    """Whether obstacles are whole columns at (3i + 1, 3j + 1), or none."""
    columns: BoolArray = np.asarray(obstacles.any(axis=2))
    inside = columns[1::3, 1::3].sum() == columns.sum()
    return bool(inside and (columns == obstacles.all(axis=2)).all())


def check_pattern(obstacles: BoolArray) -> None:
    """Refuse obstacles other than whole columns at (3i + 1, 3j + 1) (Sec. V-A).

    Raises:
        ValueError: naming the first vertex that breaks the pattern.
    """
    columns: BoolArray = np.asarray(obstacles.any(axis=2))
    outside = columns.copy()
    outside[1::3, 1::3] = False
    if outside.any():
        x, y = (int(k) for k in np.argwhere(outside)[0])
        raise ValueError(
            f"there is an obstacle at x = {x}, y = {y}, but obstacles may only stand at x = 3i + 1,"
            " y = 3j + 1, so that there are lanes beside them; move them there"
        )
    gaps = columns[:, :, None] & ~obstacles
    if gaps.any():
        x, y, z = (int(k) for k in np.argwhere(gaps)[0])
        raise ValueError(
            f"the obstacle at x = {x}, y = {y} leaves z = {z} free, but an obstacle must fill its "
            "column from bottom to top; fill it"
        )


def check_points(
    name: str, given: npt.ArrayLike, shape: Shape, obstacles: BoolArray
) -> Coordinates:
    """Vertices as an (n, 3) array, all different, in the grid and free.

    Raises:
        ValueError: naming the first robot for which it is not so, and why.
    """
    found = np.asarray(given)
    if found.ndim != 2 or found.shape[1] not in (2, 3) or (found.shape[1] == 2 and shape[2] > 1):
        raise ValueError(f"{name} have shape {found.shape}, but must be (n, 3), one row a robot")
    if not np.issubdtype(found.dtype, np.integer):
        raise ValueError(f"{name} are of type {found.dtype}, but must be integers: grid vertices")
    if len(found) == 0:
        raise ValueError(f"{name} are empty, but at least one robot must be planned for")
    if found.shape[1] == 2:
        found = np.column_stack([found, np.zeros(len(found), dtype=found.dtype)])
    outside = ((found < 0) | (found >= np.array(shape))).any(axis=1)
    if outside.any():
        robot = int(np.argmax(outside))
        raise ValueError(
            f"{name}[{robot}] is {_text(found[robot])}, which is outside the grid of shape {shape}"
        )
    inside = found.astype(np.int32)
    _check_free(name, inside, shape, obstacles)
    return inside


def _check_free(name: str, found: Coordinates, shape: Shape, obstacles: BoolArray) -> None:
    vertices = numbers(found, shape)
    blocked = obstacles.reshape(-1)[vertices]
    if blocked.any():
        robot = int(np.argmax(blocked))
        raise ValueError(f"{name}[{robot}] is {_text(found[robot])}, where an obstacle stands")
    order = np.argsort(vertices, kind="stable")
    twins = np.flatnonzero(np.diff(vertices[order]) == 0)
    if twins.size:
        first, second = (int(k) for k in order[twins[0] : twins[0] + 2])
        raise ValueError(
            f"{name}[{first}] and {name}[{second}] are both {_text(found[first])}, but all {name} "
            "must differ"
        )


def _text(point: npt.NDArray[np.integer]) -> str:
    return f"({', '.join(str(int(k)) for k in point)})"


def check_instance(
    starts: npt.ArrayLike,
    goals: npt.ArrayLike,
    shape: Sequence[int],
    obstacles: npt.ArrayLike | None = None,
) -> GridInstance:
    """Check an instance as a user gives it.

    Args:
        starts: (n, 3) integers, all different; (n, 2) on a grid one vertex high.
        goals: as many, all different.
        shape: (m1, m2, m3) or (m1, m2).
        obstacles: booleans of that shape, or None.

    Raises:
        ValueError: what is wrong, at which robot, and the rule.
    """
    sides = check_shape(shape)
    walls = check_obstacles(obstacles, sides)
    first = check_points("starts", starts, sides, walls)
    last = check_points("goals", goals, sides, walls)
    if len(first) != len(last):
        raise ValueError(
            f"there are {len(first)} starts, but {len(last)} goals; give each robot one"
        )
    return GridInstance(sides, first, last, walls)
