"""How the robots of a cell get from its middle column into the lanes of the long shuffle.

A cell is 3 x 3 vertices, long axis first. Its robots stand in the column x = 1, at y = 0, 1, 2, or
at y = 0, 2 around an obstacle. Whoever goes on to larger x must get into the lane y = 0, to smaller
x into y = 2, and whoever stays into the row y = 1 between them, in at most three steps (Sec. III-B).
"""

from __future__ import annotations

from functools import cache
from itertools import product

import numpy as np
import numpy.typing as npt

STEPS = 3
"""Steps that the change of lanes takes."""
LANE = {0: 1, 1: 0, 2: 2}
"""The row in which a robot must be: by 0 for staying, 1 for going up, 2 for going down."""

_MOVES = ((0, 0), (1, 0), (-1, 0), (0, 1), (0, -1))
_Walk = npt.NDArray[np.int64]


@cache
def _walks(row: int, heading: int, obstacle: bool) -> tuple[tuple[_Walk, int], ...]:
    """Walks from (1, row) into the right lane, (STEPS + 1, 2), each with its cost."""
    found = []
    for moves in product(_MOVES, repeat=STEPS):
        walk = np.cumsum([(1, row), *moves], axis=0)
        inside = ((walk >= 0) & (walk < 3)).all()
        if not inside or walk[-1, 1] != LANE[heading]:
            continue
        if obstacle and (walk == 1).all(axis=1).any():
            continue
        progress = (walk[-1, 0] - 1) * (0, 1, -1)[heading]
        found.append((walk, 2 * sum(move != (0, 0) for move in moves) - int(progress)))
    return tuple(sorted(found, key=lambda pair: (pair[1], pair[0].tolist())))


def _apart(first: _Walk, second: _Walk) -> bool:
    """Whether two walks never share a vertex and never swap."""
    same = (first == second).all(axis=1).any()
    there = (first[1:] == second[:-1]).all(axis=1)
    back = (first[:-1] == second[1:]).all(axis=1)
    return not (same or (there & back).any())


def _cheapest(rows: tuple[int, ...], headings: tuple[int, ...], obstacle: bool) -> list[_Walk]:
    """Walks of all robots of a cell that fit together, with the least cost."""
    best: tuple[float, list[_Walk]] = (np.inf, [])

    def extend(chosen: list[_Walk], cost: int) -> None:
        nonlocal best
        if len(chosen) == len(rows):
            best = (cost, chosen)
            return
        k = len(chosen)
        for walk, own in _walks(rows[k], headings[k], obstacle):
            least = sum(
                _walks(r, h, obstacle)[0][1] for r, h in zip(rows[k + 1 :], headings[k + 1 :])
            )
            if cost + own + least >= best[0]:
                break
            if all(_apart(walk, other) for other in chosen):
                extend([*chosen, walk], cost + own)

    extend([], 0)
    return best[1]


@cache
def lane_changes(held: int) -> npt.NDArray[np.int8]:
    """All changes of lanes.

    Args:
        held: robots of a cell: 3, or 2 around an obstacle.

    Returns:
        (3 ** held, held, STEPS, 2) where each robot is after each step, for every combination of
        headings; the first robot's heading counts 1, the next one's 3, the last one's 9.
    """
    rows = (0, 1, 2) if held == 3 else (0, 2)
    found = np.empty((3**held, held, STEPS, 2), dtype=np.int8)
    for code in range(3**held):
        headings = tuple(code // 3**k % 3 for k in range(held))
        for k, walk in enumerate(_cheapest(rows, headings, held == 2)):
            found[code, k] = walk[1:]
    return found
