"""What a policy network is told where there is a reference to be kept to: errors, and who blows.

Errors of centimetres decide here, so they are scaled to be of order one. Where the drone is does
not matter, nor the time: the policy is the same all around a ring.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from swarm_envs.agents.features import check_width
from swarm_envs.envs.observation import Float32Array, observation_layout
from swarm_envs.tasks.base import ACCELERATION_LIMIT, SPEED_LIMIT

NAME = "reference-and-downwash-1"
"""Name of this choice of features: files of policies say by it what their numbers are."""

REACH = 0.2
"""Beyond this distance from the reference its vector is a direction, m."""
FAST = 0.5
"""Unit of errors of velocity, m/s."""
BESIDE = 0.2
"""Length over which downwash falls by e to the side, m."""
ABOVE = 0.5
"""Height at which a neighbour counts as fully above or below, m."""
OWN_WIDTH, NEIGHBOR_WIDTH = 23, 12
"""Numbers told of a drone itself, whose type is last, and of each neighbour: type and mask last."""


def reference_features(rows: Float32Array, num_neighbors: int) -> Float32Array:
    """Features of flat observation rows without obstacles.

    Of the drone (23): the vector to its reference, over 0.2 m and cut there; its distance, m; the
    reference's velocity less its own, over 0.5 m/s; the reference's velocity, m/s, and
    acceleration, m/s^2; the direction of its thrust, and its share of the largest; the controller's
    set-point relative to the reference, over 0.2 m; its type, one-hot.
    Of each neighbour (12): relative position, m, and velocity over 2 m/s; nearness to the vertical
    line through the drone, exp(-h / 0.2 m); this times height above the drone over 0.5 m, cut at
    one; type; mask. All zero where there is no neighbour.

    Args:
        rows: (..., width) as `observation="flat"` gives them, `num_obstacles=0`.
        num_neighbors: K.

    Returns:
        (..., 23 + 12 K) float32.

    Raises:
        ValueError: rows have another width.
    """
    check_width(rows, num_neighbors)
    at = {field.name: field.where for field in observation_layout(num_neighbors)}
    error = rows[..., at["task.reference_position"]]
    distance = np.linalg.norm(error, axis=-1, keepdims=True)
    velocity = rows[..., at["self.velocity"]] * np.float32(SPEED_LIMIT)
    wanted = rows[..., at["task.reference_velocity"]] * np.float32(SPEED_LIMIT)
    parts: list[npt.NDArray[Any]] = [
        error / np.maximum(distance, REACH),
        distance,
        (wanted - velocity) / np.float32(FAST),
        wanted,
        rows[..., at["task.reference_acceleration"]] * np.float32(ACCELERATION_LIMIT),
        rows[..., at["self.attitude"]][..., 2::3],
        rows[..., at["self.thrust"]],
        (rows[..., at["self.setpoint_offset"]] - error) / np.float32(REACH),
        rows[..., at["self.type"]],
    ]
    if num_neighbors:
        seen = [_neighbor_features(rows, at, f"neighbor_{k}") for k in range(num_neighbors)]
        parts += seen
    made: Float32Array = np.concatenate(parts, axis=-1, dtype=np.float32)
    return made


def _neighbor_features(rows: Float32Array, at: Mapping[str, slice], name: str) -> Float32Array:
    """(..., 12) of the rows' neighbour of this name."""
    position, mask = rows[..., at[f"{name}.position"]], rows[..., at[f"{name}.mask"]]
    beside = np.exp(-np.linalg.norm(position[..., :2], axis=-1, keepdims=True) / BESIDE)
    above = np.clip(position[..., 2:3] / ABOVE, -1.0, 1.0)
    velocity, kind = rows[..., at[f"{name}.velocity"]], rows[..., at[f"{name}.type"]]
    parts = [position, velocity, beside, beside * above, kind, mask]
    made: Float32Array = np.concatenate(parts, axis=-1, dtype=np.float32) * mask
    return made
