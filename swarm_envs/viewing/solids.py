"""Static obstacles as pictures need them: boxes and upright cylinders by their corners."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, NamedTuple

import numpy as np

from swarm_envs.state import FloatArray

_SIDES = 20
"""Of the prism that stands for a cylinder."""


class Solid(NamedTuple):
    """A box with edges along the axes, or the upright cylinder that just fits into one."""

    round: bool
    """Whether it is the cylinder."""
    low: tuple[float, float, float]
    """Lowest corner of the box, m."""
    high: tuple[float, float, float]
    """Highest corner of the box, m."""

    def rings(self) -> FloatArray:
        """Outlines (2, K, 3) of its bottom and its top, m, counter-clockwise from above."""
        low, high = np.array(self.low), np.array(self.high)
        if self.round:
            angle = 2 * np.pi * np.arange(_SIDES) / _SIDES
            unit = 0.5 + 0.5 * np.stack([np.cos(angle), np.sin(angle)], axis=1)
        else:
            unit = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
        outline = low[:2] + unit * (high - low)[:2]
        return np.stack(
            [np.column_stack([outline, np.full(len(unit), z)]) for z in (low[2], high[2])]
        )


def solids(obstacles: Iterable[Any], ceiling: float) -> tuple[Solid, ...]:
    """The obstacles of a task as solids, in the same order, cut off at the ceiling.

    Args:
        obstacles: boxes, which have corners `low` and `high` (3,), m, and columns, which stand on
            the ground and have a `center` (x, y), a `radius` and a `height`, m.
        ceiling: height of the arena, m.
    """
    found = []
    for obstacle in obstacles:
        if hasattr(obstacle, "radius"):
            (x, y), r = obstacle.center[:2], obstacle.radius
            low, high = (x - r, y - r, 0.0), (x + r, y + r, obstacle.height)
        else:
            low, high = obstacle.low, obstacle.high
        top = min(float(high[2]), ceiling)
        lowest = (float(low[0]), float(low[1]), float(low[2]))
        highest = (float(high[0]), float(high[1]), top)
        found.append(Solid(hasattr(obstacle, "radius"), lowest, highest))
    return tuple(found)
