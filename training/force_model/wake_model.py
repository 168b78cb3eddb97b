"""The closed-form wake: what `wake_fit` fits and `weights/wake.json` holds, over rows.

The vertical force on a drone, gram-force, downwash positive inside:

    pair_k = A (w0/w)^p exp(-(r/w)^2 / 2) s(dz / 0.03 m),    w = w0 + S max(dz, 0)
    f_z = G exp(-(z - 0.07 m)/h) - (1 - M exp(-z/hm)) (sum_k pair_k^q)^(1/q)

s is the logistic function, dz the height of neighbour k over the drone, and r the lateral
distance from the wake's axis, which a moving neighbour leaves behind: at depth dz it is shifted
by -v dz / U, U being one advection speed per type of the neighbour. A pair fades over the edge
of the interaction volume as in the learned model.
"""

from __future__ import annotations

from typing import Literal, NamedTuple

import numpy as np
import torch

from swarm_envs.training.force_model.network import OUTER_FADE, Window, fade
from swarm_envs.training.interaction_rows.rows import (
    BoolArray,
    FloatArray,
    IntArray,
    InteractionRows,
)

ROTOR_DEPTH_M = 0.03
"""Vertical distance over which a neighbour passes from beside to above."""

GROUND_REFERENCE_M = 0.07
"""Height at which the ground effect is G: the lowest that was measured."""

WakeVelocity = Literal["relative", "neighbor"]
"""Which velocity tilts the wake: the neighbour's relative to the drone, or its own."""


class WakeParameters(NamedTuple):
    """Parameters by type: rows of the (T, T) arrays are the upper drone, columns the lower."""

    amplitude_g: FloatArray
    """A (T, T), gram-force."""
    width_m: FloatArray
    """w0 (T, T), m."""
    spread: FloatArray
    """S (T, T), m of width per m of depth."""
    decay: FloatArray
    """p (T, T)."""
    advection_speed: FloatArray
    """U (T,) by upper type, m/s."""
    ground_g: FloatArray
    """G (T,) by the drone's own type, gram-force."""
    ground_height_m: FloatArray
    """h (T,), m."""
    combine_q: float
    """q >= 1: 1 adds the pairs, infinity keeps the largest."""
    mitigation: float
    """M in [0, 1]: share of the downwash that the ground takes away at z = 0."""
    mitigation_height_m: float
    """hm, m."""


class WakeRows(NamedTuple):
    """Rows as the wake takes them; only slots with a neighbour inside the volume are pairs."""

    ego_type: IntArray
    """(R,)"""
    height_m: FloatArray
    """(R,) z."""
    pair_row: IntArray
    """(P,) row that each pair belongs to."""
    pair_type: IntArray
    """(P,) type of the neighbour."""
    offset_m: FloatArray
    """(P, 3) p_j - p_i."""
    wake_velocity: FloatArray
    """(P, 2) horizontal velocity that tilts the wake, m/s."""
    weight: FloatArray
    """(P,) fade at the edge of the volume."""


def wake_rows(
    rows: InteractionRows, velocity: WakeVelocity, window: Window = OUTER_FADE
) -> WakeRows:
    """Pick the pairs out of a table of rows."""
    distance = torch.from_numpy(np.abs(rows.neighbor[..., :3]))
    weight = fade(distance[..., 0], *window.lateral_m) * fade(distance[..., 1], *window.lateral_m)
    weight = weight * fade(distance[..., 2], *window.vertical_m)
    kept: BoolArray = rows.has_neighbor & (weight.numpy() > 0)
    row, slot = np.nonzero(kept)
    pair = rows.neighbor[row, slot]
    moving = pair[:, 3:5] if velocity == "relative" else pair[:, 3:5] + rows.velocity[row, :2]
    return WakeRows(
        ego_type=rows.ego_type,
        height_m=rows.position[:, 2],
        pair_row=row.astype(np.int64),
        pair_type=rows.neighbor_type[row, slot],
        offset_m=pair[:, :3],
        wake_velocity=moving,
        weight=weight.numpy()[row, slot],
    )


def wake_force_g(parameters: WakeParameters, rows: WakeRows) -> FloatArray:
    """Vertical force of every row without drag, (R,) in gram-force."""
    w = parameters
    ego = rows.ego_type
    pair = pair_downwash_g(w, rows)
    total = np.bincount(rows.pair_row, pair**w.combine_q, minlength=len(ego))
    downwash = total ** (1.0 / w.combine_q)
    downwash *= 1.0 - w.mitigation * np.exp(-rows.height_m / w.mitigation_height_m)
    above = rows.height_m - GROUND_REFERENCE_M
    ground = w.ground_g[ego] * np.exp(-above / w.ground_height_m[ego])
    return np.asarray(ground - downwash)


def pair_downwash_g(parameters: WakeParameters, rows: WakeRows) -> FloatArray:
    """Downwash of every pair, (P,) in gram-force, positive downwards."""
    w = parameters
    upper, lower = rows.pair_type, rows.ego_type[rows.pair_row]
    dz = rows.offset_m[:, 2]
    depth = np.maximum(dz, 0.0)
    lag = depth / w.advection_speed[upper]
    axis = rows.offset_m[:, :2] - rows.wake_velocity * lag[:, None]
    start = w.width_m[upper, lower]
    width = start + w.spread[upper, lower] * depth
    centre = w.amplitude_g[upper, lower] * (start / width) ** w.decay[upper, lower]
    shape = np.exp(-0.5 * np.sum(axis**2, axis=1) / width**2)
    above = 1.0 / (1.0 + np.exp(-dz / ROTOR_DEPTH_M))
    return np.asarray(rows.weight * centre * shape * above)
