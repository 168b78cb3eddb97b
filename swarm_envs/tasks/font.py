"""A small stroke font of our own: capital letters and digits as lines on a grid of 5 x 7 points."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from swarm_envs.errors import check_name
from swarm_envs.state import FloatArray

_ROUND = "10-01-05-16-36-45-41-30-10"
_BOW = "00-06-36-45-44-33-03"
_LINES: dict[str, str] = {
    "A": "00-26-40 13-33",
    "B": f"{_BOW} 33-42-41-30-00",
    "C": "45-36-16-05-01-10-30-41",
    "D": "00-06-26-44-42-20-00",
    "E": "46-06-00-40 03-33",
    "F": "46-06-00 03-33",
    "G": "45-36-16-05-01-10-30-41-43-23",
    "H": "00-06 40-46 03-43",
    "I": "16-36 26-20 10-30",
    "J": "46-41-30-10-01",
    "K": "00-06 46-03-40",
    "L": "06-00-40",
    "M": "00-06-23-46-40",
    "N": "00-06-40-46",
    "O": _ROUND,
    "P": _BOW,
    "Q": f"{_ROUND} 22-40",
    "R": f"{_BOW} 23-40",
    "S": "45-36-16-05-04-13-33-42-41-30-10-01",
    "T": "06-46 26-20",
    "U": "06-01-10-30-41-46",
    "V": "06-20-46",
    "W": "06-10-23-30-46",
    "X": "00-46 06-40",
    "Y": "06-23-46 23-20",
    "Z": "06-46-00-40",
    "0": f"{_ROUND} 12-34",
    "1": "15-26-20 10-30",
    "2": "05-16-36-45-44-00-40",
    "3": "06-46-23-33-42-41-30-10-01",
    "4": "30-36-02-42",
    "5": "46-06-04-34-43-41-30-10-01",
    "6": "45-36-16-05-01-10-30-41-42-33-03",
    "7": "06-46-10",
    "8": "13-04-05-16-36-45-44-33-13-02-01-10-30-41-42-33",
    "9": "01-10-30-41-45-36-16-05-04-13-43",
}
"""Strokes of each character; two digits are x and y of a point, hyphens join points."""
CHARACTERS = tuple(_LINES)
"""Everything that can be written."""
THIN_UP_TO = 24
"""Characters of more drones than this are drawn with broad strokes."""
_STEP, _BROAD, _SWEEPS = 0.05, 0.5, 15


def strokes(character: str) -> list[tuple[FloatArray, FloatArray]]:
    """The straight pieces of a character: pairs of points (2,) with x in 0-4, y in 0-6.

    Raises:
        ValueError: it is not among `CHARACTERS`.
    """
    check_name("character", character, CHARACTERS)
    pieces = []
    for line in _LINES[character].split():
        points = [np.array([float(point[0]), float(point[1])]) for point in line.split("-")]
        pieces += list(pairwise(points))
    return pieces


def written(character: str, n: int) -> FloatArray:
    """Points (n, 2) that spread evenly over a character.

    Each next point is the one farthest from those before; then all move to the middle of the part
    of the character that is nearest to them (Lloyd's method), as long as that spreads them.

    Raises:
        ValueError: the character is not among `CHARACTERS`.
    """
    candidates = _dense(character, broad=n > THIN_UP_TO)
    chosen = np.empty((n, 2))
    distance = np.full(len(candidates), np.inf)
    for k in range(n):
        chosen[k] = candidates[int(np.argmax(distance))]
        distance = np.minimum(distance, np.linalg.norm(candidates - chosen[k], axis=1))
    return _spread(chosen, candidates)


def _spread(points: FloatArray, candidates: FloatArray) -> FloatArray:
    """The most even of the point sets (n, 2) that Lloyd's method goes through on candidates."""
    best, n = points, len(points)
    for _ in range(_SWEEPS):
        owner = _squares(candidates, points).argmin(axis=1)
        size = np.bincount(owner, minlength=n)
        sums = [np.bincount(owner, candidates[:, k], minlength=n) for k in range(2)]
        means = np.stack(sums, axis=-1) / size[:, None]
        points = candidates[_squares(means, candidates).argmin(axis=1)]
        if len(np.unique(points, axis=0)) < n:
            break
        if _evenness(points) > _evenness(best):
            best = points
    return best


def _squares(a: FloatArray, b: FloatArray) -> FloatArray:
    """Squared distances (A, B) between points (A, 2) and (B, 2)."""
    return np.asarray(
        np.square(a).sum(axis=1)[:, None] - 2.0 * a @ b.T + np.square(b).sum(axis=1)[None]
    )


def _evenness(points: FloatArray) -> float:
    """Smallest squared distance between two of the points (n, 2)."""
    return float((_squares(points, points) + np.diag(np.full(len(points), np.inf))).min())


def _dense(character: str, broad: bool) -> FloatArray:
    """Points all over a character: along its lines, or in a band around them."""
    pieces = strokes(character)
    if not broad:
        rows = []
        for a, b in pieces:
            share = np.linspace(0.0, 1.0, 1 + round(float(np.linalg.norm(b - a)) / _STEP))
            rows.append(a + share[:, None] * (b - a))
        return np.concatenate(rows)
    grid = np.stack(
        np.meshgrid(np.arange(-_BROAD, 4.51, 0.1), np.arange(-_BROAD, 6.51, 0.1)), axis=-1
    ).reshape(-1, 2)
    near = np.full(len(grid), np.inf)
    for a, b in pieces:
        share = np.clip((grid - a) @ (b - a) / ((b - a) @ (b - a)), 0.0, 1.0)
        near = np.minimum(near, np.linalg.norm(grid - a - share[:, None] * (b - a), axis=1))
    return np.asarray(grid[near <= _BROAD + 1e-9])
