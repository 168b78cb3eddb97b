"""Time-varying buffered Voronoi planes between a drone and all that the others may fly."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from swarm_envs.baselines.mlr_dmpc.config import MlrDmpcConfig
from swarm_envs.compiled import kernel
from swarm_envs.state import BoolArray, FloatArray, IntArray

SPARE_M = 2e-6
"""Rows keep this much more than the distance, m: what tolerances may take from a pair."""
ROW_MARGIN = 1e-5
"""Rows are built for this much more again, m: room for the solver's tolerance."""


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

    Planes are turned about the vertical by up to `turn_rad`, so that each drone has more room on
    its right: the weights of Appendix B alone leave two drones that meet head on where they are.
    Any unit normal proves Lemma 3. For Corollary 1 both drones need one plane: the turn depends on
    the gap alone, which is the same for both, and so is its sense. For Theorem 1 the present plan
    must satisfy its rows: along the turned normal the gap stays above the distance kept, since the
    turn is at most `turn_share` of where it would not.

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
            config.distance_m + SPARE_M,
            config.turn_rad,
            config.turn_share,
        )
    )


@kernel
def _voronoi_planes(
    own: FloatArray,
    others: FloatArray,
    concurrent: BoolArray,
    shrink: FloatArray,
    distance: float,
    turn: float,
    turn_share: float,
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
            for i in range(3):
                normals[c, s, i] /= gap
            _turn(normals[c, s], min(distance / gap, 1.0), turn, turn_share)
            offset = distance
            if concurrent[c]:
                offset *= 0.5
                for i in range(3):
                    offset += 0.5 * normals[c, s, i] * shrink[i] * (own[s, i] - others[c, s, i])
            for i in range(3):
                normals[c, s, i] *= shrink[i]
                offset += normals[c, s, i] * others[c, s, i]
            offsets[c, s] = offset
    return normals, offsets


@kernel
def _turn(normal: FloatArray, least_gap: float, turn: float, share: float) -> None:
    """Turn a unit normal (3,) about the vertical; `least_gap` of the gap must be left along it."""
    level = normal[0] ** 2 + normal[1] ** 2
    least = (least_gap - normal[2] ** 2) / max(level, 1e-12)
    angle = min(turn, share * math.acos(max(min(least, 1.0), -1.0)))
    x, y = normal[0], normal[1]
    normal[0] = math.cos(angle) * x - math.sin(angle) * y
    normal[1] = math.sin(angle) * x + math.cos(angle) * y
