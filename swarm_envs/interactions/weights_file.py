"""Reading and validation of weights files: safetensors with a JSON note.

Tensors are float64. A deep set has `phi.<type>.<layer>.weight` (out, in) and `.bias`, and likewise
`phi.environment` and `rho.<type>`. A pairwise sum has `pair.<neighbor>.<drone>.<layer>...` and
`environment.<type>.<layer>...`. A composed model has these and `wake.<neighbor>.<drone>` (4,): A in
gram-force, w0 in m, S, p; `delay.<type>` (1,) in s/m, `joining` (3,): q, M, and h in m. All may
have `drag.<type>` (3,) in N s/m. The note under the key `swarm_envs` has format, types, window,
input ranges, anchor height and provenance.
"""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from safetensors import SafetensorError, safe_open

from swarm_envs.errors import check_array
from swarm_envs.files import parse_note
from swarm_envs.interactions.field import (
    COMPOSED,
    DEEP_SET,
    LATERAL_REACH,
    PAIRWISE,
    UNITS_OF_OWN,
    UNITS_OF_PAIR,
    VERTICAL_REACH,
    ForceField,
    empty_field,
    unlimited,
)
from swarm_envs.interactions.network import pairwise_names
from swarm_envs.state import FloatArray
from swarm_envs.vehicles import GRAM_FORCE

Layers = list[tuple[FloatArray, FloatArray]]
"""Weights and biases of a network."""

KINDS = {"deep-set-1": DEEP_SET, "pairwise-1": PAIRWISE, "composed-1": COMPOSED}
"""Kinds of force models by format."""
_FORMATS = " or ".join(map(repr, KINDS))
ENVIRONMENT = "environment"  # Name of the environment's network and input range in a file
_PREFIXES = ("phi.", "rho.", "pair.", f"{ENVIRONMENT}.")
LARGEST = 1e6  # Fitted networks have far smaller numbers; larger ones mean damage


def load_weights(path: Path) -> tuple[tuple[str, ...], ForceField, dict[str, Any]]:
    """Return the interaction types, parameters and notes of a weights file.

    Raises:
        ValueError: the file is damaged.
        FileNotFoundError: the file does not exist.
    """
    if not path.is_file():
        raise FileNotFoundError(
            f"weights file {str(path)!r} does not exist; give the path of a file made by "
            "`swarm-envs fit`, or the name of a shipped model, such as 'learned'"
        )
    try:
        tensors, notes = read_tensors(path)
        types = _types(notes["types"])
        field = _assemble(types, tensors, notes)
    except (SafetensorError, KeyError, TypeError, ValueError, OSError) as error:
        raise ValueError(
            f"weights file {str(path)!r} is damaged or not a {_FORMATS} file ({error}); "
            "fit it again or reinstall the package"
        ) from error
    return types, field, notes


def read_tensors(path: Path) -> tuple[dict[str, FloatArray], dict[str, Any]]:
    """Return the tensors, as float64, and the note of a file.

    Raises:
        SafetensorError: it is no safetensors file.
        ValueError: its format is unknown, or a number is not finite or too large.
    """
    with safe_open(path, framework="numpy") as file:
        metadata = file.metadata() or {}
        names = file.keys()  # the file itself cannot be iterated
        tensors = {name: np.asarray(file.get_tensor(name), np.float64) for name in names}
    notes = parse_note(metadata.get("swarm_envs", "{}"))
    if notes.get("format") not in KINDS:
        raise ValueError(f"its format is {notes.get('format')!r}")
    for name, tensor in tensors.items():
        if not np.isfinite(tensor).all():
            raise ValueError(f"tensor {name!r} has a number that is not finite")
        if (np.abs(tensor) > LARGEST).any():
            raise ValueError(f"tensor {name!r} has a number beyond {LARGEST:g}")
    return tensors, notes


