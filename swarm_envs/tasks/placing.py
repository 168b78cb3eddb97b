"""Sampling and checks of starts and goals: inside the arena, apart, free of obstacles."""

from __future__ import annotations

from collections.abc import Sequence
from operator import ne

import numpy as np
import numpy.typing as npt

from swarm_envs.compiled import kernel
from swarm_envs.errors import check_array
from swarm_envs.state import FloatArray
from swarm_envs.tasks.obstacles import obstacle_distances

__all__ = ["WALL_MARGIN", "derangement", "draw_apart"]

ARENA_WIDTH, ARENA_HEIGHT = 4.0, 2.5
"""Size of the arena for up to 16 drones, m."""
WALL_MARGIN = 0.3
"""Starts and goals keep this distance from the walls, m."""
OBSTACLE_MARGIN = 0.15
"""Sampled points keep this distance from obstacles, beyond the radius of the drone, m."""
_ROUNDING = 1e-9
"""Drones this far apart do not touch, regardless of rounding, m."""
_ANYWHERE = np.array([[-np.inf] * 3, [np.inf] * 3])


def arena_of(num_drones: int) -> FloatArray:
    """Return the corners (2, 3) of the arena, m.

    It is 4 x 4 x 2.5 m, scaled by (N / 16)^(1/3) above 16 drones.
    """
    scale = max(1.0, (num_drones / 16) ** (1 / 3))
    half = ARENA_WIDTH / 2
    return np.array([[-half, -half, 0.0], [half, half, ARENA_HEIGHT]]) * scale


def drawing_box(arena: FloatArray, lowest: float, highest: float) -> tuple[FloatArray, FloatArray]:
    """Return the lower and upper corner (3,) of the box in which starts and goals are sampled, m.

    Args:
        arena: (2, 3) corners, m.
        lowest: least height, m.
        highest: largest height in an arena 2.5 m high, m; it grows with the arena.
    """
    edge = arena[1, 0] - WALL_MARGIN
    top = highest * arena[1, 2] / ARENA_HEIGHT
    return np.array([-edge, -edge, lowest]), np.array([edge, edge, top])


def check_points(
    name: str,
    points: FloatArray,
    radius: FloatArray,
    arena: FloatArray,
    obstacles: FloatArray | None = None,
) -> None:
    """Raise ValueError if points collide, or lie outside the arena or in an obstacle.

    Args:
        name: name of the points, `start` or `goal`.
        points: (N, 3) m.
        radius: (N,) collision radii, m.
        arena: (2, 3) corners, m.
        obstacles: (M, 7) rows of `swarm_envs.physics.contact`.
    """
    plain = points.flags.c_contiguous and points.dtype == np.float64
    fits = plain and points.shape == (len(radius), 3)
    room = np.empty((len(radius), 3))
    if not fits or _keep_apart(room, 0, points, _ROUNDING, radius, arena) < len(radius):
        _refuse_touching(name, check_array(name, points, (len(radius), 3)), radius, arena)
    why = "" if obstacles is None else check_free(name, points, radius, obstacles, margin=0.0)
    if why:
        raise ValueError(f"{why}; move it")


def _refuse_touching(name: str, points: FloatArray, radius: FloatArray, arena: FloatArray) -> None:
    """Raise ValueError for a drone outside the arena, or for two drones that touch."""
    low, high = arena[0] + radius[:, None], arena[1] - radius[:, None]
    outside = (points < low) | (points > high)
    if outside.any():
        i, axis = (int(k) for k in np.argwhere(outside)[0])
        raise ValueError(
            f"{name} of drone {i} has {'xyz'[axis]} = {points[i, axis]:.3f} m, but must lie "
            f"between {low[i, axis]:.3f} and {high[i, axis]:.3f} m to be inside the arena"
        )
    distance = np.linalg.norm(points[:, None] - points, axis=-1)
    touching = np.argwhere(np.triu(distance < radius[:, None] + radius, 1))
    if len(touching):
        i, j = (int(k) for k in touching[0])
        raise ValueError(
            f"{name}s of drones {i} and {j} are {distance[i, j]:.3f} m apart, closer than the "
            f"collision distance of {radius[i] + radius[j]:.3f} m; move them apart"
        )


