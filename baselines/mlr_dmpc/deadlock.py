"""Deadlock: a drone at rest whose pull to the target is balanced by those that it touches.

Chen et al. (2024), Theorem 1 and eq. (13), as the paper's Appendix A.4 uses them: at rest, the
optimality conditions of (13) say that the pull is a sum of contact forces, none of which pulls.
"""

from __future__ import annotations

import numpy as np

from swarm_envs.baselines.mlr_dmpc.config import MlrDmpcConfig
from swarm_envs.state import BoolArray, FloatArray


def deadlocked(
    ends: FloatArray, speeds: FloatArray, targets: FloatArray, config: MlrDmpcConfig
) -> BoolArray:
    """Who is in a deadlock (N,).

    A drone is if it is slower than `deadlock_speed`, its plan ends farther than `deadlock_m` from
    its target, and non-negative contact forces of still drones within `contact_factor` times the
    distance kept, and of the walls of the box, balance the pull of its target but for
    `deadlock_residual` of it.

    Args:
        ends: (N, 3) where the plans end, m.
        speeds: (N,) now, m/s.
        targets: (N, 3) m.
        config: limits.
    """
    pull = targets - ends
    length = np.linalg.norm(pull, axis=1)
    still = speeds <= config.deadlock_speed
    gap = np.linalg.norm((ends[:, None] - ends) * config.inverse_scaling, axis=-1)
    touches = still & (gap <= config.contact_factor * config.distance_m)
    np.fill_diagonal(touches, False)
    out = np.zeros(len(ends), dtype=bool)
    for i in np.flatnonzero(still & (length > config.deadlock_m)):
        between = (ends[i] - ends[touches[i]]) * config.inverse_scaling**2
        contacts = np.concatenate([between, _walls(ends[i], config)])
        out[i] = unbalanced(pull[i] / length[i], contacts) <= config.deadlock_residual
    return out


def unbalanced(pull: FloatArray, contacts: FloatArray) -> float:
    """What is left of a pull (3,) when contacts push as they can, non-negative least squares.

    Args:
        pull: (3,) force.
        contacts: (K, 3) directions in which contacts push; those of no length do not.
    """
    length = np.linalg.norm(contacts, axis=1, keepdims=True)
    touching = length[:, 0] > 1e-9  # two that would end at one place push nowhere
    if not touching.any():
        return float(np.linalg.norm(pull))
    from scipy.optimize import nnls

    directions = contacts[touching] / length[touching]
    return float(nnls(directions.T, -pull)[1])


def _walls(point: FloatArray, config: MlrDmpcConfig) -> FloatArray:
    """(K, 3) inward normals of the faces of the box that a point (3,) touches."""
    lower, upper = np.array(config.box)
    near = (config.contact_factor - 1.0) * config.distance_m
    normals = np.eye(3)
    return np.concatenate([normals[point - lower <= near], -normals[upper - point <= near]])