def _types(value: object) -> tuple[str, ...]:
    """Return the interaction types: distinct names other than that of the environment."""
    if not isinstance(value, list) or not value:
        raise ValueError(f"types is {value!r:.80}, but must be a list of names")
    for name in value:
        if not isinstance(name, str) or not name or name == ENVIRONMENT:
            raise ValueError(f"{name!r:.80} is not a valid name of an interaction type")
    if len(set(value)) < len(value):
        raise ValueError(f"types is {value!r:.80}, but names must be distinct")
    return tuple(value)


def _assemble(
    types: tuple[str, ...], tensors: dict[str, FloatArray], notes: dict[str, Any]
) -> ForceField:
    kind = KINDS[notes["format"]]
    names = _deep_set_names(types) if kind == DEEP_SET else pairwise_names(types)
    networks = [network_layers(name, tensors) for name in names]
    _check_all_read(tensors, networks)
    _check_widths(kind, names, networks)
    deepest = max(len(layers) for layers in networks)
    layout = np.zeros((len(names), 2 * deepest + 2), dtype=np.int64)
    flat: list[FloatArray] = []
    position = 0
    for row, layers in zip(layout, networks, strict=True):
        row[:2] = len(layers), layers[0][0].shape[1]
        for k, (weight, bias) in enumerate(layers):
            row[2 + k] = weight.shape[0]
            row[2 + deepest + k] = position
            flat += [weight.T.ravel(), bias]
            position += weight.size + bias.size
    own_range, pair_range = _ranges(notes.get("input_range"))
    field = _joined(types, tensors) if kind == COMPOSED else empty_field(len(types))
    return field._replace(
        kind=kind,
        drag=np.array([_drag(t, tensors) for t in types]),
        window=_window(notes.get("window")),
        environment_range=own_range,
        pair_range=pair_range,
        weights=np.concatenate(flat),
        layout=layout,
        anchor_height=_anchor_height(notes.get("anchor_height_m")),
    )


def _joined(types: tuple[str, ...], tensors: dict[str, FloatArray]) -> ForceField:
    """Return the parameters of a composed model's wakes, and of the combination of pairs."""
    field = empty_field(len(types))
    for a, upper in enumerate(types):
        for b, lower in enumerate(types):
            wake = _positive(f"wake.{upper}.{lower}", tensors, 4)
            field.wake_pair[a, b] = wake * [GRAM_FORCE, 1.0, 1.0, 1.0]
        field.wake_delay[a] = _positive(f"delay.{upper}", tensors, 1)[0]
    q, lost, height = _positive("joining", tensors, 3)
    if q < 1.0 or lost > 1.0 or height == 0.0:
        raise ValueError(
            f"'joining' is {q:g}, {lost:g}, {height:g}, but q must be at least 1, M at most 1, "
            "and h above 0"
        )
    return field._replace(wake_combine=float(q), wake_mitigation=np.array([lost, height]))


def _positive(name: str, tensors: dict[str, FloatArray], count: int) -> FloatArray:
    """Return numbers that must not be negative; the width w0 of a wake must be positive."""
    numbers = tensors[name]
    if numbers.shape != (count,) or (numbers < 0.0).any():
        raise ValueError(f"{name!r} must be {count} numbers that are not negative")
    if name.startswith("wake.") and numbers[1] == 0.0:
        raise ValueError(f"{name!r} is a wake without width")
    return numbers


def _deep_set_names(types: tuple[str, ...]) -> list[str]:
    """Return the names of the networks of a deep set, in the order of the field."""
    return [*(f"phi.{t}" for t in types), f"phi.{ENVIRONMENT}", *(f"rho.{t}" for t in types)]


def network_layers(name: str, tensors: dict[str, FloatArray]) -> Layers:
    """Return weight (outputs, inputs) and bias (outputs,) of each layer of a network, in order."""
    layers: Layers = []
    while f"{name}.{len(layers)}.weight" in tensors:
        prefix = f"{name}.{len(layers)}"
        weight, bias = tensors[f"{prefix}.weight"], tensors[f"{prefix}.bias"]
        if weight.ndim != 2 or weight.size == 0 or bias.shape != weight.shape[:1]:
            raise ValueError(
                f"layer {prefix!r} has a weight of shape {weight.shape} and a bias of shape "
                f"{bias.shape}, not (outputs, inputs) and (outputs,)"
            )
        layers.append((weight, bias))
    if not layers:
        raise KeyError(f"network {name!r} is missing")
    for (first, _), (second, _) in pairwise(layers):
        if first.shape[0] != second.shape[1]:
            raise ValueError(f"layers of {name!r} do not fit each other")
    return layers


