"""`learned`: heterogeneous deep sets (Neural-Swarm2, eq. 10), evaluated without torch.

The vertical force on drone i, in grams, is

    rho_I(i)( phi_env(-z, -v) + sum_j w_ij phi_I(j)(p_j - p_i, v_j - v_i) ),

with ReLU networks phi and rho and the window w of the interaction volume. An *anchored* model
subtracts rho_I(i)(phi_env) of a lone drone at the anchor height with the same velocity: above that
height a lone drone feels nothing, whatever it flies. Inputs are clamped to the measured range.

Each network is applied to all drones or pairs of an environment that need it, a block at a time.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from swarm_envs.compiled import kernel
from swarm_envs.interactions.blocks import Networks, network, networks_of
from swarm_envs.interactions.field import ForceField
from swarm_envs.interactions.lanes import Numbers
from swarm_envs.interactions.window import clamp, pair_weight
from swarm_envs.state import BoolArray, FloatArray, IntArray
from swarm_envs.vehicles import GRAM_FORCE

NEAR, FREE = 0, 1
"""A drone's two codes: as it flies, and alone at the anchor height."""


class Codes(NamedTuple):
    """Inputs of rho, for the N drones of one environment."""

    value: Numbers
    """(2, N, hidden) the codes NEAR and FREE."""
    low: BoolArray
    """(N,) whether the ground is felt: below the anchor height, or the model is not anchored."""
    felt: BoolArray
    """(N,) whether anything is felt; without, the force is exactly zero."""
    drone: IntArray
    """(lanes,) whose sample is in each lane."""
    part: IntArray
    """(lanes,) to which of its codes that sample belongs."""
    share: FloatArray
    """(lanes,) weight of the pair in each lane."""


@kernel
def empty_codes(nets: Networks, anchor: float, position: FloatArray) -> Codes:
    """Codes of zero, for drones at (N, 3) m of which none has met another yet."""
    drones, lanes = position.shape[0], nets.x.shape[1]
    hidden = nets.layout[0, 1 + nets.layout[0, 0]]
    value = np.zeros((2, drones, hidden), nets.x.dtype)
    low, felt = np.empty(drones, np.bool_), np.empty(drones, np.bool_)
    for i in range(drones):
        low[i] = felt[i] = anchor == 0.0 or position[i, 2] < anchor
    index = np.empty((2, lanes), np.int64)
    return Codes(value, low, felt, index[0], index[1], np.empty(lanes))


@kernel
def add_block(nets: Networks, n: int, count: int, codes: Codes) -> None:
    """Apply network `n` to `count` lanes and add each result, times its share, to its code."""
    result = network(nets, n, count)
    for lane in range(count):
        code = codes.value[codes.part[lane], codes.drone[lane]]
        for k in range(code.shape[0]):
            code[k] += codes.share[lane] * result[k, lane]


@kernel
def add_neighbours(
    nets: Networks,
    field: ForceField,
    types: IntArray,
    position: FloatArray,
    velocity: FloatArray,
    codes: Codes,
) -> None:
    """Add phi of all pairs inside the interaction volume, by the neighbour's type."""
    measured, window, x = field.pair_range, field.window, nets.x
    for kind in range(nets.layout.shape[0] // 2):
        lane = 0
        for i in range(position.shape[0]):
            for j in range(position.shape[0]):
                dx = position[j, 0] - position[i, 0]
                if j == i or types[j] != kind or abs(dx) >= window[1]:
                    continue
                dy, dz = position[j, 1] - position[i, 1], position[j, 2] - position[i, 2]
                weight = pair_weight(window, dx, dy, dz)
                if weight > 0.0:
                    for k in range(3):
                        offset = position[j, k] - position[i, k]
                        speed = velocity[j, k] - velocity[i, k]
                        x[k, lane] = clamp(offset, measured[0, k], measured[1, k])
                        x[k + 3, lane] = clamp(speed, measured[0, k + 3], measured[1, k + 3])
                    codes.drone[lane], codes.part[lane], codes.share[lane] = i, NEAR, weight
                    codes.felt[i] = True
                    lane += 1
                    if lane == x.shape[1]:
                        add_block(nets, kind, lane, codes)
                        lane = 0
        if lane > 0:
            add_block(nets, kind, lane, codes)


@kernel
def add_environment(
    nets: Networks,
    field: ForceField,
    position: FloatArray,
    velocity: FloatArray,
    codes: Codes,
) -> None:
    """Add phi_env of every drone that feels something: where it flies, and at the anchor height."""
    measured, anchor, x = field.environment_range, field.anchor_height, nets.x
    n = nets.layout.shape[0] // 2
    lane = 0
    for i in range(position.shape[0]):
        for part in range(NEAR, FREE + 1):
            if not codes.felt[i] or (anchor == 0.0 if part == FREE else not codes.low[i]):
                continue
            height = anchor if part == FREE else position[i, 2]
            x[0, lane] = clamp(-height, measured[0, 0], measured[1, 0])
            for k in range(3):
                x[k + 1, lane] = clamp(-velocity[i, k], measured[0, k + 1], measured[1, k + 1])
            codes.drone[lane], codes.part[lane], codes.share[lane] = i, part, 1.0
            lane += 1
            if lane == x.shape[1]:
                add_block(nets, n, lane, codes)
                lane = 0
    if lane > 0:
        add_block(nets, n, lane, codes)
    for i in range(position.shape[0]):
        if codes.felt[i] and not codes.low[i]:
            for k in range(codes.value.shape[2]):
                codes.value[NEAR, i, k] += codes.value[FREE, i, k]


@kernel
def add_output_block(nets: Networks, kind: int, count: int, codes: Codes, out: FloatArray) -> None:
    """Apply rho of type `kind` to `count` lanes; what a lone drone would feel is subtracted."""
    result = network(nets, nets.layout.shape[0] // 2 + 1 + kind, count)
    for lane in range(count):
        force = result[0, lane] * GRAM_FORCE
        out[codes.drone[lane], 2] += force if codes.part[lane] == NEAR else -force


@kernel
def add_outputs(
    nets: Networks, types: IntArray, anchored: bool, codes: Codes, out: FloatArray
) -> None:
    """Add rho of every drone's codes, in newton, to the vertical part of `out` (N, 3)."""
    x = nets.x
    for kind in range(nets.layout.shape[0] // 2):
        lane = 0
        for i in range(types.shape[0]):
            if types[i] != kind or not codes.felt[i]:
                continue
            for part in range(FREE + 1 if anchored else FREE):
                for k in range(codes.value.shape[2]):
                    x[k, lane] = codes.value[part, i, k]
                codes.drone[lane], codes.part[lane] = i, part
                lane += 1
                if lane == x.shape[1]:
                    add_output_block(nets, kind, lane, codes, out)
                    lane = 0
        if lane > 0:
            add_output_block(nets, kind, lane, codes, out)


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
    nets = networks_of(field.weights, field.layout)
    codes = empty_codes(nets, field.anchor_height, position)
    add_neighbours(nets, field, types, position, velocity, codes)
    add_environment(nets, field, position, velocity, codes)
    add_outputs(nets, types, field.anchor_height > 0.0, codes, out)
