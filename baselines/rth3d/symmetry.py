"""Goals that are the starts reflected: both sides are then balanced alike, each the other's image.

Rings and point reflections (Sec. V-C) lose their symmetry when either side is balanced for itself:
robots of one column then belong into several, and the first two shuffles have to sort them out. If
the goals' balancing is the image of the starts', columns belong into columns as a whole, and those
shuffles vanish.
"""

from __future__ import annotations

from itertools import product

import numpy as np
import numpy.typing as npt

from swarm_envs.baselines.rth3d.compaction import Paths
from swarm_envs.baselines.rth3d.grid import Vertices
from swarm_envs.baselines.rth3d.highways import Highways
from swarm_envs.state import BoolArray

Image = npt.NDArray[np.int32]
"""(V,) the vertex that each vertex is reflected to."""


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
    """Whether two sets of vertices are equal."""
    return np.array_equal(_members(first, total), _members(second, total))


def _members(vertices: Vertices, total: int) -> BoolArray:
    found = np.zeros(total, dtype=np.bool_)
    found[vertices] = True
    return found


def reflection(highways: Highways, starts: Vertices, goals: Vertices) -> Image | None:
    """The reflection of the grid that makes the set of goals from that of the starts, if any.

    Of several, the one that takes the most robots to their own goals.

    Args:
        highways: the grid.
        starts: (n,) all different.
        goals: (n,) all different.
    """
    images = [i for i in _images(highways) if _same(i[starts], goals, len(i))]
    return max(images, key=lambda image: int((image[starts] == goals).sum()), default=None)


def reflected(paths: Paths, image: Image, goals: Vertices) -> Paths:
    """Paths (T + 1, n) from the goals that are the image of paths from the starts."""
    holder = np.empty(len(image), dtype=np.int32)
    holder[image[paths[0]]] = np.arange(paths.shape[1], dtype=np.int32)
    return image[paths[:, holder[goals]]]
