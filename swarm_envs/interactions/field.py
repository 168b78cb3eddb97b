"""The parameters of force models.

One class serves every kind of model; unused fields have defaults. Kernels read them in the form of
`swarm_envs.interactions.packed.PackedField`.
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
"""Kinds of force models in kernels."""

LATERAL_REACH = 0.35
"""Half width of the interaction volume in x and y, m (Neural-Swarm2's filter)."""
VERTICAL_REACH = 1.1
"""Half height of the interaction volume, m."""
INTERACTION_VOLUME = np.array([LATERAL_REACH, LATERAL_REACH, VERTICAL_REACH])
"""Half edges of the interaction volume, m."""
LATERAL_FADE = 0.1  # Width of the outer part of the volume in which a pair's force fades, m
VERTICAL_FADE = 0.3  # Height of this part, m

ONSET = 0.03
"""Scale of the logistic function of depth by which wakes begin, m."""
LOWEST_HEIGHT = 0.07
"""Lowest measured height, m; below it, ground effects are constant."""

UNITS_OF_PAIR = (0.2, 0.5, 0.5, 0.5, 0.5)
"""Scales of a composed model's network inputs r, dz (m), v_r, v_t and v_dz (m/s) of a pair."""
UNITS_OF_OWN = (0.2, 0.5, 0.5)
"""Scales of a composed model's network inputs -z (m), |v_xy| and -v_z (m/s) of a lone drone."""

NO_LIMIT = 1e30  # Used instead of infinity, so that arithmetic on it stays finite


class ForceField(NamedTuple):
    """The parameters of a force model with K interaction types. SI units unless stated."""

    kind: int
    """NONE, WAKE, DEEP_SET (a deep set), PAIRWISE or COMPOSED."""
    drag: FloatArray
    """(K, 3) linear drag coefficients c, N s/m: the force is -c v."""
    window: FloatArray
    """(4,) distances of the pair window at which a pair's force begins to fade, and is 0: two
    lateral and two vertical ones, m."""
    environment_range: FloatArray
    """(2, 4) measured range of (-z, -v): m and m/s."""
    pair_range: FloatArray
    """(2, 6) measured range of (p_j - p_i, v_j - v_i): m and m/s."""
    wake_pair: FloatArray
    """(K, K, 4) A (N), w0 (m), spread S, exponent p by [type of the upper, type of the lower]."""
    wake_delay: FloatArray
    """(K,) delay of the wake per depth, s/m, by type of the upper drone; also in composed models,
    as `wake_combine` and `wake_mitigation`."""
    wake_combine: float
    """Exponent q of the norm that combines several wakes; above 1 it is less than their sum."""
    wake_ground: FloatArray
    """(K, 2) ground effect at 0.07 m (N) and its decay height (m), by type."""
    wake_mitigation: FloatArray
    """(2,) share of downwash lost at the ground, and its decay height (m)."""
    weights: Numbers
    """Flat weights: for each layer the transposed matrix (in, out), then the bias (out). Their
    precision is that of the networks' evaluation."""
    layout: IntArray
    """(networks, 2 L + 2): depth, the L + 1 widths, the L indices in `weights` at which the layers
    begin. A deep set has 2 K + 1 networks: phi of each type, phi of the environment, rho of each
    type. A pairwise sum or a composed model has K (K + 1): those of pairs, [neighbor, drone] in
    rows, and those of the types' environment."""
    anchor_height: float
    """Height from which the force on a lone drone is only drag, m; 0 if the model is not
    anchored."""


@equation
def fade_weight(distance: float, full: float, end: float) -> float:
    """Return a weight by distance, m: 1 up to `full`, 0 from `end` on, a quintic smoothstep."""
    if distance >= end:
        return 0.0
    if not distance <= full:
        u = (distance - full) / (end - full)
        return max(1.0 - u * u * u * (10.0 + u * (6.0 * u - 15.0)), 0.0)  # rounding at the edge
    return 1.0


def default_window() -> FloatArray:
    """Return the default pair window, m."""
    return np.array(
        [
            LATERAL_REACH - LATERAL_FADE,
            LATERAL_REACH,
            VERTICAL_REACH - VERTICAL_FADE,
            VERTICAL_REACH,
        ]
    )


def unlimited(width: int) -> FloatArray:
    """Return an input range (2, width) without limits."""
    return np.array([[-NO_LIMIT] * width, [NO_LIMIT] * width])


def empty_field(num_types: int) -> ForceField:
    """Return the parameters of a model without forces, as defaults of other models."""
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
