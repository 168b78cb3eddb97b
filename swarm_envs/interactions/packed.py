"""A force model as compiled kernels read it: three arrays of the same types for every model.

All small numbers lie in one record; the networks are a list of steps (`layout`), whose weights lie
in rows of equal size (`weights`). `Scratch` is what one evaluation of the forces writes into.
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

__all__ = ["PackedField", "Scratch", "scratch_for"]

MOST_TYPES = 8  # Largest number of interaction types that a model may have
INPUTS = 5
"""Inputs whose weights share a row: numbers of inputs are filled up to a multiple of it. Of two
samples, their factors stay in vector registers; with six, those no longer suffice."""
OUTPUTS = 8
"""Numbers of outputs are filled up to a multiple of it, which fills vector registers, and at least
to the number of inputs of the next layer."""
WIDTH = 64
"""Outputs that a row of weights has room for; wider networks have rows of a multiple of it."""

CONSTANTS = np.dtype(
    [
        ("kind", np.int64),
        ("hidden", np.int64),  # numbers of a code, filled up
        ("anchor_height", np.float64),
        ("anchor_motion", np.float64),  # -z of a drone there, kept within the measured range
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
"""The small numbers of a model; what they mean says `ForceField`."""

PAIRS, ENVIRONMENT, CODES = 0, 1, 2
"""What a network is applied to: pairs of drones, each drone's own motion, each drone's codes."""
TO_CODES, TO_FORCE, TO_PUSHES = 0, 1, 2
"""Where its outputs are added."""
SOURCE, TARGET, OWN, NEIGHBOUR, DEPTH, FIRST_LAYER = range(6)
"""Columns of a layout. `OWN` and `NEIGHBOUR` are interaction types, or `ANY`."""
ANY = -1
"""Stands for every interaction type."""
START, BLOCKS, UNITS = range(3)
"""Columns of each layer, from `FIRST_LAYER` on: its first row of weights, its number of inputs over
`INPUTS`, and its number of outputs, filled up."""


class PackedField(NamedTuple):
    """What kernels read of a force model. Get one by `InteractionModel.packed`."""

    constants: Records
    """(1,) records of `CONSTANTS`."""
    layout: IntArray
    """(networks, 5 + 3 L): in the order in which they are applied; columns as above."""
    weights: Records
    """Rows `v` of (INPUTS, width) numbers: of each layer one with the bias, v[0], then one for each
    `INPUTS` inputs, v[input, output]."""


def packed(field: ForceField) -> PackedField:
    """Pack a force model."""
    types = len(field.drag)
    if types > MOST_TYPES:
        raise ValueError(
            f"the force model has {types} interaction types, but at most {MOST_TYPES} are possible"
        )
    constants = np.zeros(1, CONSTANTS)
    for name in CONSTANTS.names or ():
        if name not in ("hidden", "anchor_motion"):
            value = np.asarray(getattr(field, name))
            place = tuple(slice(size) for size in value.shape)
            constants[name][(slice(1), *place)] = value
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
    """The next multiple."""
    return -(-count // multiple) * multiple


def widths_of(field: ForceField, n: int) -> list[int]:
    """Numbers of inputs of network `n`, then of outputs of each of its layers."""
    widths: list[int] = field.layout[n, 1 : 2 + field.layout[n, 0]].tolist()
    return widths


def _shape(field: ForceField, n: int) -> tuple[list[int], list[int]]:
    """Numbers of inputs and outputs of each layer of network `n`, filled up."""
    widths = widths_of(field, n)
    inputs = [_filled(width, INPUTS) for width in widths]  # the last: as if a layer followed
    units = [_filled(max(w, i), OUTPUTS) for w, i in zip(widths[1:], inputs[1:], strict=True)]
    return inputs[:-1], units


def _deep_set_steps(types: int) -> list[tuple[int, int, int, int, int]]:
    """Network, source, target, own and neighbour's type of each step of a deep set."""
    return [
        *((k, PAIRS, TO_CODES, ANY, k) for k in range(types)),
        (types, ENVIRONMENT, TO_CODES, ANY, ANY),
        *((types + 1 + k, CODES, TO_FORCE, k, ANY) for k in range(types)),
    ]


def _steps_of_pairs(kind: int, types: int) -> list[tuple[int, int, int, int, int]]:
    """The same of a pairwise sum or a composed model."""
    steps, target = [], TO_PUSHES if kind == COMPOSED else TO_FORCE
    for own in range(types):
        steps.append((types * types + own, ENVIRONMENT, TO_FORCE, own, ANY))
        steps += [(k * types + own, PAIRS, target, own, k) for k in range(types)]
    return steps


