"""The file of a deep set that ships: safetensors with float64 weights and a JSON description."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import torch
from safetensors import safe_open
from torch import Tensor

from swarm_envs.training.force_model.checkpoint import write_safetensors
from swarm_envs.training.force_model.network import (
    DeepSet,
    DeepSetSpec,
    InputRange,
    Window,
    layers,
)

FORMAT = "deep-set-1"
METADATA_KEY = "swarm_envs"


def save_network(
    path: str | os.PathLike[str], network: DeepSet, provenance: Mapping[str, object] | None = None
) -> None:
    """Write a network with its drag, atomically.

    Tensors: `phi.<type>.<layer>.weight` (out, in) and `.bias`, `phi.environment.<layer>...`,
    `rho.<type>.<layer>...`, `drag.<type>` (3,) in N s/m.

    Args:
        path: the file to write.
        network: what to write, of any precision.
        provenance: further keys of the description: data, seed, command.
    """
    spec = network.spec
    tensors = {f"drag.{name}": network.drag[i] for i, name in enumerate(spec.types)}
    for prefix, module in _parts(network).items():
        for index, layer in enumerate(layers(module)):
            tensors[f"{prefix}.{index}.weight"] = layer.weight
            tensors[f"{prefix}.{index}.bias"] = layer.bias
    window, limits = spec.window, spec.input_range
    description = {
        **(provenance or {}),
        "format": FORMAT,
        "types": list(spec.types),
        "window": None if window is None else window._asdict(),
        "input_range": None
        if limits is None
        else {"pair": limits.pair, "environment": limits.environment},
        "anchor_height_m": spec.anchor_height_m,
    }
    exact = {name: value.detach().to(torch.float64) for name, value in tensors.items()}
    write_safetensors(Path(path), exact, {METADATA_KEY: json.dumps(description)})


def load_network(path: str | os.PathLike[str]) -> DeepSet:
    """Read a file that `save_network` wrote, as a float64 network.

    Raises:
        FileNotFoundError: there is no such file.
        ValueError: the file is not of this format.
    """
    if not Path(path).is_file():
        raise FileNotFoundError(f"no weights file at {os.fspath(path)!r}; give its path")
    with safe_open(path, framework="pt") as file:
        tensors: dict[str, Tensor] = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
        description = json.loads((file.metadata() or {}).get(METADATA_KEY, "{}"))
    if description.get("format") != FORMAT:
        raise ValueError(
            f"{os.fspath(path)!r} has format {description.get('format')!r}, but must have "
            f"{FORMAT!r}; write it with save_network"
        )
    spec = _spec(description)
    rho = f"rho.{spec.types[0]}"
    hidden, depth = tensors[f"{rho}.0.weight"].shape[1], sum(_is_layer(n, rho) for n in tensors)
    spec = replace(spec, hidden=hidden, layers=depth)
    network = DeepSet(spec, dtype=torch.float64)
    with torch.no_grad():
        for prefix, module in _parts(network).items():
            for index, layer in enumerate(layers(module)):
                layer.weight.copy_(tensors[f"{prefix}.{index}.weight"])
                layer.bias.copy_(tensors[f"{prefix}.{index}.bias"])
        for index, name in enumerate(network.spec.types):
            network.drag[index] = tensors[f"drag.{name}"]
    return network


def description_of(path: str | os.PathLike[str]) -> dict[str, object]:
    """Return the JSON description in a weights file: format, types, window, provenance."""
    with safe_open(path, framework="pt") as file:
        result: dict[str, object] = json.loads(file.metadata()[METADATA_KEY])
    return result


def _is_layer(tensor: str, prefix: str) -> bool:
    return tensor.startswith(f"{prefix}.") and tensor.endswith(".weight")


def _parts(network: DeepSet) -> dict[str, torch.nn.Module]:
    phi = {f"phi.{name}": module for name, module in network.phi.items()}
    rho = {f"rho.{name}": module for name, module in network.rho.items()}
    return {**phi, "phi.environment": network.phi_environment, **rho}


def _spec(description: dict[str, object]) -> DeepSetSpec:
    window, limits = description["window"], description["input_range"]
    types, anchor = description["types"], description["anchor_height_m"]
    assert isinstance(types, list) and (anchor is None or isinstance(anchor, float))
    return DeepSetSpec(
        types=tuple(types),
        window=_window(window) if isinstance(window, dict) else None,
        input_range=_input_range(limits) if isinstance(limits, dict) else None,
        anchor_height_m=anchor,
    )


def _window(value: dict[str, list[float]]) -> Window:
    lateral, vertical = value["lateral_m"], value["vertical_m"]
    return Window((lateral[0], lateral[1]), (vertical[0], vertical[1]))


def _input_range(value: dict[str, list[list[float]]]) -> InputRange:
    (low, high), (lowest, highest) = value["pair"], value["environment"]
    return InputRange((tuple(low), tuple(high)), (tuple(lowest), tuple(highest)))