def check_free(
    name: str,
    points: FloatArray,
    radius: FloatArray,
    obstacles: FloatArray,
    margin: float = OBSTACLE_MARGIN,
) -> str:
    """Return a message on a drone too near an obstacle; empty if there is none.

    Args:
        name: name of the points, such as `start`.
        points: (..., N, 3) m.
        radius: (N,) collision radii, m.
        obstacles: (M, 7) rows of `swarm_envs.physics.contact`.
        margin: distance to keep beyond the radius, m.
    """
    distance = obstacle_distances(obstacles, points)
    near = np.argwhere(distance < radius[:, None] + margin)
    if not len(near):
        return ""
    index = tuple(int(k) for k in near[0])
    i, k = index[-2:]
    return (
        f"the {name} of drone {i} is {distance[index]:.3f} m from obstacle {k}, but must keep "
        f"{radius[i] + margin:.3f} m from it"
    )


def draw_apart(
    rng: np.random.Generator,
    low: Sequence[float] | FloatArray,
    high: Sequence[float] | FloatArray,
    n: int,
    distance: float,
    obstacles: FloatArray | None = None,
    margin: float = OBSTACLE_MARGIN,
    given: FloatArray | None = None,
) -> FloatArray:
    """Sample points (n, 3) in a box one after another, all at least `distance` apart.

    Args:
        rng: the random generator.
        low: lower corner of the box, m.
        high: upper corner of the box, m.
        n: number of points.
        distance: smallest distance between two points, m.
        obstacles: (M, 7) rows of `swarm_envs.physics.contact`.
        margin: least distance from obstacles, m.
        given: (m, 3) the first m of the points, m, which are not sampled.

    Raises:
        RuntimeError: the points do not fit: 10,000 samples did not suffice.
    """
    rows = np.zeros((0, 0)) if obstacles is None else obstacles
    points = np.empty((n, 3))
    placed, drawn, size, no_radius = 0, 0, np.subtract(high, low), np.zeros(n)
    if given is not None:
        placed = len(given)
        points[:placed] = given
    while placed < n and drawn < 10_000:
        missing = min(n - placed, 10_000 - drawn)
        drawn += missing
        candidates = np.add(low, size * rng.random((missing, 3)))
        if len(rows):
            candidates = candidates[obstacle_distances(rows, candidates).min(axis=-1) >= margin]
        placed = _keep_apart(points, placed, candidates, distance, no_radius, _ANYWHERE)
    if placed == n:
        return points
    raise RuntimeError(
        f"found room for {placed} of {n} drones {distance} m apart within 10,000 draws; "
        "use fewer drones, fewer or smaller obstacles, or, in Python, give "
        "reset(options={'start': ...})"
    )


@kernel
def _keep_apart(
    points: FloatArray,
    placed: int,
    candidates: FloatArray,
    gap: float,
    radius: FloatArray,
    arena: FloatArray,
) -> int:
    """Append candidates in the arena that touch no earlier point; return the number of points.

    Candidates with a NaN are left out.

    Args:
        points: (N, 3) m, written from `placed` on.
        placed: number of points so far.
        candidates: (M, 3) m, at most as many as are missing.
        gap: smallest distance between the spheres of two points, m.
        radius: (N,) radii of these spheres, m.
        arena: (2, 3) corners, m.
    """
    for c in range(len(candidates)):
        fits, own = True, radius[placed]
        for k in range(3):
            x = points[placed, k] = candidates[c, k]
            fits &= (arena[0, k] + own <= x) & (x <= arena[1, k] - own)
        for j in range(placed):
            reach, square = own + radius[j] + gap, 0.0
            for k in range(3):
                square += (points[placed, k] - points[j, k]) ** 2
            fits &= square >= reach * reach
        placed += fits
    return placed


def derangement(rng: np.random.Generator, n: int) -> npt.NDArray[np.int64]:
    """Return a uniformly random permutation (n,), n >= 2, without fixed points.

    Permutations are sampled until one has no fixed point, which takes e = 2.7 samples on average.

    Raises:
        RuntimeError: there was none in a thousand samples, as for n = 1.
    """
    for _ in range(1000):
        order = rng.permutation(n)
        if all(map(ne, order.tolist(), range(n))):
            return order
    raise RuntimeError(f"n is {n}, but must be at least 2: a single element has no derangement")
