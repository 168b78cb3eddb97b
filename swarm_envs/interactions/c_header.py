"""Export of a force model as a C99 header: float32, no heap, for 32-bit microcontrollers.

The paper evaluates its networks on the vehicles' processors (Neural-Swarm2, Sec. VI). Window,
clamps, anchor and drag are those of the model, so that the force is that of the simulator, rounded.
"""

from __future__ import annotations

import hashlib
from itertools import pairwise

import numpy as np

from swarm_envs.interactions.base import InteractionModel
from swarm_envs.interactions.c_text import (
    array_definition,
    array_rows,
    check_prefix,
    comment_lines,
    fill_templates,
    literal,
    type_enumeration,
)
from swarm_envs.interactions.composed import AXIS_RADIUS
from swarm_envs.interactions.field import (
    COMPOSED,
    DEEP_SET,
    LOWEST_HEIGHT,
    ONSET,
    UNITS_OF_OWN,
    UNITS_OF_PAIR,
    ForceField,
)
from swarm_envs.interactions.forces import all_forces
from swarm_envs.interactions.packed import layers_of, packed, widths_of
from swarm_envs.state import FloatArray
from swarm_envs.vehicles import GRAM_FORCE

__all__ = ["c_header"]

SAMPLES, NEIGHBORS = 16, 3
"""States in the header's self-test, and neighbors in each."""
_TAKEN = ("TYPES", "SELF_TEST", "FORCE_H")


def c_header(model: InteractionModel, name: str = "learned", seed: int = 0) -> str:
    """Return the source of a header that evaluates a composed model or a deep set.

    Names of its definitions begin with `name`. States of its self-test are sampled with the seed.

    Raises:
        ValueError: the model is of another kind, or the name cannot begin an identifier of C.
    """
    check_prefix(name)
    field = model.field
    if field.kind not in (DEEP_SET, COMPOSED):
        raise ValueError(
            f"interaction model {model.name!r} is neither composed nor a deep set; only those can "
            "be exported, such as 'learned' or a file that `swarm-envs fit` made"
        )
    deep_set = field.kind == DEEP_SET
    words = {
        "name": name,
        "NAME": name.upper(),
        "provenance": comment_lines(_provenance(model)),
        "costs": comment_lines(_costs(field)),
        "include": "" if deep_set else "#include <math.h>\n\n",
        "lateral": f"{field.window[1]:g}",
        "vertical": f"{field.window[3]:g}",
        "types": type_enumeration(name.upper(), model.types, _TAKEN),
        "tables": "\n".join(_tables(name, field)),
        "widest": str(_widest(field)),
        "gram": literal(GRAM_FORCE),
        "anchor": literal(field.anchor_height),
        **(_deep_set_words if deep_set else _composed_words)(name, field),
        **_self_test(field, np.random.default_rng(seed)),
    }
    middle = "deep_set" if deep_set else "composed"
    return fill_templates([f"{part}.h" for part in ("begin", middle, "end")], words)


def _networks(name: str, field: ForceField) -> list[str]:
    """Return the initializers of all networks, in the order of the field."""
    return [
        f"{{{name}_weights_{n}, {name}_widths_{n}, {len(widths_of(field, n)) - 1}}}"
        for n in range(len(field.layout))
    ]


def _deep_set_words(name: str, field: ForceField) -> dict[str, str]:
    networks, kinds = _networks(name, field), len(field.drag)
    return {
        "phi": ",\n    ".join(networks[:kinds]),
        "environment": networks[kinds],
        "rho": ",\n    ".join(networks[kinds + 1 :]),
        "hidden": str(widths_of(field, 0)[-1]),
    }


def _composed_words(name: str, field: ForceField) -> dict[str, str]:
    networks, kinds = _networks(name, field), len(field.drag)
    rows = [", ".join(networks[k * kinds : (k + 1) * kinds]) for k in range(kinds)]
    lost, height = field.wake_mitigation
    return {
        "pair": ",\n    ".join(f"{{{row}}}" for row in rows),
        "own": ",\n    ".join(networks[kinds * kinds :]),
        "own_units": f"{name}_own_units",
        "pair_units": f"{name}_pair_units",
        "axis": literal(AXIS_RADIUS),
        "onset": literal(ONSET),
        "lowest": literal(LOWEST_HEIGHT),
        "q": literal(field.wake_combine),
        "lost": literal(lost),
        "fading": literal(height),
    }


