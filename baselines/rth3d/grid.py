"""Labeled instances on a 6-connected grid: checks, lower bounds, and families of instances.

A vertex (x, y, z) of a grid of shape (m1, m2, m3) has the number (x m2 + y) m3 + z.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, fields
from functools import cached_property, partial
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from swarm_envs.baselines.rth3d.cuts import cut_bound, passing_bound
from swarm_envs.baselines.rth3d.path_lengths import FAR, neighbor_table, path_lengths_between
from swarm_envs.errors import as_numbers, check_integer, check_name
from swarm_envs.state import BoolArray

__all__ = ["Coordinates", "Shape", "check_shape"]

Array = npt.NDArray[Any]  # An argument of a kernel, typed when it is compiled
Coordinates = npt.NDArray[np.int32]
"""Vertices as coordinates (x, y, z), (n, 3)."""
Vertices = npt.NDArray[np.int32]  # (n,) vertices as numbers
Shape = tuple[int, int, int]
"""The numbers of vertices (m1, m2, m3) along x, y, z."""

_LONGEST_SIDE = 32767  # Paths are int16
_MOST_VERTICES = 2**28  # A flow over several steps numbers them in int32


class PlanNotFound(RuntimeError):
    """A method without guarantee has found no plan."""


class NoHighways(ValueError):
    """The highways of RTH3D do not fit an instance, for which other methods may succeed."""


class NoPlanExists(PlanNotFound, ValueError):
    """It is proven that the instance has no plan."""


@dataclass(frozen=True, eq=False)
class GridInstance:
    """A grid with the starts and goals of its robots, as returned by `check_instance`."""

    shape: Shape
    """The number of vertices by axis."""
    starts: Coordinates
    """The start vertices (n, 3), all different."""
    goals: Coordinates
    """The goal vertices (n, 3), all different; robot i must get from `starts[i]` to `goals[i]`."""
    obstacles: BoolArray
    """True for vertices (m1, m2, m3) with an obstacle."""

    def fields(self) -> dict[str, Any]:
        """Return shape, starts, goals and obstacles by name."""
        return {field.name: getattr(self, field.name) for field in fields(GridInstance)}

    @cached_property
    def lengths(self) -> npt.NDArray[np.int32]:
        """The length (n,) of each robot's shortest path around obstacles.

        Raises:
            NoPlanExists: Obstacles cut a robot off from its goal.
        """
        if not breaks_pattern(self.obstacles):
            return _pattern_lengths(self)
        table = neighbor_table(self.shape, self.obstacles)
        found = path_lengths_between(
            table, *(numbers(p, self.shape) for p in (self.starts, self.goals))
        )
        cut_off = np.flatnonzero(found == FAR)
        if len(cut_off):
            i = int(cut_off[0])
            raise NoPlanExists(
                f"no plan exists: robot {i} cannot get from {_text(self.starts[i])} to "
                f"{_text(self.goals[i])}: obstacles are between; move them, or one of the two"
            )
        return found

    @cached_property
    def lower_bound(self) -> int:
        """A lower bound of the makespan of every plan.

        It is the longest of the robots' shortest paths, or more if many have to cross a plane with
        few openings (`cut_bound`), or to pass each other in a line (`passing_bound`).

        Raises:
            NoPlanExists: Obstacles cut a robot off from its goal.
        """
        longest = int(self.lengths.max())
        detours = breaks_pattern(self.obstacles) != ""
        table = neighbor_table(self.shape, self.obstacles) if detours else None
        passing = passing_bound(self.starts, self.goals)
        return max(cut_bound(self.starts, self.goals, self.obstacles, longest, table), passing)

    @property
    def density(self) -> float:
        """The number of robots per vertex, obstacles included, as in the paper."""
        return len(self.starts) / float(np.prod(self.shape))


def _pattern_lengths(instance: GridInstance) -> npt.NDArray[np.int32]:
    """Return lengths (n,) of shortest paths among columns of the pattern.

    They are Manhattan distances, or two more if an obstacle is between two vertices of the same row
    or column.
    """
    columns = np.asarray(instance.obstacles.any(axis=2), dtype=np.int32)
    found = np.abs(instance.starts - instance.goals).sum(axis=1, dtype=np.int32)
    for axis in (0, 1):
        before = np.cumsum(columns, axis=axis)
        same = instance.starts[:, 1 - axis] == instance.goals[:, 1 - axis]
        first, last = (before[p[:, 0], p[:, 1]] for p in (instance.starts, instance.goals))
        found += np.where(same & (first != last), np.int32(2), np.int32(0))
    return found


def numbers(points: npt.NDArray[np.integer], shape: Shape) -> Vertices:
    """Return the numbers of vertices with coordinates (..., 3)."""
    wide = points.astype(np.int64)
    found = (wide[..., 0] * shape[1] + wide[..., 1]) * shape[2] + wide[..., 2]
    return found.astype(np.int32)


def points(vertices: npt.NDArray[np.integer], shape: Shape) -> Coordinates:
    """Return the coordinates (..., 3) of vertices with the given numbers."""
    return np.stack(np.unravel_index(vertices, shape), axis=-1).astype(np.int32)


def check_shape(shape: Sequence[int]) -> Shape:
    """Return the shape as three integers; a grid of two sides is one vertex high.

    Raises:
        ValueError: It is not two or three integers of at least 1, or has too many vertices.
    """
    sides = () if isinstance(shape, str) or not isinstance(shape, Iterable) else tuple(shape)
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
    """Return the obstacles as booleans of the grid's shape.

    Raises:
        ValueError: They have another shape or are not booleans.
    """
    if obstacles is None:
        return np.zeros(shape, dtype=np.bool_)
    as_numbers("obstacles", obstacles)
    found = np.asarray(obstacles)
    if found.dtype != np.bool_:
        raise ValueError(f"obstacles are of type {found.dtype}, but must be booleans")
    if found.ndim == 2 and shape[2] == 1:
        found = found[:, :, None]
    if found.shape != shape:
        raise ValueError(f"obstacles have shape {found.shape}, but the grid's is {shape}")
    return np.ascontiguousarray(found)


def check_pattern(obstacles: BoolArray) -> None:
    """Raise NoHighways for obstacles other than whole columns at (3i + 1, 3j + 1) (Sec. V-A)."""
    wrong = breaks_pattern(obstacles)
    if wrong:
        raise NoHighways(f"{wrong}, or use method='auto'")


def breaks_pattern(obstacles: BoolArray) -> str:
    """Return a message on the first vertex that breaks the pattern; empty if none does."""
    columns: BoolArray = np.asarray(obstacles.any(axis=2))
    outside = columns.copy()
    outside[1::3, 1::3] = False
    if outside.any():
        x, y = (int(k) for k in np.argwhere(outside)[0])
        return (
            f"there is an obstacle at x = {x}, y = {y}, but obstacles may only stand at x = 3i + 1,"
            " y = 3j + 1, so that there are lanes beside them; move them there"
        )
    gaps = columns[:, :, None] & ~obstacles
    if gaps.any():
        x, y, z = (int(k) for k in np.argwhere(gaps)[0])
        return (
            f"the obstacle at x = {x}, y = {y} leaves z = {z} free, but an obstacle must fill its "
            "column from bottom to top; fill it"
        )
    return ""


def check_vertices(
    name: str, given: npt.ArrayLike, shape: Shape, obstacles: BoolArray
) -> Coordinates:
    """Return vertices as an (n, 3) array, all different, in the grid and free.

    Raises:
        ValueError: They are not; the message names the first robot and the reason.
    """
    as_numbers(name, given)
    found = np.asarray(given)
    if found.ndim != 2 or found.shape[1] not in (2, 3) or (found.shape[1] == 2 and shape[2] > 1):
        raise ValueError(f"{name} have shape {found.shape}, but must be (n, 3), one row per robot")
    if not np.issubdtype(found.dtype, np.integer):
        raise ValueError(f"{name} are of type {found.dtype}, but must be integers: grid vertices")
    if len(found) == 0:
        raise ValueError(f"{name} are empty, but there must be at least one robot")
    if found.shape[1] == 2:
        found = np.column_stack([found, np.zeros(len(found), dtype=found.dtype)])
    outside = ((found < 0) | (found >= np.array(shape))).any(axis=1)
    if outside.any():
        robot = int(np.argmax(outside))
        raise ValueError(
            f"{name}[{robot}] is {_text(found[robot])}, which is outside the grid of shape {shape}"
        )
    inside = found.astype(np.int32)
    _check_free(name, inside, numbers(inside, shape), obstacles)
    return inside


def _check_free(name: str, found: Coordinates, vertices: Vertices, obstacles: BoolArray) -> None:
    """Raise ValueError for vertices with obstacles or with two robots."""
    blocked = obstacles.reshape(-1)[vertices]
    if blocked.any():
        robot = int(np.argmax(blocked))
        raise ValueError(f"{name}[{robot}] is {_text(found[robot])}, but there is an obstacle")
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
    """Return a checked instance, by the arguments of `plan`.

    Raises:
        ValueError: An argument is invalid; the message names the robot and the rule.
    """
    sides = check_shape(shape)
    walls = check_obstacles(obstacles, sides)
    first = check_vertices("starts", starts, sides, walls)
    last = check_vertices("goals", goals, sides, walls)
    if len(first) != len(last):
        raise ValueError(
            f"there are {len(first)} starts, but {len(last)} goals; give each robot one of both"
        )
    return GridInstance(sides, first, last, walls)


_Pair = tuple[Coordinates, Coordinates]


class _Draw(NamedTuple):
    shape: Shape
    robots: int | None
    generator: np.random.Generator
    obstacles: BoolArray


def building_columns(shape: Shape) -> BoolArray:
    """Return the tall buildings of Fig. 1: a column at every (3i + 1, 3j + 1)."""
    shape = check_shape(shape)
    found = np.zeros(shape, dtype=np.bool_)
    found[1::3, 1::3, :] = True
    return found


def _uniform(draw: _Draw) -> _Pair:
    free = np.flatnonzero(~draw.obstacles)
    count = draw.robots
    if count is None:  # A third of the vertices, less those of buildings
        count = int(np.prod(draw.shape)) // 3 - int(draw.obstacles.sum())
    if not 1 <= count <= len(free):
        raise ValueError(f"count is {count}, but must be from 1 to the {len(free)} free vertices")
    starts, goals = (draw.generator.choice(free, count, replace=False) for _ in range(2))
    return points(starts, draw.shape), points(goals, draw.shape)


def _balanced_choice(draw: _Draw) -> Coordinates:
    """Return random vertices, 9 in every 3 x 3 x 3 block, or 6 with buildings."""
    a, b, c = (side // 3 for side in draw.shape)
    blocks = np.arange(np.prod(draw.shape)).reshape(a, 3, b, 3, c, 3)
    blocks = blocks.transpose(0, 2, 4, 1, 3, 5).reshape(-1, 27)
    key = draw.generator.random(blocks.shape)
    key[draw.obstacles.reshape(-1)[blocks]] = 2.0
    held = 6 if draw.obstacles.any() else 9
    chosen = np.take_along_axis(blocks, np.argsort(key, axis=1)[:, :held], axis=1).reshape(-1)
    return points(draw.generator.permutation(chosen), draw.shape)


def _quasi(draw: _Draw) -> _Pair:
    return _balanced_choice(draw), _balanced_choice(draw)


def _mirror(draw: _Draw) -> _Pair:
    starts = _balanced_choice(draw)
    return starts, np.array(draw.shape, dtype=np.int32) - 1 - starts


def _rings(draw: _Draw) -> _Pair:
    """Return every third concentric square ring in each plane; goals by point reflection."""
    m1, m2, _ = draw.shape
    x, y = np.indices((m1, m2))
    depth = np.minimum.reduce([x, y, m1 - 1 - x, m2 - 1 - y])
    plane = np.argwhere(depth % 3 == 1)
    height = np.arange(draw.shape[2])
    starts = np.column_stack([np.repeat(plane, len(height), axis=0), np.tile(height, len(plane))])
    return starts.astype(np.int32), (np.array(draw.shape) - 1 - starts).astype(np.int32)


def _moved_blocks(draw: _Draw, parts: Shape | None = None) -> _Pair:
    """Return a third of the vertices, with goals in randomly permuted parts of the grid.

    By default, the parts are all blocks of 3 x 3 x 3.
    """
    parts = parts or (draw.shape[0] // 3, draw.shape[1] // 3, draw.shape[2] // 3)
    starts, goals = _balanced_choice(draw), _balanced_choice(draw)
    size = np.array(draw.shape) // parts
    origin, target = (np.ravel_multi_index((p // size).T, parts) for p in (starts, goals))
    permutation = draw.generator.permutation(int(np.prod(parts)))
    by_origin = np.argsort(origin, kind="stable")
    by_target = np.argsort(target, kind="stable").reshape(len(permutation), -1)
    found = np.empty_like(goals)
    found[by_origin] = goals[by_target[permutation].reshape(-1)]
    return starts, found


def _shift(draw: _Draw) -> _Pair:
    starts, _ = _uniform(draw)
    half = np.array([draw.shape[0] // 2, 0, 0])
    return starts, ((starts + half) % draw.shape).astype(np.int32)


def _reflection(draw: _Draw) -> _Pair:
    starts, _ = _uniform(draw)
    return starts, np.abs(starts - [draw.shape[0] - 1, 0, 0]).astype(np.int32)


def _layers(draw: _Draw) -> _Pair:
    starts, _ = _uniform(draw)
    heights = draw.generator.permutation(draw.shape[2])[starts[:, 2]]
    return starts, np.column_stack([starts[:, :2], heights]).astype(np.int32)


def _ends(draw: _Draw) -> _Pair:
    third = points(np.arange(np.prod(draw.shape) // 3), draw.shape)
    goals = draw.generator.permutation(third) + np.array([draw.shape[0] * 2 // 3, 0, 0])
    return draw.generator.permutation(third), goals.astype(np.int32)


class Family(NamedTuple):
    """A family of instances."""

    summary: str
    draw: Callable[[_Draw], _Pair]  # Draws starts and goals
    sides: int = 1  # The number of which every side must be a multiple
    free_count: bool = False  # True if the number of robots may be chosen
    buildings: bool = False  # True if there are obstacles


FAMILIES: Mapping[str, Family] = {
    "uniform": Family("starts and goals uniformly random", _uniform, free_count=True),
    "quasi-random": Family("random, every 3 x 3 x 3 block holds 9 of each", _quasi, 3),
    "mirror": Family("quasi-random starts, goals reflected at the center", _mirror, 3),
    "rings": Family("concentric square rings, goals reflected at the center", _rings),
    "blocks": Family(
        "27 blocks permuted, as in the paper", partial(_moved_blocks, parts=(3, 3, 3)), 9
    ),
    "small-blocks": Family("all 3 x 3 x 3 blocks permuted", _moved_blocks, 3),
    "buildings": Family(
        "uniform, between tall buildings", _uniform, free_count=True, buildings=True
    ),
    "quasi-buildings": Family(
        "random, between tall buildings, every block holds 6 of each", _quasi, 3, buildings=True
    ),
    "shift": Family("uniform starts, goals shifted by half of side x, cyclically", _shift, 3),
    "reflection": Family("uniform starts, goals reflected along x", _reflection, 3),
    "layers": Family("uniform starts, layers along z permuted", _layers, 3),
    "ends": Family("a full third of the grid moves to the other end in random order", _ends, 3),
}
"""The families by name."""


def make_instance(
    family: str, shape: Shape, count: int | None = None, seed: int = 0
) -> GridInstance:
    """Return a random instance.

    Args:
        family: The name of the family, in `FAMILIES`.
        shape: The shape (m1, m2, m3) of the grid.
        count: The number of robots, if the family leaves it free; by default a third of the
            vertices, less those of buildings.
        seed: The random seed; the same seed gives the same instance.

    Raises:
        ValueError: The family is unknown, or the shape or the count does not fit it.
    """
    if count is not None:
        check_integer("count", count)
    check_integer("seed", seed, at_least=0)
    kind = FAMILIES[check_name("family", family, FAMILIES)]
    sides = check_shape(shape)
    if any(side % kind.sides for side in sides):
        raise ValueError(
            f"shape is {sides}, but every side must be a multiple of {kind.sides} for {family!r}"
        )
    if count is not None and not kind.free_count:
        free = ", ".join(repr(name) for name, other in FAMILIES.items() if other.free_count)
        raise ValueError(f"count is {count}, but {family!r} fixes it; omit it, or use {free}")
    generator = np.random.default_rng(seed)
    walls = building_columns(sides) if kind.buildings else np.zeros(sides, dtype=np.bool_)
    starts, goals = kind.draw(_Draw(sides, count, generator, walls))
    if len(starts) == 0:
        raise ValueError(f"shape is {sides}, but {family!r} needs a larger one for any robot")
    return GridInstance(sides, starts, goals, walls)
