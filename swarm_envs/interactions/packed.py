"""Force models in the form of kernels: three arrays of the same types for every model.

Constants are in one record; networks are a list of steps (`layout`) with weights in rows of equal
size (`weights`). `Scratch` is the memory for an evaluation of the forces.
"""

from __future__ import annotations

from itertools import pairwise
from typing import NamedTuple

import numpy as np

from swarm_envs.interactions.field import (
    COMPOSED,
    DEEP_SET,
    PAIRWISE,
    UNITS_OF_OWN,
    UNITS_OF_PAIR,
    ForceField,
    Numbers,
)
from swarm_envs.neighbors import FEW
from swarm_envs.state import FloatArray, IntArray
from swarm_envs.tables import Records, aligned

__all__ = ["PackedField", "Scratch", "order_for", "scratch_for"]

MOST_TYPES = 8  # Largest number of interaction types of a model
INPUTS = 5
"""Inputs whose weights share a row; numbers of inputs are padded to a multiple of it. With more
inputs, the factors of two samples do not fit into vector registers."""
OUTPUTS = 8
"""Numbers of outputs are padded to a multiple of it, which fills vector registers, and at least to
the number of inputs of the next layer."""
WIDTH = 64
"""Outputs in a row of weights; rows of wider networks are a multiple of it."""

CONSTANTS = np.dtype(
    [
        ("kind", np.int64),
        ("hidden", np.int64),  # padded length of a code
        ("anchor_height", np.float64),
        ("anchor_motion", np.float64),  # -z at the anchor height, clamped to the measured range
        ("window", np.float64, (4,)),
        ("environment_range", np.float64, (2, 4)),
        ("pair_range", np.float64, (2, 6)),
        ("drag", np.float64, (MOST_TYPES, 3)),
        ("wake_pair", np.float64, (MOST_TYPES, MOST_TYPES, 4)),
        ("wake_delay", np.float64, (MOST_TYPES,)),
        ("wake_combine", np.float64),
        ("wake_ground", np.float64, (MOST_TYPES, 2)),
        ("wake_mitigation", np.float64, (2,)),
    ]
)
"""The constants of a model; see `ForceField`."""

PAIRS, ENVIRONMENT, CODES = 0, 1, 2
"""Inputs of a network: motions of pairs, each drone's motion, each drone's codes."""
TO_CODES, TO_FORCE, TO_PUSHES = 0, 1, 2
"""Sums to which a network's outputs are added."""
SOURCE, TARGET, OWN, NEIGHBOR, DEPTH, FIRST_LAYER = range(6)
"""Columns of a layout. `OWN` and `NEIGHBOR` are interaction types, or `ANY`."""
ANY = -1
"""Any interaction type."""
START, BLOCKS, UNITS = range(3)
"""Columns of each layer, from `FIRST_LAYER` on: its first row of weights, its number of inputs over
`INPUTS`, and its padded number of outputs."""


class PackedField(NamedTuple):
    """A force model in the form of kernels. Get one by `InteractionModel.packed`."""

    constants: Records
    """(1,) record of `CONSTANTS`."""
    layout: IntArray
    """(networks, 5 + 3 L), in the order of evaluation; columns as above."""
    weights: Records
    """Rows `v` of (INPUTS, width) numbers: for each layer one with the bias, v[0], then one for
    each `INPUTS` inputs, v[input, output]."""


def packed(field: ForceField) -> PackedField:
    """Return a force model in the form of kernels.

    Raises:
        ValueError: the model has too many types.
    """
    types = len(field.drag)
    if types > MOST_TYPES:
        raise ValueError(
            f"the force model has {types} interaction types, but must have at most {MOST_TYPES}"
        )
    constants = np.zeros(1, CONSTANTS)
    for name in CONSTANTS.names or ():
        if name not in ("hidden", "anchor_motion"):
            value = np.asarray(getattr(field, name))
            corner = tuple(slice(size) for size in value.shape)
            constants[name][(slice(1), *corner)] = value
    low, high = field.environment_range[:, 0]
    constants["anchor_motion"] = np.clip(-field.anchor_height, low, high)
    if field.kind == COMPOSED:
        constants["anchor_motion"] /= UNITS_OF_OWN[0]
    if field.kind not in (DEEP_SET, PAIRWISE, COMPOSED):
        empty = np.zeros((0, FIRST_LAYER + 3), np.int64)
        row = np.dtype([("v", np.float64, (INPUTS, WIDTH))])
        return PackedField(constants, empty, aligned(1, row))
    steps = _deep_set_steps(types) if field.kind == DEEP_SET else _steps_of_pairs(field.kind, types)
    sorted_layers = _sorted_layers(field, steps)
    networks = [_shape(field, n) for n, *_ in steps]
    width = max(WIDTH, *(max(*inputs, *units) for inputs, units in networks))
    row = np.dtype([("v", field.weights.dtype, (INPUTS, _filled(width, WIDTH)))])
    layout = np.zeros((len(steps), FIRST_LAYER + 3 * max(len(x) for x, _ in networks)), np.int64)
    parts: list[Records] = []
    for entry, (n, *step), (inputs, units) in zip(layout, steps, networks, strict=True):
        entry[:FIRST_LAYER] = *step, len(inputs)
        for layer in range(len(inputs)):
            columns = entry[FIRST_LAYER + 3 * layer :]
            columns[:3] = sum(map(len, parts)), inputs[layer] // INPUTS, units[layer]
            parts.append(_rows(*sorted_layers[n][layer], row))
    constants["hidden"] = networks[0][1][-1]
    weights = aligned(sum(map(len, parts)), row)
    weights[:] = np.concatenate(parts)
    return PackedField(constants, layout, weights)