def _check_all_read(tensors: dict[str, FloatArray], networks: list[Layers]) -> None:
    """Raise ValueError for unused layers: an earlier one is missing, or a type is not listed."""
    found = sum(name.startswith(_PREFIXES) for name in tensors)
    read = 2 * sum(map(len, networks))
    if found != read:
        raise ValueError(f"it has {found} weights and biases, but its networks have {read}")


def _check_widths(kind: int, names: list[str], networks: list[Layers]) -> None:
    hidden, pair, own = networks[0][-1][0].shape[0], 6, 4
    if kind == COMPOSED:
        pair, own = len(UNITS_OF_PAIR), len(UNITS_OF_OWN)
    for name, layers in zip(names, networks, strict=True):
        inputs, outputs = layers[0][0].shape[1], layers[-1][0].shape[0]
        part = name.split(".")[0]
        last = 1 if part in ("pair", ENVIRONMENT) else hidden
        expected = (own if ENVIRONMENT in name.split(".") else pair, last)
        if kind == COMPOSED and part == "pair":
            expected = (pair, 2)
        if part == "rho":
            expected = (hidden, 1)
        if (inputs, outputs) != expected:
            raise ValueError(f"{name!r} maps {inputs} to {outputs} numbers, not {expected}")


def _drag(name: str, tensors: dict[str, FloatArray]) -> FloatArray:
    drag = tensors.get(f"drag.{name}", np.zeros(3))
    if drag.shape != (3,) or (drag < 0).any():
        raise ValueError(f"drag of {name!r} must be three numbers that are not negative")
    return drag


def _window(window: object) -> FloatArray:
    if window is None:
        return np.array([LATERAL_REACH, LATERAL_REACH, VERTICAL_REACH, VERTICAL_REACH])
    if not isinstance(window, dict):
        raise ValueError(f"window is {window!r:.80}, but must be null or an object")
    edges = [_numbers(name, window[name], (2,)) for name in ("lateral_m", "vertical_m")]
    for full, end in edges:
        if not 0.0 <= full <= end:
            raise ValueError(
                f"the window fades from {full:g} to {end:g} m, but must satisfy 0 <= from <= to"
            )
    return np.concatenate(edges)


def _ranges(ranges: object) -> tuple[FloatArray, FloatArray]:
    """Return the ranges (2, 4) of the environment's and (2, 6) of a pair's inputs."""
    if ranges is None:
        return unlimited(4), unlimited(6)
    if not isinstance(ranges, dict):
        raise ValueError(f"input_range is {ranges!r:.80}, but must be null or an object")
    own = _numbers("input_range.environment", ranges[ENVIRONMENT], (2, 4))
    pair = _numbers("input_range.pair", ranges["pair"], (2, 6))
    if (own[0] > own[1]).any() or (pair[0] > pair[1]).any():
        raise ValueError("an input_range has a lower end above its upper end")
    return own, pair


def _anchor_height(value: object) -> float:
    """Return the anchor height, m; 0 if the model is not anchored."""
    height = 0.0 if value is None else float(_numbers("anchor_height_m", value, ()))
    if height < 0.0:
        raise ValueError(f"anchor_height_m is {height:g}, but must not be negative")
    return height


def _numbers(name: str, value: object, shape: tuple[int, ...]) -> FloatArray:
    """Return finite numbers of a shape; booleans and strings raise ValueError."""
    array = np.asarray(value)
    if array.dtype.kind not in "iuf":
        raise ValueError(f"{name} is {value!r:.80}, but must be numbers of shape {shape}")
    return check_array(name, array, shape)
