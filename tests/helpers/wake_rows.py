"""A table of forces whose truth is known: that of the course's starter."""

from __future__ import annotations

import numpy as np

from swarm_envs.training.interaction_rows import InteractionRows


def wake_rows(count: int, seed: int = 0) -> InteractionRows:
    """Small drones under one other; the force is that of a wake of the starter's own form."""
    rng = np.random.default_rng(seed)
    neighbor = rng.uniform(-0.3, 0.3, (count, 1, 6))
    neighbor[..., 2] += 0.3
    x, y, z = neighbor[:, 0, :3].T
    down = -8.0 * np.exp(-(x**2 + y**2) / 0.3**2 - z / 0.5) * (z > 0)
    zeros = np.zeros(count, dtype=np.int64)
    return InteractionRows(
        types=("S",),
        ego_type=zeros,
        position=np.ones((count, 3)),
        velocity=np.zeros((count, 3)),
        neighbor=neighbor,
        neighbor_type=zeros[:, None],
        force_g=np.stack([0 * down, 0 * down, down], axis=1),
        flight=zeros,
        step=np.arange(count),
        vehicle=zeros,
        scenario=zeros,
        validation=np.arange(count) % 4 == 0,
        scenario_names=("S2S",),
    )
