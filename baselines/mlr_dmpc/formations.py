"""Targets of formations that MLR-DMPC can hold: shapes leant over until nobody is below another.

With heights divided by 6, two drones above each other need 1.5 m. A cube that stands upright does
not fit the box of the paper; leant over, its columns come apart.
"""

from __future__ import annotations

from itertools import product

import numpy as np
from scipy.spatial.transform import Rotation

from swarm_envs.baselines.mlr_dmpc.config import MlrDmpcConfig
from swarm_envs.state import FloatArray
from swarm_envs.tasks.shapes import shape_points

SEQUENCE = ("plane", "pyramid", "cube", "sphere", "plane")
"""The formations of Fig. 3, the first of which is where the drones start."""
_LARGEST_SHARE = 0.95
"""Of the box that a formation takes by axis."""
_UPRIGHT_SHARE = 0.75
"""Of the box that it may take standing upright; else the lean that takes least is chosen."""
_TILTS = sorted(product(range(0, 61, 5), range(0, 61, 5)), key=lambda tilt: (sum(tilt), tilt))


def circle(num_drones: int, radius: float, height: float) -> tuple[FloatArray, FloatArray]:
    """Starts and targets (N, 3), m: evenly on a circle, each to the opposite side."""
    angle = 2.0 * np.pi * np.arange(num_drones) / num_drones
    level = radius * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    starts = np.column_stack([level, np.full(num_drones, height)])
    targets = np.column_stack([-level, np.full(num_drones, height)])
    return starts, targets


def formation(
    name: str, num_drones: int, config: MlrDmpcConfig, distance: float = 0.36, spacing: float = 0.6
) -> FloatArray:
    """Places (N, 3) of a shape in the middle of the box, m, leant over where it takes too much.

    Args:
        name: of `swarm_envs.tasks.shapes`.
        num_drones: N.
        config: box and scaling.
        distance: least scaled distance of two places, m.
        spacing: least distance of two places, m.

    Raises:
        ValueError: no lean makes it fit.
    """
    low, high = np.array(config.box)
    unit = shape_points(name, num_drones, 1.0)
    leant = [_leant(unit, tilt, config, distance, spacing) for tilt in _TILTS]
    share = [float((np.ptp(points, axis=0) / (high - low)).max()) for points in leant]
    best = 0 if share[0] <= _UPRIGHT_SHARE else int(np.argmin(np.round(share, 6)))
    if share[best] <= _LARGEST_SHARE:
        points = leant[best]
        return np.asarray(points - (points.min(axis=0) + points.max(axis=0) - low - high) / 2)
    raise ValueError(
        f"{name!r} of {num_drones} drones does not fit the box {config.box} with scaled distances "
        f"of {distance} m; take fewer drones, or a larger box"
    )


def _leant(
    unit: FloatArray, tilt: tuple[int, int], config: MlrDmpcConfig, distance: float, spacing: float
) -> FloatArray:
    """A shape (N, 3) of unit spacing turned about x, then y, and wide enough, m."""
    points = unit @ Rotation.from_euler("xy", tilt, degrees=True).as_matrix().T
    apart = float(scaled_distances(points, config).min(initial=np.inf))
    return np.asarray(points * max(spacing, distance / max(apart, 1e-6)))


def scaled_distances(points: FloatArray, config: MlrDmpcConfig) -> FloatArray:
    """Scaled distances of all pairs (N (N - 1) / 2,) of points (N, 3), m."""
    first, second = np.triu_indices(len(points), 1)
    return np.linalg.norm((points[first] - points[second]) * config.inverse_scaling, axis=1)
