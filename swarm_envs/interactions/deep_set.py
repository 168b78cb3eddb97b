"""`learned`: heterogeneous deep sets (Neural-Swarm2, eq. 10), evaluated without torch.

The vertical force on drone i, in grams, is

    rho_I(i)( phi_env(-z, -v) + sum_j w_ij phi_I(j)(p_j - p_i, v_j - v_i) ),

with ReLU networks phi and rho and the window w of the interaction volume. An *anchored* model
subtracts rho_I(i)(phi_env) of a lone drone at the anchor height with the same velocity: above that
height a lone drone feels nothing, whatever it flies. Inputs are clamped to the measured range.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from swarm_envs.compiled import kernel
from swarm_envs.interactions.field import ForceField
from swarm_envs.interactions.window import clamp, pair_weight
from swarm_envs.state import FloatArray, IntArray
from swarm_envs.vehicles import GRAM_FORCE


class Networks(NamedTuple):
    """The networks of a deep set with scratch arrays to apply them in: small enough to pass on."""

    weights: FloatArray
    """Flat weights of all networks, as in `ForceField`."""
    layout: IntArray
    """Depth, widths and offsets of each network, as in `ForceField`."""
    x: FloatArray
    """Input of a layer; as long as the widest."""
    y: FloatArray
    """Output of a layer; as long as the widest."""
    active: IntArray
    """Which inputs are not zero; one longer."""


@kernel
def networks_of(field: ForceField) -> Networks:
    """The field's networks, with fresh scratch arrays."""
    layout, widest = field.layout, 1
    for n in range(layout.shape[0]):
        for k in range(layout.shape[1] // 2):
            widest = max(widest, layout[n, 1 + k])
    x, y = np.empty(widest), np.empty(widest)
    return Networks(field.weights, layout, x, y, np.empty(widest + 1, dtype=np.int64))


@kernel
def network(nets: Networks, n: int) -> FloatArray:
    """Apply ReLU network `n` to the input in `nets.x`; the array returned is `x` or `y`."""
    weights, layout, x, y, active = nets.weights, nets.layout, nets.x, nets.y, nets.active
    depth, columns = layout[n, 0], layout.shape[1] // 2
    for layer in range(depth):
        inputs, outputs = layout[n, 1 + layer], layout[n, 2 + layer]
        start = layout[n, 1 + columns + layer]
        affine(weights, start, inputs, outputs, x, y, active)
        if layer < depth - 1:
            for o in range(outputs):
                y[o] = max(y[o], 0.0)
        x, y = y, x
    return x


@kernel
def affine(
    weights: FloatArray,
    start: int,
    inputs: int,
    outputs: int,
    x: FloatArray,
    y: FloatArray,
    active: IntArray,
) -> None:
    """Write W x + b into `y`, W and b lying at `start` of the flat weights.

    Half of all inputs are zero after a ReLU: the others are listed first (without a branch) and
    taken two at a time, which halves the time of a plain loop. The order of the sum depends on the
    input alone, never on what else is computed.
    """
    count = 0
    for i in range(inputs):
        active[count] = i
        count += x[i] != 0.0
    bias = start + inputs * outputs
    for o in range(outputs):
        y[o] = weights[bias + o]
    for k in range(0, count - 1, 2):
        i, j = active[k], active[k + 1]
        first, second, a, b = start + i * outputs, start + j * outputs, x[i], x[j]
        for o in range(outputs):
            y[o] = (y[o] + weights[first + o] * a) + weights[second + o] * b
    if count % 2:
        i = active[count - 1]
        last, a = start + i * outputs, x[i]
        for o in range(outputs):
            y[o] += weights[last + o] * a


@kernel
def environment_code(
    nets: Networks,
    measured: FloatArray,
    height: float,
    velocity: FloatArray,
    i: int,
    code: FloatArray,
) -> None:
    """Write phi_env of drone `i` at `height` (m), with its row of `velocity`, into `code`."""
    x = nets.x
    x[0] = clamp(-height, measured[0, 0], measured[1, 0])
    for k in range(3):
        x[k + 1] = clamp(-velocity[i, k], measured[0, k + 1], measured[1, k + 1])
    result = network(nets, nets.layout.shape[0] // 2)
    for k in range(code.shape[0]):
        code[k] = result[k]


@kernel
def add_neighbour(
    nets: Networks,
    measured: FloatArray,
    kind: int,
    weight: float,
    relative: FloatArray,
    code: FloatArray,
) -> None:
    """Add `weight` times phi of a neighbour of type `kind` at `relative` (6,) to `code`."""
    x = nets.x
    for k in range(6):
        x[k] = clamp(relative[k], measured[0, k], measured[1, k])
    result = network(nets, kind)
    for k in range(code.shape[0]):
        code[k] += weight * result[k]


@kernel
def output_force(nets: Networks, kind: int, code: FloatArray) -> float:
    """Rho of a drone of type `kind` at the summed `code`: its vertical force, N."""
    x = nets.x
    for k in range(code.shape[0]):
        x[k] = code[k]
    return network(nets, nets.layout.shape[0] // 2 + 1 + kind)[0] * GRAM_FORCE


@kernel
def deep_set_forces(
    field: ForceField,
    types: IntArray,
    position: FloatArray,
    velocity: FloatArray,
    out: FloatArray,
) -> None:
    """Add the network's vertical forces on N drones of one environment to `out`.

    Args:
        field: the model.
        types: (N,) interaction types.
        position: (N, 3) m.
        velocity: (N, 3) m/s.
        out: (N, 3) forces, N, world frame.
    """
    nets = networks_of(field)
    hidden = nets.layout[0, 1 + nets.layout[0, 0]]
    code, free, relative = np.empty(hidden), np.empty(hidden), np.empty(6)
    anchor, window = field.anchor_height, field.window
    own_range, pair_range = field.environment_range, field.pair_range
    for i in range(position.shape[0]):
        low = anchor == 0.0 or position[i, 2] < anchor
        started = low
        if low:
            environment_code(nets, own_range, position[i, 2], velocity, i, code)
        for j in range(position.shape[0]):
            relative[0] = position[j, 0] - position[i, 0]
            if j == i or abs(relative[0]) >= window[1]:
                continue
            relative[1] = position[j, 1] - position[i, 1]
            relative[2] = position[j, 2] - position[i, 2]
            weight = pair_weight(window, relative[0], relative[1], relative[2])
            if weight > 0.0:
                if not started:
                    environment_code(nets, own_range, anchor, velocity, i, code)
                    for k in range(hidden):
                        free[k] = code[k]
                    started = True
                for k in range(3):
                    relative[k + 3] = velocity[j, k] - velocity[i, k]
                add_neighbour(nets, pair_range, types[j], weight, relative, code)
        if started:
            out[i, 2] += output_force(nets, types[i], code)
            if anchor > 0.0:
                if low:
                    environment_code(nets, own_range, anchor, velocity, i, free)
                out[i, 2] -= output_force(nets, types[i], free)
