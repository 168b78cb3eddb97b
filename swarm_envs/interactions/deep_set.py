"""`learned`: heterogeneous deep sets (Neural-Swarm2, eq. 10), evaluated without torch.

The vertical force on drone i, in grams, is

    rho_I(i)( phi_env(-z, -v) + sum_j w_ij phi_I(j)(p_j - p_i, v_j - v_i) ),

with ReLU networks phi and rho and the window w of the interaction volume. An *anchored* model
subtracts rho_I(i)(phi_env) of a lone drone at the anchor height with the same velocity: above that
height a lone drone feels nothing, whatever it flies. Inputs are clamped to the measured range.

Each network is applied to all drones or pairs that need it, a block at a time. Several environments
may be given at once, their M drones one after the other: blocks are then fuller.
"""

from __future__ import annotations

from swarm_envs.compiled import borrowing_kernel
from swarm_envs.interactions.blocks import Scratch, network, put_environment, put_pair
from swarm_envs.interactions.field import ForceField
from swarm_envs.state import FloatArray, IntArray
from swarm_envs.vehicles import GRAM_FORCE

NEAR, FREE = 0, 1
"""A drone's two codes, the inputs of rho: as it flies, and alone at the anchor height."""
LOW, FELT = 0, 1
"""Marks of a drone: it feels the ground; it feels anything at all (else its force is exactly 0)."""


@borrowing_kernel
def begin(field: ForceField, position: FloatArray, scratch: Scratch) -> None:
    """Set the codes of M drones at (M, 3) m to zero and mark those that are low."""
    anchor, codes, marks = field.anchor_height, scratch.codes, scratch.marks
    for i in range(position.shape[0]):
        marks[LOW, i] = marks[FELT, i] = anchor == 0.0 or position[i, 2] < anchor
        for k in range(codes.shape[2]):
            codes[NEAR, i, k] = codes[FREE, i, k] = 0.0


@borrowing_kernel
def add_block(field: ForceField, n: int, count: int, scratch: Scratch) -> None:
    """Apply network `n` to `count` lanes and add each result, times its share, to its code."""
    layers, codes, place, share = scratch.layers, scratch.codes, scratch.place, scratch.share
    result = network(field, n, count, layers)
    hidden = field.layout[n, 1 + field.layout[n, 0]]
    for lane in range(count):
        part, i, weight = place[0, lane], place[1, lane], share[lane]
        for k in range(hidden):
            codes[part, i, k] += weight * layers[result, k, lane]


@borrowing_kernel
def add_neighbours(
    field: ForceField,
    types: IntArray,
    position: FloatArray,
    velocity: FloatArray,
    scratch: Scratch,
) -> None:
    """Add phi of all pairs that were found to the codes, by the neighbour's type."""
    pairs, layers = scratch.pairs, scratch.layers
    lanes = layers.shape[2]
    for kind in range(field.layout.shape[0] // 2):
        count = 0
        for pair in range(scratch.found[0]):
            i, j = pairs[0, pair], pairs[1, pair]
            if types[j] != kind:
                continue
            lane = count % lanes
            put_pair(field.pair_range, position, velocity, i, j, layers, lane)
            scratch.place[0, lane], scratch.place[1, lane] = NEAR, i
            scratch.share[lane] = scratch.weight[pair]
            scratch.marks[FELT, i] = True
            count += 1
            if count % lanes == 0:
                add_block(field, kind, lanes, scratch)
        if count % lanes:
            add_block(field, kind, count % lanes, scratch)


@borrowing_kernel
def add_environment(
    field: ForceField, position: FloatArray, velocity: FloatArray, scratch: Scratch
) -> None:
    """Add phi_env of every drone that feels something: where it flies, and at the anchor height."""
    anchor, layers = field.anchor_height, scratch.layers
    codes, marks = scratch.codes, scratch.marks
    n, lanes, count = field.layout.shape[0] // 2, layers.shape[2], 0
    for i in range(position.shape[0]):
        for part in range(NEAR, FREE + 1):
            wanted = anchor > 0.0 if part == FREE else marks[LOW, i]
            if not (marks[FELT, i] and wanted):
                continue
            lane = count % lanes
            height = anchor if part == FREE else position[i, 2]
            put_environment(field.environment_range, height, velocity, i, layers, lane)
            scratch.place[0, lane], scratch.place[1, lane] = part, i
            scratch.share[lane] = 1.0
            count += 1
            if count % lanes == 0:
                add_block(field, n, lanes, scratch)
    if count % lanes:
        add_block(field, n, count % lanes, scratch)
    for i in range(position.shape[0]):
        if marks[FELT, i] and not marks[LOW, i]:
            for k in range(codes.shape[2]):
                codes[NEAR, i, k] += codes[FREE, i, k]


@borrowing_kernel
def add_output_block(
    field: ForceField, n: int, count: int, scratch: Scratch, out: FloatArray
) -> None:
    """Apply rho, network `n`, to `count` lanes; what a lone drone would feel is subtracted."""
    layers, place = scratch.layers, scratch.place
    result = network(field, n, count, layers)
    for lane in range(count):
        force = layers[result, 0, lane] * GRAM_FORCE
        out[place[1, lane], 2] += force if place[0, lane] == NEAR else -force


@borrowing_kernel
def add_outputs(field: ForceField, types: IntArray, scratch: Scratch, out: FloatArray) -> None:
    """Add rho of every drone's codes, in newton, to the vertical part of `out` (M, 3)."""
    layers, codes, half = scratch.layers, scratch.codes, field.layout.shape[0] // 2
    lanes, parts = layers.shape[2], 2 if field.anchor_height > 0.0 else 1
    for kind in range(half):
        n, count = half + 1 + kind, 0
        for i in range(types.shape[0]):
            if types[i] != kind or not scratch.marks[FELT, i]:
                continue
            for part in range(parts):
                lane = count % lanes
                for k in range(field.layout[n, 1]):
                    layers[0, k, lane] = codes[part, i, k]
                scratch.place[0, lane], scratch.place[1, lane] = part, i
                count += 1
                if count % lanes == 0:
                    add_output_block(field, n, lanes, scratch, out)
        if count % lanes:
            add_output_block(field, n, count % lanes, scratch, out)


@borrowing_kernel
def deep_set_forces(
    field: ForceField,
    types: IntArray,
    position: FloatArray,
    velocity: FloatArray,
    scratch: Scratch,
    out: FloatArray,
) -> None:
    """Add the network's vertical forces on M drones to `out`.

    Args:
        field: the model.
        types: (M,) interaction types.
        position: (M, 3) m.
        velocity: (M, 3) m/s.
        scratch: working memory for M drones, which knows their pairs.
        out: (M, 3) forces, N, world frame.
    """
    begin(field, position, scratch)
    add_neighbours(field, types, position, velocity, scratch)
    add_environment(field, position, velocity, scratch)
    add_outputs(field, types, scratch, out)
