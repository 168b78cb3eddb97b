"""Targets that MLR-DMPC can hold: a circle, and the formations of Fig. 3.

With heights divided by 6, two drones above each other need 1.5 m. An upright cube thus does not fit
the box of the paper; a tilted one does, as none of its drones are directly above each other.
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
"""The formations of Fig. 3; the drones start in the first."""
_SPACING_M = {"plane": 0.8, "pyramid": 0.8, "cube": 0.9, "sphere": 0.55}
_SPHERE_RADIUS_M = 1.25
_LEAN_RAD = np.radians(20.0)


def circle_swap(num_drones: int, radius: float, height: float) -> tuple[FloatArray, FloatArray]:
    """Return starts (N, 3), m, evenly on a circle, and targets (N, 3) on the opposite side."""
    angle = 2.0 * np.pi * np.arange(num_drones) / num_drones
    level = radius * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    starts = np.column_stack([level, np.full(num_drones, height)])
    targets = np.column_stack([-level, np.full(num_drones, height)])
    return starts, targets


def formation(name: str, num_drones: int = 16) -> FloatArray:
    """Return the points (N, 3), m, of a shape of `SEQUENCE` in the published box, for 16 drones."""
    points = shape_points(check_name("formation", name, _SPACING_M), num_drones, _SPACING_M[name])
    if name == "sphere":
        points = points * (_SPHERE_RADIUS_M / np.linalg.norm(points[0]))
    if name == "cube":
        points = Rotation.from_euler("x", -_LEAN_RAD).apply(points)
    middle = np.array([0.0, 0.0, 1.0 if name == "plane" else 1.65])
    return np.asarray(points + middle)


def scaled_distances(points: FloatArray, config: MlrDmpcConfig) -> FloatArray:
    """Return scaled distances (N (N - 1) / 2,) of all pairs of points (N, 3), m."""
    first, second = np.triu_indices(len(points), 1)
    return np.linalg.norm((points[first] - points[second]) * config.inverse_scaling, axis=1)
