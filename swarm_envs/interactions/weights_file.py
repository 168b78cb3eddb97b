"""Reading a deep set's weights file: safetensors with a JSON note, checked before it is believed.

Tensors, float64: `phi.<type>.<layer>.weight` (out, in) and `.bias`, the same for
`phi.environment` and `rho.<type>`, and `drag.<type>` (3,) in N s/m. The note under the key
`swarm_envs` holds format, types, window, input ranges, anchor height and provenance.
"""

from __future__ import annotations

import json
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from safetensors import SafetensorError, safe_open

from swarm_envs.interactions.field import (
    LATERAL_REACH,
    LEARNED,
    VERTICAL_REACH,
    ForceField,
    empty_field,
    unlimited,
)
from swarm_envs.state import FloatArray

FORMAT = "deep-set-1"
ENVIRONMENT = "environment"


def load_deep_set(path: Path) -> tuple[tuple[str, ...], ForceField, dict[str, Any]]:
    """Read a weights file: interaction types, the compiled field, and the file's own notes.

    Raises:
        FileNotFoundError: there is no such file.
        ValueError: the file is damaged, or not a deep set of this format.
    """
    if not path.is_file():
        raise FileNotFoundError(
            f"weights file {str(path)!r} does not exist; give the path of a file made by "
            "`swarm-envs fit`, or one of 'none', 'wake', 'learned'"
        )
    try:
        tensors, notes = _read(path)
        types = tuple(notes["types"])
        field = _assemble(types, tensors, notes)
    except (SafetensorError, KeyError, TypeError, ValueError, OSError) as error:
        raise ValueError(
            f"weights file {str(path)!r} is damaged or not a {FORMAT!r} file ({error}); "
            "fit it again or reinstall the package"
        ) from error
    return types, field, notes


def _read(path: Path) -> tuple[dict[str, FloatArray], dict[str, Any]]:
    with safe_open(path, framework="numpy") as file:
        metadata = file.metadata() or {}
        names = file.keys()  # the file itself cannot be iterated
        tensors = {name: np.asarray(file.get_tensor(name), np.float64) for name in names}
    notes: dict[str, Any] = json.loads(metadata.get("swarm_envs", "{}"))
    if notes.get("format") != FORMAT:
        raise ValueError(f"its format is {notes.get('format')!r}")
    for name, tensor in tensors.items():
        if not np.isfinite(tensor).all():
            raise ValueError(f"tensor {name!r} holds a number that is not finite")
    return tensors, notes


def _assemble(
    types: tuple[str, ...], tensors: dict[str, FloatArray], notes: dict[str, Any]
) -> ForceField:
    names = [*(f"phi.{t}" for t in types), f"phi.{ENVIRONMENT}", *(f"rho.{t}" for t in types)]
    networks = [_layers(name, tensors) for name in names]
    _check_widths(names, networks)
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
    window, ranges = notes.get("window"), notes.get("input_range")
    return empty_field(len(types))._replace(
        kind=LEARNED,
        drag=np.array([_drag(t, tensors) for t in types]),
        window=_window(window),
        environment_range=np.array(ranges["environment"], float) if ranges else unlimited(4),
        pair_range=np.array(ranges["pair"], float) if ranges else unlimited(6),
        weights=np.concatenate(flat),
        layout=layout,
        anchor_height=float(notes.get("anchor_height_m") or 0.0),
    )


def _layers(name: str, tensors: dict[str, FloatArray]) -> list[tuple[FloatArray, FloatArray]]:
    layers: list[tuple[FloatArray, FloatArray]] = []
    while f"{name}.{len(layers)}.weight" in tensors:
        prefix = f"{name}.{len(layers)}"
        layers.append((tensors[f"{prefix}.weight"], tensors[f"{prefix}.bias"]))
    if not layers:
        raise KeyError(f"network {name!r} is missing")
    for (first, _), (second, _) in pairwise(layers):
        if first.shape[0] != second.shape[1]:
            raise ValueError(f"layers of {name!r} do not fit each other")
    return layers


def _check_widths(names: list[str], networks: list[list[tuple[FloatArray, FloatArray]]]) -> None:
    hidden = networks[0][-1][0].shape[0]
    for name, layers in zip(names, networks, strict=True):
        inputs, outputs = layers[0][0].shape[1], layers[-1][0].shape[0]
        if name.startswith("rho."):
            expected = (hidden, 1)
        else:
            expected = (4 if name.endswith(f".{ENVIRONMENT}") else 6, hidden)
        if (inputs, outputs) != expected:
            raise ValueError(f"{name!r} maps {inputs} to {outputs} numbers, not {expected}")


def _drag(name: str, tensors: dict[str, FloatArray]) -> FloatArray:
    drag = tensors.get(f"drag.{name}", np.zeros(3))
    if drag.shape != (3,) or (drag < 0).any():
        raise ValueError(f"drag of {name!r} must be three numbers that are not negative")
    return drag


def _window(window: dict[str, list[float]] | None) -> FloatArray:
    if window is None:
        return np.array([LATERAL_REACH, LATERAL_REACH, VERTICAL_REACH, VERTICAL_REACH])
    return np.array([*window["lateral_m"], *window["vertical_m"]], dtype=np.float64)
