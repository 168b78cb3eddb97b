"""ReLU networks applied to a block of samples at once, one sample a lane.

A sample gives the same bits in any block and any lane, so what is computed together never shows.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba.extending import register_jitable

from swarm_envs.compiled import borrowing_kernel
from swarm_envs.interactions.field import ForceField
from swarm_envs.interactions.lanes import BLOCK_BYTES, Numbers, affine
from swarm_envs.interactions.window import clamp
from swarm_envs.state import BoolArray, FloatArray, IntArray


class Scratch(NamedTuple):
    """Working memory to evaluate networks for M drones at once, nothing to keep."""

    layers: Numbers
    """(2, widest layer, lanes): a network's input goes into the first, its layers take turns."""
    codes: Numbers
    """(2, M, hidden): sums over blocks, such as the input of rho."""
    place: IntArray
    """(2, lanes): to which code the sample in each lane belongs."""
    share: FloatArray
    """(lanes,): the factor with which the result in each lane counts."""
    marks: BoolArray
    """(2, M): what is known of each drone."""
    order: IntArray
    """(M,): the drones of each environment, by their index there, as last sorted along x."""
    pairs: IntArray
    """(2, P): drones `i` and `j` inside each other's interaction volume; see `find_pairs`."""
    weight: FloatArray
    """(P,): how much of the pair is left by the window."""
    found: IntArray
    """(1,): how many pairs there are."""


@register_jitable  # type: ignore[untyped-decorator]
def scratch_for(field: ForceField, total: int, drones: int) -> Scratch:
    """Working memory for a model, in the precision of its weights.

    Args:
        field: the model.
        total: M, the number of drones of all environments together.
        drones: N, the number in each.
    """
    layout = field.layout
    columns, widest = layout.shape[1] // 2, 1
    hidden = max(1, layout[0, 1 + layout[0, 0]])
    for n in range(layout.shape[0]):
        for k in range(columns):
            widest = max(widest, layout[n, 1 + k])
    lanes = BLOCK_BYTES // field.weights.itemsize
    return Scratch(
        np.zeros((2, widest, lanes), field.weights.dtype),
        np.zeros((2, total, hidden), field.weights.dtype),
        np.zeros((2, lanes), np.int64),
        np.zeros(lanes),
        np.zeros((2, total), np.bool_),
        np.arange(total) % drones,
        np.zeros((2, total * (drones - 1)), np.int64),
        np.zeros(total * (drones - 1)),
        np.zeros(1, np.int64),
    )


@borrowing_kernel
def put_pair(
    measured: FloatArray,
    position: FloatArray,
    velocity: FloatArray,
    i: int,
    j: int,
    layers: Numbers,
    lane: int,
) -> None:
    """Put p_j - p_i and v_j - v_i, in the measured range (2, 6), into a lane of `layers[0]`."""
    for k in range(3):
        apart, moving = position[j, k] - position[i, k], velocity[j, k] - velocity[i, k]
        layers[0, k, lane] = clamp(apart, measured[0, k], measured[1, k])
        layers[0, k + 3, lane] = clamp(moving, measured[0, k + 3], measured[1, k + 3])


@borrowing_kernel
def put_environment(
    measured: FloatArray, height: float, velocity: FloatArray, i: int, layers: Numbers, lane: int
) -> None:
    """Put -z and -v_i, in the measured range (2, 4), into a lane of `layers[0]`."""
    layers[0, 0, lane] = clamp(-height, measured[0, 0], measured[1, 0])
    for k in range(1, 4):
        layers[0, k, lane] = clamp(-velocity[i, k - 1], measured[0, k], measured[1, k])


@borrowing_kernel
def network(field: ForceField, n: int, count: int, layers: Numbers) -> int:
    """Apply ReLU network `n` to the first `count` lanes of `layers[0]`.

    Args:
        field: its weights and layout.
        n: row of the layout.
        count: lanes with samples; the others are filled with copies of the first.
        layers: (2, widest layer, lanes), as in `Scratch`; overwritten.

    Returns:
        Which of the two layers holds the outputs, one a row.
    """
    layout = field.layout
    depth, columns = layout[n, 0], layout.shape[1] // 2
    for k in range(layout[n, 1]):
        for lane in range(count, layers.shape[2]):
            layers[0, k, lane] = layers[0, k, 0]
    for layer in range(depth):
        inputs, outputs = layout[n, 1 + layer], layout[n, 2 + layer]
        start = layout[n, 1 + columns + layer]
        lowest = 0.0 if layer < depth - 1 else -np.inf
        x, y = layers[layer % 2], layers[1 - layer % 2]
        affine(field.weights, start, inputs, outputs, x, y, lowest)
    return depth % 2