def _rows(matrix: Numbers, bias: Numbers, row: np.dtype[np.void]) -> Records:
    """Rows of a layer with this matrix (inputs, outputs): the bias, then the weights."""
    inputs, outputs = matrix.shape
    rows = np.zeros(1 + -(-inputs // INPUTS), row)
    rows["v"][0, 0, :outputs] = bias
    rows["v"][1:].reshape(-1, rows["v"].shape[2])[:inputs, :outputs] = matrix
    return rows


def _sorted_layers(
    field: ForceField, steps: list[tuple[int, int, int, int, int]]
) -> dict[int, list[tuple[Numbers, Numbers]]]:
    """Matrix and bias of each layer by network, hidden units sorted: first those often active.

    What a unit adds does not depend on its place. In the shipped model six of ten rest at a time,
    so whole rows of weights are left out when those lie side by side. How often each is active is
    estimated by samples of the measured range.
    """
    rng, found = np.random.default_rng(0), {}
    codes: list[Numbers] = []
    motions = {
        PAIRS: _drawn(rng, field.pair_range),
        ENVIRONMENT: _drawn(rng, field.environment_range),
    }
    if field.kind == COMPOSED:
        motions = {
            PAIRS: motions[PAIRS][:, :5] / UNITS_OF_PAIR,
            ENVIRONMENT: motions[ENVIRONMENT][:, :3] / UNITS_OF_OWN,
        }
    for n, source, target, *_ in steps:
        if source == CODES:  # of a drone alone, and of one with a neighbour of each type
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
    """Matrix (inputs, outputs) and bias of each layer of network `n`, copied."""
    starts, layers = field.layout[n, field.layout.shape[1] // 2 + 1 :], []
    for (inputs, outputs), start in zip(pairwise(widths_of(field, n)), starts.tolist()):
        bias = start + inputs * outputs
        matrix = field.weights[start:bias].reshape(inputs, outputs)
        layers.append((matrix.copy(), field.weights[bias : bias + outputs].copy()))
    return layers


def _drawn(rng: np.random.Generator, measured: FloatArray) -> FloatArray:
    """Samples (S, inputs) of a measured range, or of 2 m and 2 m/s where that is wider."""
    low, high = np.clip(measured, -2.0, 2.0)
    samples: FloatArray = rng.uniform(low, high, (100, len(low)))
    return samples


CHUNK = 128
"""Drones whose forces are evaluated together: enough to fill blocks, few enough for the cache."""
SAMPLES = 32  # Samples to which a network is applied at once

DRONE = np.dtype(
    [
        ("position", np.float64, (3,)),  # m, world frame; the first of all, see `Scratch.columns`
        ("velocity", np.float64, (3,)),  # m/s, world frame
        ("force", np.float64, (3,)),  # N, world frame
        ("motion", np.float64, (4,)),  # its -z and -v, kept within what was measured
        ("type", np.int64),  # interaction type
        ("outside", np.int64),  # whether the force is an extrapolation past what was measured
        ("low", np.int64),  # whether it feels the ground
        ("felt", np.int64),  # whether it feels anything of networks; else they give exactly 0
        ("pushed", np.float64),  # sum of all wakes on it, each to the power q
        ("pairs", np.float64, (3,)),  # sum of all pushes on it: horizontally in x and y, and down
        ("seen", np.float64, (3,)),  # where the others find it, m; `position` is where it feels
    ],
    align=True,
)
"""A drone of the chunk. Its type, position and velocity are set by the caller."""
PAIR = np.dtype(
    [
        ("i", np.int64),
        ("j", np.int64),
        ("weight", np.float64),  # what the window leaves of it
        ("motion", np.float64, (6,)),  # p_j - p_i and v_j - v_i, kept within what was measured
        ("wake", np.float64),  # N: what the closed form says that j's wake pushes
        ("towards", np.float64, (2,)),  # horizontally towards the axis of j's wake, shorter near it
    ],
    align=True,
)
"""Drone `j` is felt by drone `i`."""
COUNTERS = np.dtype(
    [
        ("pairs", np.int64),  # how many there are
        ("feeling", np.int64),  # how many drones are listed in `Scratch.felt`
        ("used", np.int64),  # how many samples the rows hold
        ("x", np.float64, (CHUNK,)),  # m: of all environments' first drones, then all second
        ("y", np.float64, (CHUNK,)),
        ("z", np.float64, (CHUNK,)),
        ("near", np.int64, (CHUNK,)),  # 1 where a pair is inside the interaction volume
        ("slot", np.int64, (SAMPLES,)),  # 2 i + part: to which drone's sum a sample is added
        ("share", np.float64, (SAMPLES,)),  # with which factor
        ("pair", np.int64, (SAMPLES,)),  # of which pair, if of any
    ],
    align=True,
)
"""Counters and lists of one evaluation."""


class Scratch(NamedTuple):
    """Working memory for C environments of N drones, M = C N; drone i of place c is c N + i."""

    drones: Records
    """(M,) records of `DRONE`."""
    columns: FloatArray
    """(M, 24) the same memory as plain numbers; the first three are the position."""
    order: IntArray | None
    """(2, M) the drones of each environment, by their index there, as last sorted along x; and
    indices for a moment. None if they are few."""
    felt: IntArray
    """(M,) the drones that feel more than drag."""
    pairs: Records
    """(P,) records of `PAIR`."""
    counters: Records
    """(1,) records of `COUNTERS`."""
    rows: Records
    """Rows `v` of (2, width) numbers in the model's precision, each with two samples: `SAMPLES` / 2
    for the inputs of a layer, as many for its outputs, then one for the codes of each drone: as it
    flies, and alone at the anchor height."""


def scratch_for(field: PackedField, places: int, drones: int) -> Scratch:
    """Working memory to evaluate forces in up to `places` environments of `drones` at once.

    Raises:
        ValueError: these are more drones than is possible.
    """
    total = places * drones
    if drones <= FEW and total > CHUNK:
        raise ValueError(f"{places} environments of {drones} drones are more than {CHUNK} drones")
    memory = np.zeros(total, DRONE)
    number, shape = field.weights.dtype["v"].subdtype or (np.dtype(np.float64), (1, 1))
    row = np.dtype([("v", number, (2, shape[1]))])
    order = np.empty((2, total), np.int64)
    order[:] = np.arange(total) % max(1, drones)
    return Scratch(
        memory,
        memory.view(np.float64).reshape(total, -1),
        order if drones > FEW else None,
        np.zeros(total, np.int64),
        np.zeros(max(1, total * (drones - 1)), PAIR),
        np.zeros(1, COUNTERS),
        aligned(SAMPLES + total, row),
    )
