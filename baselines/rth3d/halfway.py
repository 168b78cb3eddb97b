"""Places halfway, over which crowds that stand close go to where they will stand close.

PIBT leads robots well from a crowd to places that are spread out, and by reversing time also back
into a crowd, but not from one crowd into another: who arrives first blocks the others.
"""

from __future__ import annotations

import numpy as np

from swarm_envs.baselines.rth3d.grid import Coordinates, GridInstance


def halfway(instance: GridInstance) -> Coordinates:
    """(n, 3) vertices, all different and spread over a grid without obstacles.

    As robots stand halfway between starts and goals, in order of x, then in each plane of y, then
    in each row of z, so they are put into planes, rows and vertices.
    """
    twice, (m1, m2, m3) = instance.starts + instance.goals, instance.shape
    found = np.empty_like(instance.starts)
    for x, plane in enumerate(np.array_split(np.argsort(twice[:, 0], kind="stable"), m1)):
        by_y = plane[np.argsort(twice[plane, 1], kind="stable")]
        for y, row in enumerate(np.array_split(by_y, m2)):
            by_z = row[np.argsort(twice[row, 2], kind="stable")]
            z = (2 * np.arange(len(row)) + 1) * m3 // (2 * max(len(row), 1))
            found[by_z] = np.stack([np.full_like(z, x), np.full_like(z, y), z], axis=1)
    return found
