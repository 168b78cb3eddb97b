"""Time-varying buffered Voronoi planes between a drone and all that the others may fly."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from swarm_envs.baselines.mlr_dmpc.config import MlrDmpcConfig
from swarm_envs.compiled import kernel
from swarm_envs.state import BoolArray, FloatArray, IntArray

ROW_MARGIN = 1e-5
"""Rows are built for this much more than the distance kept, m: room for tolerance and rounding."""


class Neighbors(NamedTuple):
    """Every candidate trajectory of every other drone, at the collision samples of a plan."""

    positions: FloatArray
    """(C, S, 3) at t + T_c, t + 2 T_c, ... for a plan that starts at t, m."""
    drone: IntArray
    """(C,) whose trajectory it is."""
    concurrent: BoolArray
    """(C,) whether that drone may be planned anew in the same round."""


class HalfSpaces(NamedTuple):
    """Half-spaces normal . p >= offset that hold at one collision sample each."""

    normals: FloatArray
    """(P, S, 3), unit free."""
    offsets: FloatArray
    """(P, S), m."""


def no_neighbors(config: MlrDmpcConfig) -> Neighbors:
    """The neighbours of a drone that flies alone."""
    return Neighbors(
        np.zeros((0, config.num_samples, 3)), np.zeros(0, dtype=np.int64), np.zeros(0, dtype=bool)
    )


def voronoi_planes(own: FloatArray, neighbors: Neighbors, config: MlrDmpcConfig) -> HalfSpaces:
    """Half-spaces (15) between a drone's present plan and the trajectories of others.

    A drone that may be planned anew gives half of the gap, one that is not gives all of it.

    Args:
        own: (S, 3) positions of the present plan at the collision samples, m.
        neighbors: what the others may fly.
        config: scaling Theta and distance.

    Returns:
        Half-spaces (C, S), with normals by Theta: for points in metres.
    """
    return HalfSpaces(
        *_voronoi_planes(
            own,
            neighbors.positions,
            neighbors.concurrent,
            config.inverse_scaling,
            config.distance_m,
        )
    )


@kernel
def _voronoi_planes(
    own: FloatArray,
    others: FloatArray,
    concurrent: BoolArray,
    shrink: FloatArray,
    distance: float,
) -> tuple[FloatArray, FloatArray]:
    count, samples = others.shape[:2]
    normals, offsets = np.empty((count, samples, 3)), np.empty((count, samples))
    for c in range(count):
        for s in range(samples):
            square = 0.0
            for i in range(3):
                normals[c, s, i] = shrink[i] * (own[s, i] - others[c, s, i])
                square += normals[c, s, i] ** 2
            gap = max(np.sqrt(square), 1e-12)
            offset = 0.5 * (distance + gap) if concurrent[c] else distance
            for i in range(3):
                normals[c, s, i] *= shrink[i] / gap
                offset += normals[c, s, i] * others[c, s, i]
            offsets[c, s] = offset
    return normals, offsets