def _provenance(model: InteractionModel) -> list[str]:
    weights = np.ascontiguousarray(model.field.weights, np.float64)
    lines = [
        f"model: {model.name}",
        f"weights: SHA-256 {hashlib.sha256(weights.tobytes()).hexdigest()}",
    ]
    keys = ("command", "data_sha256", "mode", "seed")
    return lines + [f"{key}: {model.notes[key]}" for key in keys if key in model.notes]


def _costs(field: ForceField) -> list[str]:
    """Return lines on the memory and time of an evaluation."""
    kinds = len(field.drag)
    products = [
        sum(a * b for a, b in pairwise(widths_of(field, n))) for n in range(len(field.layout))
    ]
    if field.kind == COMPOSED:
        pair, own = max(products[: kinds * kinds]), max(products[kinds * kinds :])
        codes = 0
    else:
        pair, own = max(products[:kinds]), products[kinds] + max(products[kinds + 1 :])
        codes = 2 * widths_of(field, 0)[-1]
    once = f"{own} for the drone itself"
    if field.anchor_height > 0.0:
        where = f"none at {field.anchor_height:g} m and above"
        alone = "" if field.kind == COMPOSED else " without neighbors"
        once = f"{2 * own} for the drone itself ({where}{alone})"
    return [
        f"read-only memory: {4 * field.weights.size} bytes of weights",
        f"stack: about {4 * (4 * _widest(field) + codes) + 200} bytes",
        f"multiply-adds: {pair} per neighbor, {once}",
    ]


def _widest(field: ForceField) -> int:
    return max(max(widths_of(field, n)) for n in range(len(field.layout)))


def _tables(name: str, field: ForceField) -> list[str]:
    """Return the definitions of all arrays."""
    fades = field.window.reshape(2, 2)
    steep = [1.0 / (end - full) if end > full else 0.0 for full, end in fades]
    tables = [
        array_definition(f"{name}_window", np.column_stack([fades, steep]).ravel()),
        array_definition(f"{name}_environment_range", field.environment_range),
        array_definition(f"{name}_pair_range", field.pair_range),
        array_definition(f"{name}_drag", field.drag),
    ]
    if field.kind == COMPOSED:
        tables += [
            array_definition(f"{name}_wake", field.wake_pair.reshape(-1, 4)),
            array_definition(f"{name}_delay", field.wake_delay),
            array_definition(f"{name}_pair_units", np.array(UNITS_OF_PAIR)),
            array_definition(f"{name}_own_units", np.array(UNITS_OF_OWN)),
        ]
    for n in range(len(field.layout)):
        widths = ", ".join(map(str, widths_of(field, n)))
        tables.append(f"static const int {name}_widths_{n}[] = {{{widths}}};")
        tables.append(array_definition(f"{name}_weights_{n}", _by_output(field, n)))
    return tables


def _by_output(field: ForceField, n: int) -> FloatArray:
    """Return the weights of network `n`: for each output its bias, then its row of the matrix."""
    layers = layers_of(field, n)
    return np.concatenate([np.column_stack([bias, matrix.T]).ravel() for matrix, bias in layers])


def _self_test(field: ForceField, rng: np.random.Generator) -> dict[str, str]:
    """Return states near the ground and aloft, with some neighbors at the edge of the volume."""
    shape = (SAMPLES, 1 + NEIGHBORS)
    types = rng.integers(0, len(field.drag), shape)
    position = rng.uniform([-0.3, -0.3, -0.8], [0.3, 0.3, 0.8], (*shape, 3))
    position[:, 0] = np.stack([np.zeros(SAMPLES)] * 2 + [rng.uniform(0.1, 1.2, SAMPLES)], axis=1)
    position[:, 1:, 2] += position[:, :1, 2]
    velocity = rng.normal(0.0, 0.4, (*shape, 3))
    force = np.empty_like(position)
    all_forces(packed(field), types, position, velocity, force)
    pairs = np.concatenate(
        [position[:, 1:] - position[:, :1], velocity[:, 1:] - velocity[:, :1]], 2
    )
    states = [position[:, 0, 2:], velocity[:, 0], pairs.reshape(SAMPLES, -1), force[:, 0]]
    return {
        "samples": str(SAMPLES),
        "neighbors": str(NEIGHBORS),
        "test_types": array_rows(types),
        "test_states": array_rows(np.concatenate(states, axis=1)),
    }