def _filled(count: int, multiple: int) -> int:
    """Return a count rounded up to a multiple."""
    return -(-count // multiple) * multiple


def widths_of(field: ForceField, n: int) -> list[int]:
    """Return the number of inputs of network `n`, then of outputs of each of its layers."""
    widths: list[int] = field.layout[n, 1 : 2 + field.layout[n, 0]].tolist()
    return widths


def _shape(field: ForceField, n: int) -> tuple[list[int], list[int]]:
    """Return the padded numbers of inputs and outputs of each layer of network `n`."""
    widths = widths_of(field, n)
    inputs = [_filled(width, INPUTS) for width in widths]  # the last one as if a layer followed
    units = [_filled(max(w, i), OUTPUTS) for w, i in zip(widths[1:], inputs[1:], strict=True)]
    return inputs[:-1], units


def _deep_set_steps(types: int) -> list[tuple[int, int, int, int, int]]:
    """Return network, source, target, own and neighbor's type of each step of a deep set."""
    return [
        *((k, PAIRS, TO_CODES, ANY, k) for k in range(types)),
        (types, ENVIRONMENT, TO_CODES, ANY, ANY),
        *((types + 1 + k, CODES, TO_FORCE, k, ANY) for k in range(types)),
    ]


def _steps_of_pairs(kind: int, types: int) -> list[tuple[int, int, int, int, int]]:
    """Return the steps of a pairwise sum or a composed model, as `_deep_set_steps` does."""
    steps, target = [], TO_PUSHES if kind == COMPOSED else TO_FORCE
    for own in range(types):
        steps.append((types * types + own, ENVIRONMENT, TO_FORCE, own, ANY))
        steps += [(k * types + own, PAIRS, target, own, k) for k in range(types)]
    return steps


def _rows(matrix: Numbers, bias: Numbers, row: np.dtype[np.void]) -> Records:
    """Return the rows of a layer with this matrix (inputs, outputs): the bias, then the weights."""
    inputs, outputs = matrix.shape
    rows = np.zeros(1 + -(-inputs // INPUTS), row)
    rows["v"][0, 0, :outputs] = bias
    rows["v"][1:].reshape(-1, rows["v"].shape[2])[:inputs, :outputs] = matrix
    return rows


def _sorted_layers(
    field: ForceField, steps: list[tuple[int, int, int, int, int]]
) -> dict[int, list[tuple[Numbers, Numbers]]]:
    """Return matrix and bias of each layer by network, with hidden units sorted by activity.

    In the shipped model six of ten units are inactive at a time. When they are adjacent, whole rows
    of weights are skipped. Their frequency of activity is estimated by samples of the measured
    range.
    """
    rng, found = np.random.default_rng(0), {}
    codes: list[Numbers] = []
    motions = {
        PAIRS: _samples(rng, field.pair_range),
        ENVIRONMENT: _samples(rng, field.environment_range),
    }
    if field.kind == COMPOSED:
        motions = {
            PAIRS: motions[PAIRS][:, :5] / UNITS_OF_PAIR,
            ENVIRONMENT: motions[ENVIRONMENT][:, :3] / UNITS_OF_OWN,
        }
    for n, source, target, *_ in steps:
        if source == CODES:  # those of a lone drone, and of one with a neighbor of each type
            x = np.concatenate([codes[-1], *(codes[-1] + code for code in codes[:-1])])
        else:
            x = motions[source]
        found[n] = layers = layers_of(field, n)
        for (matrix, bias), (following, _) in pairwise(layers):
            x = np.maximum(x @ matrix + bias, 0.0)
            order = np.argsort(-np.count_nonzero(x, axis=0), kind="stable")
            x, bias[:] = x[:, order], bias[order]
            matrix[:], following[:] = matrix[:, order], following[order]
        if target == TO_CODES:
            codes.append(x @ layers[-1][0] + layers[-1][1])
    return found


def layers_of(field: ForceField, n: int) -> list[tuple[Numbers, Numbers]]:
    """Return copies of matrix (inputs, outputs) and bias of each layer of network `n`."""
    starts, layers = field.layout[n, field.layout.shape[1] // 2 + 1 :], []
    for (inputs, outputs), start in zip(pairwise(widths_of(field, n)), starts.tolist()):
        bias = start + inputs * outputs
        matrix = field.weights[start:bias].reshape(inputs, outputs)
        layers.append((matrix.copy(), field.weights[bias : bias + outputs].copy()))
    return layers


def _samples(rng: np.random.Generator, measured: FloatArray) -> FloatArray:
    """Return samples (S, inputs) of a measured range, clipped to 2 m and 2 m/s."""
    low, high = np.clip(measured, -2.0, 2.0)
    samples: FloatArray = rng.uniform(low, high, (100, len(low)))
    return samples


CHUNK = 128
"""Drones whose forces are evaluated together: they fill blocks, and fit into the cache."""
SAMPLES = 32  # Samples to which a network is applied at once

DRONE = np.dtype(
    [
        ("position", np.float64, (3,)),  # of the evaluation of the force, m; must be the first
        ("velocity", np.float64, (3,)),  # m/s, world frame
        ("force", np.float64, (3,)),  # N, world frame
        ("motion", np.float64, (4,)),  # -z and -v, clamped to the measured range
        ("type", np.int64),  # interaction type
        ("outside", np.int64),  # 1 if the force is extrapolated beyond the measured range
        ("low", np.int64),  # 1 if there is a ground effect
        ("affected", np.int64),  # 1 if networks contribute to the force
        ("pushed", np.float64),  # sum of all p_ij^q
        ("pairs", np.float64, (3,)),  # sums of horizontal forces of pairs, x and y, and of p_ij
        ("seen", np.float64, (3,)),  # position of the center, m
    ],
    align=True,
)
"""A drone of the chunk. The caller sets type, position and velocity."""
PAIR = np.dtype(
    [
        ("i", np.int64),
        ("j", np.int64),
        ("weight", np.float64),  # weight of the window
        ("motion", np.float64, (6,)),  # p_j - p_i and v_j - v_i, clamped to the measured range
        ("wake", np.float64),  # downwash of j's wake in closed form, N
        ("towards", np.float64, (2,)),  # horizontal unit vector to j's axis, shorter near it
    ],
    align=True,
)
"""A pair: drone `j` exerts a force on drone `i`."""
COUNTERS = np.dtype(
    [
        ("pairs", np.int64),  # number of pairs
        ("affected", np.int64),  # number of drones in `Scratch.affected`
        ("used", np.int64),  # number of samples in the rows
        ("x", np.float64, (CHUNK,)),  # m: first drones of all environments, then second ones etc.
        ("y", np.float64, (CHUNK,)),
        ("z", np.float64, (CHUNK,)),
        ("near", np.int64, (CHUNK,)),  # 1 if a pair is inside the interaction volume
        ("slot", np.int64, (SAMPLES,)),  # index 2 i + part of the sum to which a sample is added
        ("share", np.float64, (SAMPLES,)),  # factor of the sample
        ("pair", np.int64, (SAMPLES,)),  # index of the sample's pair, if it has one
    ],
    align=True,
)
"""Counters and lists of one evaluation."""


class Scratch(NamedTuple):
    """Scratch memory for C environments of N drones, M = C N, one environment after another."""

    drones: Records
    """(M,) records of `DRONE`."""
    columns: FloatArray
    """(M, 24) the memory of the drones as floats; the first three are the position."""
    affected: IntArray
    """(M,) the drones with forces besides drag."""
    pairs: Records
    """(P,) records of `PAIR`."""
    counters: Records
    """(1,) records of `COUNTERS`."""
    rows: Records
    """Rows `v` of (2, width) numbers in the model's precision, each with two samples: `SAMPLES` / 2
    for the inputs of a layer, as many for its outputs, then one for the codes of each drone, in its
    state and alone at the anchor height."""


def scratch_for(field: PackedField, count: int, drones: int) -> Scratch:
    """Return scratch memory to evaluate forces in up to `count` environments of `drones` at once.

    Raises:
        ValueError: these are too many drones.
    """
    total = count * drones
    if drones <= FEW and total > CHUNK:
        raise ValueError(
            f"{count} environments have {total} drones together, but must be at most {CHUNK}"
        )
    memory = np.zeros(total, DRONE)
    number, shape = field.weights.dtype["v"].subdtype or (np.dtype(np.float64), (1, 1))
    row = np.dtype([("v", number, (2, shape[1]))])
    return Scratch(
        memory,
        memory.view(np.float64).reshape(total, -1),
        np.zeros(total, np.int64),
        np.zeros(max(1, total * (drones - 1)), PAIR),
        np.zeros(1, COUNTERS),
        aligned(SAMPLES + total, row),
    )


def order_for(count: int, drones: int) -> IntArray:
    """Return the memory (2, M) in which `find_pairs` sorts the drones of large teams along x.

    The first row has the drones of each environment as last sorted.
    """
    order = np.empty((2, count * drones), np.int64)
    order[:] = np.arange(count * drones) % max(1, drones)
    return order
