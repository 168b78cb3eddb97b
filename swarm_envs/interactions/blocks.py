"""ReLU networks applied to a block of samples at once, one sample a lane.

Samples go into the columns of `Networks.x`, one to a lane; a sample gives the same bits in any
block and lane, so that what is computed together never shows.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from swarm_envs.compiled import kernel
from swarm_envs.interactions.lanes import BLOCK_BYTES, Numbers, affine
from swarm_envs.state import IntArray


class Networks(NamedTuple):
    """The networks of a deep set with scratch arrays to apply them in: small enough to pass on."""

    weights: Numbers
    """Flat weights of all networks, as in `ForceField`; scratch has their precision."""
    layout: IntArray
    """Depth, widths and offsets of each network, as in `ForceField`."""
    x: Numbers
    """(widest layer, lanes) input of a layer."""
    y: Numbers
    """(widest layer, lanes) output of a layer."""


@kernel
def networks_of(weights: Numbers, layout: IntArray) -> Networks:
    """The networks of a field, with fresh scratch arrays."""
    widest = 1
    for n in range(layout.shape[0]):
        for k in range(layout.shape[1] // 2):
            widest = max(widest, layout[n, 1 + k])
    scratch = np.empty((2, widest, BLOCK_BYTES // weights.itemsize), weights.dtype)
    return Networks(weights, layout, scratch[0], scratch[1])


@kernel
def network(nets: Networks, n: int, count: int) -> Numbers:
    """Apply ReLU network `n` to the first `count` lanes of `nets.x`.

    Returns:
        (widest layer, lanes) the outputs, one a row: `nets.x` or `nets.y`, which are both
        overwritten. Lanes from `count` on hold copies of the first.
    """
    weights, layout, x, y = nets.weights, nets.layout, nets.x, nets.y
    depth, columns = layout[n, 0], layout.shape[1] // 2
    for k in range(layout[n, 1]):
        for lane in range(count, x.shape[1]):
            x[k, lane] = x[k, 0]
    for layer in range(depth):
        inputs, outputs = layout[n, 1 + layer], layout[n, 2 + layer]
        start = layout[n, 1 + columns + layer]
        lowest = 0.0 if layer < depth - 1 else -np.inf
        affine(weights, start, inputs, outputs, x, y, lowest)
        x, y = y, x
    return x
