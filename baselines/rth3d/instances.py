"""Families of instances: random, and the special patterns of Sec. V-C and Fig. 9."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import NamedTuple

import numpy as np

from swarm_envs.arguments import typed
from swarm_envs.baselines.rth3d.grid import Coordinates, GridInstance, Shape, check_shape, points
from swarm_envs.errors import check_integer, check_name
from swarm_envs.state import BoolArray

_Pair = tuple[Coordinates, Coordinates]


class _Draw(NamedTuple):
    """What a family is drawn from."""

    shape: Shape
    robots: int | None
    generator: np.random.Generator
    obstacles: BoolArray


@typed
def buildings(shape: Shape) -> BoolArray:
    """The tall buildings of Fig. 1: a column at every (3i + 1, 3j + 1)."""
    found = np.zeros(shape, dtype=np.bool_)
    found[1::3, 1::3, :] = True
    return found


def _default_count(draw: _Draw) -> int:
    """A third of the vertices, less those of buildings."""
    return int(np.prod(draw.shape)) // 3 - int(draw.obstacles.sum())


def _uniform(draw: _Draw) -> _Pair:
    free = np.flatnonzero(~draw.obstacles)
    count = _default_count(draw) if draw.robots is None else draw.robots
    if not 1 <= count <= len(free):
        raise ValueError(f"count is {count}, but must be from 1 to the {len(free)} free vertices")
    starts, goals = (draw.generator.choice(free, count, replace=False) for _ in range(2))
    return points(starts, draw.shape), points(goals, draw.shape)


def _balanced_choice(draw: _Draw) -> Coordinates:
    """Vertices of which every 3 x 3 x 3 block holds 9, or 6 with buildings, in random order."""
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
    """Concentric square rings in each plane, every third one; goals by point reflection."""
    m1, m2, _ = draw.shape
    x, y = np.indices((m1, m2))
    depth = np.minimum.reduce([x, y, m1 - 1 - x, m2 - 1 - y])
    plane = np.argwhere(depth % 3 == 1)
    height = np.arange(draw.shape[2])
    starts = np.column_stack([np.repeat(plane, len(height), axis=0), np.tile(height, len(plane))])
    return starts.astype(np.int32), (np.array(draw.shape) - 1 - starts).astype(np.int32)


def _moved_blocks(draw: _Draw, parts: Shape) -> _Pair:
    """The grid cut into parts, each with a third of it, moved by a random permutation."""
    starts, goals = _balanced_choice(draw), _balanced_choice(draw)
    size = np.array(draw.shape) // parts
    origin, target = (np.ravel_multi_index((p // size).T, parts) for p in (starts, goals))
    permutation = draw.generator.permutation(int(np.prod(parts)))
    by_origin = np.argsort(origin, kind="stable")
    by_target = np.argsort(target, kind="stable").reshape(len(permutation), -1)
    found = np.empty_like(goals)
    found[by_origin] = goals[by_target[permutation].reshape(-1)]
    return starts, found


def _blocks(draw: _Draw) -> _Pair:
    return _moved_blocks(draw, (3, 3, 3))


def _small_blocks(draw: _Draw) -> _Pair:
    a, b, c = (side // 3 for side in draw.shape)
    return _moved_blocks(draw, (a, b, c))


class Family(NamedTuple):
    """A kind of instance."""

    summary: str
    """What it is, in a line."""
    draw: Callable[[_Draw], _Pair]
    """Draws starts and goals."""
    sides: int = 1
    """Every side must be a multiple of it."""
    free_count: bool = False
    """Whether the number of robots may be chosen."""
    buildings: bool = False
    """Whether there are obstacles."""


FAMILIES: Mapping[str, Family] = {
    "uniform": Family("starts and goals uniformly random", _uniform, free_count=True),
    "quasi-random": Family("random, every 3 x 3 x 3 block holds 9 of each", _quasi, 3),
    "mirror": Family("quasi-random starts, goals reflected at the centre", _mirror, 3),
    "rings": Family("concentric square rings, goals reflected at the centre", _rings),
    "blocks": Family("27 blocks change places, as the paper says", _blocks, 9),
    "small-blocks": Family("all 3 x 3 x 3 blocks change places", _small_blocks, 3),
    "buildings": Family(
        "uniform, between tall buildings", _uniform, free_count=True, buildings=True
    ),
    "quasi-buildings": Family(
        "random, between tall buildings, every block holds 6 of each", _quasi, 3, buildings=True
    ),
}
"""Every family by its name."""


@typed
def make_instance(
    family: str, shape: Shape, count: int | None = None, seed: int = 0
) -> GridInstance:
    """Draw an instance.

    Args:
        family: a name in `FAMILIES`.
        shape: (m1, m2, m3).
        count: robots, for families that leave it free; a third of the vertices by default, less
            those of buildings.
        seed: of the generator; the same seed gives the same instance.

    Raises:
        ValueError: an unknown family, a shape that it cannot have, or a count it cannot hold.
    """
    kind = FAMILIES[check_name("family", family, FAMILIES)]
    sides = check_shape(shape)
    if any(side % kind.sides for side in sides):
        raise ValueError(
            f"shape is {sides}, but every side must be a multiple of {kind.sides} for {family!r}"
        )
    if count is not None and not kind.free_count:
        free = ", ".join(repr(name) for name, other in FAMILIES.items() if other.free_count)
        raise ValueError(f"count is {count}, but {family!r} fixes it; leave it out, or take {free}")
    generator = np.random.default_rng(check_integer("seed", seed, 0))
    walls = buildings(sides) if kind.buildings else np.zeros(sides, dtype=np.bool_)
    starts, goals = kind.draw(_Draw(sides, count, generator, walls))
    if len(starts) == 0:
        raise ValueError(f"shape is {sides}, which is too small for one robot of {family!r}")
    return GridInstance(sides, starts, goals, walls)
