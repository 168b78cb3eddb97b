"""A force model as numbers.

One class serves every kind of model. A model leaves what it does not use at its default. What
compiled kernels read of it is its `swarm_envs.interactions.packed.PackedField`.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from swarm_envs.compiled import equation
from swarm_envs.state import FloatArray, IntArray

__all__ = [
    "DEEP_SET",
    "INTERACTION_VOLUME",
    "LATERAL_REACH",
    "LOWEST_HEIGHT",
    "ONSET",
    "UNITS_OF_OWN",
    "UNITS_OF_PAIR",
    "VERTICAL_REACH",
    "ForceField",
    "Numbers",
]

Numbers = npt.NDArray[np.floating[Any]]
"""Weights: float64, or float32 for speed."""

NONE, WAKE, DEEP_SET, PAIRWISE, COMPOSED = 0, 1, 2, 3, 4
"""Kinds of force model, as kernels tell them apart."""

LATERAL_REACH = 0.35
"""Half width of the interaction volume in x and y, m (Neural-Swarm2's filter)."""
VERTICAL_REACH = 1.1
"""Half height of the interaction volume, m."""
INTERACTION_VOLUME = np.array([LATERAL_REACH, LATERAL_REACH, VERTICAL_REACH])
"""Half edges of the interaction volume, m."""
LATERAL_FADE = 0.1  # The outer part of the lateral reach over which a pair's contribution fades, m
VERTICAL_FADE = 0.3
"""The outer part of the vertical reach over which a pair's contribution fades, m."""

ONSET = 0.03
"""Depth over which a drone at another's height comes to be below it, m: the scale of a logistic."""
LOWEST_HEIGHT = 0.07
"""Nothing was measured below this height, m: air near the ground is taken as it is there."""

UNITS_OF_PAIR = (0.2, 0.5, 0.5, 0.5, 0.5)
"""What a composed model counts a pair's r, dz (m), v_r, v_t and v_dz (m/s) in, in its networks."""
UNITS_OF_OWN = (0.2, 0.5, 0.5)
"""The same of a lone drone's -z (m), |v_xy| and -v_z (m/s)."""

NO_LIMIT = 1e30  # Stands for infinity in input ranges, so that arithmetic on it stays finite


class ForceField(NamedTuple):
    """Numbers of a force model over K interaction types. SI units unless said."""

    kind: int
    """NONE, WAKE, DEEP_SET (a deep set), PAIRWISE or COMPOSED."""
    drag: FloatArray
    """(K, 3) linear drag coefficients c of a lone drone, N s/m: force -c v."""
    window: FloatArray
    """(4,) lateral full and end, vertical full and end of the fading pair window, m."""
    environment_range: FloatArray
    """(2, 4) measured range of (-z, -v): m and m/s."""
    pair_range: FloatArray
    """(2, 6) measured range of (p_j - p_i, v_j - v_i): m and m/s."""
    wake_pair: FloatArray
    """(K, K, 4) A (N), w0 (m), spread S, exponent p by [type of the upper, type of the lower]."""
    wake_delay: FloatArray
    """(K,) seconds per metre by which a drone's wake trails behind it, by the upper type; of a
    composed model too, as the next and the mitigation."""
    wake_combine: float
    """Exponent q of the norm that sums several wakes; above 1 they give less than their sum."""
    wake_ground: FloatArray
    """(K, 2) ground effect at 0.07 m (N) and its decay height (m), by type."""
    wake_mitigation: FloatArray
    """(2,) share of downwash lost at the ground, and the height over which that fades (m)."""
    weights: Numbers
    """Flat weights: per layer the transposed matrix (in, out), then the bias (out). Networks are
    evaluated in their precision."""
    layout: IntArray
    """(networks, 2 L + 2): depth, the L + 1 widths, the L places in `weights` where the layers
    begin. Of a deep set 2 K + 1: phi of each type, phi of the environment, rho of each type. Of a
    pairwise sum or a composed model K (K + 1): of the pairs, [neighbour, drone] in rows, of the
    types' environment."""
    anchor_height: float
    """Height from which a lone drone feels exactly nothing, m; 0 if the model is not anchored."""


@equation
def fade_weight(distance: float, full: float, end: float) -> float:
    """Weight by a quintic smoothstep, twice differentiable: 1 up to `full`, 0 from `end` on, m."""
    if distance >= end:
        return 0.0
    if not distance <= full:
        u = (distance - full) / (end - full)
        return max(1.0 - u * u * u * (10.0 + u * (6.0 * u - 15.0)), 0.0)  # rounding at the edge
    return 1.0


def default_window() -> FloatArray:
    """The design's window: full inside, faded to nothing at the edge of the volume, m."""
    return np.array(
        [
            LATERAL_REACH - LATERAL_FADE,
            LATERAL_REACH,
            VERTICAL_REACH - VERTICAL_FADE,
            VERTICAL_REACH,
        ]
    )


def unlimited(width: int) -> FloatArray:
    """A (2, width) input range that clamps nothing."""
    return np.array([[-NO_LIMIT] * width, [NO_LIMIT] * width])


def empty_field(num_types: int) -> ForceField:
    """A field of `num_types` types in which nothing acts: the base that models fill in."""
    return ForceField(
        kind=NONE,
        drag=np.zeros((num_types, 3)),
        window=default_window(),
        environment_range=unlimited(4),
        pair_range=unlimited(6),
        wake_pair=np.ones((num_types, num_types, 4)),
        wake_delay=np.zeros(num_types),
        wake_combine=1.0,
        wake_ground=np.ones((num_types, 2)),
        wake_mitigation=np.array([0.0, 1.0]),
        weights=np.zeros(1),
        layout=np.zeros((2 * num_types + 1, 4), dtype=np.int64),
        anchor_height=0.0,
    )
