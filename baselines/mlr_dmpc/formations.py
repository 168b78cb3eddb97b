"""Targets that MLR-DMPC can hold: a circle, and the formations of Fig. 3.

With heights divided by 6, two drones above each other need 1.5 m. A cube that stands upright does
not fit the box of the paper; leant over, its columns come apart.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from swarm_envs.baselines.mlr_dmpc.mlr_dmpc_config import MlrDmpcConfig
from swarm_envs.errors import check_name
from swarm_envs.state import FloatArray
from swarm_envs.tasks.shapes import shape_points

__all__ = ["SEQUENCE", "circle_swap", "formation", "scaled_distances"]

SEQUENCE = ("plane", "pyramid", "cube", "sphere", "plane")
"""The formations of Fig. 3, the first of which is where the drones start."""
_SPACING_M = {"plane": 0.8, "pyramid": 0.8, "cube": 0.9, "sphere": 0.55}
_SPHERE_RADIUS_M = 1.25
_LEAN_RAD = np.radians(20.0)


def circle_swap(num_drones: int, radius: float, height: float) -> tuple[FloatArray, FloatArray]:
    """Starts and targets (N, 3), m: evenly on a circle, each to the opposite side."""
    angle = 2.0 * np.pi * np.arange(num_drones) / num_drones
    level = radius * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    starts = np.column_stack([level, np.full(num_drones, height)])
    targets = np.column_stack([-level, np.full(num_drones, height)])
    return starts, targets


def formation(name: str, num_drones: int = 16) -> FloatArray:
    """Places (N, 3), m, of a shape of `SEQUENCE` in the published box; sized for 16 drones."""
    points = shape_points(check_name("formation", name, _SPACING_M), num_drones, _SPACING_M[name])
    if name == "sphere":
        points = points * (_SPHERE_RADIUS_M / np.linalg.norm(points[0]))
    if name == "cube":
        points = Rotation.from_euler("x", -_LEAN_RAD).apply(points)
    middle = np.array([0.0, 0.0, 1.0 if name == "plane" else 1.65])
    return np.asarray(points + middle)


def scaled_distances(points: FloatArray, config: MlrDmpcConfig) -> FloatArray:
    """Scaled distances of all pairs (N (N - 1) / 2,) of points (N, 3), m."""
    first, second = np.triu_indices(len(points), 1)
    return np.linalg.norm((points[first] - points[second]) * config.inverse_scaling, axis=1)
