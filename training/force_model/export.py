"""The file of a force network: safetensors with float64 weights and a JSON description."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save
from torch import Tensor, nn

from swarm_envs.files import write_json, written_whole
from swarm_envs.training.force_model.composed import Composed, build
from swarm_envs.training.force_model.network import (
    DeepSet,
    DeepSetSpec,
    FadeWindow,
    ForceNetwork,
    InputRange,
    NetworkKind,
    layers,
)
from swarm_envs.training.force_model.wake import Wake
from swarm_envs.training.force_model.wake import description as wake_description

__all__ = ["write_safetensors"]

FORMATS: dict[str, NetworkKind] = {
    "deep-set-1": "deep-set",
    "composed-1": "composed",
}
"""Kinds of network by the format of their file."""
METADATA_KEY = "swarm_envs"  # Key of the description in a file's metadata


def write_safetensors(path: Path, tensors: dict[str, Tensor], metadata: dict[str, str]) -> None:
    """Write a safetensors file atomically."""
    with written_whole(path) as partial:
        content = save({name: t.contiguous() for name, t in tensors.items()}, metadata)
        partial.write_bytes(content)  # `save_file` raises no OSError


def save_network(
    path: str | os.PathLike[str],
    network: ForceNetwork,
    provenance: Mapping[str, object] | None = None,
    dtype: torch.dtype = torch.float64,
) -> None:
    """Write a network of any precision with its drag atomically.

    Tensors of a deep set: `phi.<type>.<layer>.weight` (out, in) and `.bias`,
    `phi.environment.<layer>...`, `rho.<type>.<layer>...`, and for a torque head
    `torque.<type>.weight` (3, width) and `.bias`, which replace rho's last layer and
    give gram-force centimeters. Tensors of a composed model: `pair.<neighbor>.<drone>.<layer>...`,
    `environment.<type>.<layer>...`, and those listed in `swarm_envs.interactions.weights_file`.
    Both have `drag.<type>` (3,) in N s/m.

    The file of a wake is JSON, with `provenance` as one key; for the others, `provenance` are
    further keys of the description. float32 is exact for networks that were trained in single
    precision, and halves the file; it is read as float64 in any case.
    """
    if isinstance(network, Wake):
        write_json(Path(path), wake_description(network) | {"provenance": dict(provenance or {})})
        return
    spec = network.spec
    tensors = {f"drag.{name}": network.drag[i] for i, name in enumerate(spec.types)}
    for name, layer in _layers(network).items():
        tensors |= {f"{name}.weight": layer.weight, f"{name}.bias": layer.bias}
    if isinstance(network, Composed):
        tensors |= network.wake_tensors()
    description = {
        **(provenance or {}),
        "format": next(name for name, kind in FORMATS.items() if kind == spec.kind),
        "types": list(spec.types),
        "window": spec.window._asdict(),
        "input_range": spec.input_range and vars(spec.input_range),
        "anchor_height_m": spec.anchor_height_m,
    }
    exact = {name: value.detach().to(dtype) for name, value in tensors.items()}
    write_safetensors(Path(path), exact, {METADATA_KEY: json.dumps(description)})


def load_network(path: str | os.PathLike[str]) -> ForceNetwork:
    """Read a file of `save_network` as a float64 network.

    Raises:
        FileNotFoundError: there is no such file.
        ValueError: the file is damaged or not of this format.
    """
    if not Path(path).is_file():
        raise FileNotFoundError(f"no weights file at {os.fspath(path)!r}; give its path")
    try:
        with safe_open(path, framework="pt") as file:
            tensors: dict[str, Tensor] = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
            description = json.loads((file.metadata() or {}).get(METADATA_KEY, "{}"))
    except (SafetensorError, ValueError) as error:
        raise ValueError(
            f"weights file {os.fspath(path)!r} is damaged ({error}); fit it again"
        ) from error
    if description.get("format") not in FORMATS:
        raise ValueError(
            f"{os.fspath(path)!r} has format {description.get('format')!r}, but must have "
            f"{' or '.join(map(repr, FORMATS))}; write it with save_network"
        )
    network = build(_spec(description, tensors), dtype=torch.float64)
    with torch.no_grad():
        for name, layer in _layers(network).items():
            layer.weight.copy_(tensors[f"{name}.weight"])
            layer.bias.copy_(tensors[f"{name}.bias"])
        for index, name in enumerate(network.spec.types):
            network.drag[index] = tensors[f"drag.{name}"]
        if isinstance(network, Composed):
            network.set_wake_tensors(tensors)
    return network


def _layers(network: ForceNetwork) -> dict[str, nn.Linear]:
    """Return the layers by the prefix of the names of their tensors."""
    found = {
        f"{prefix}.{index}": layer
        for prefix, module in network.named_networks().items()
        for index, layer in enumerate(layers(module))
    }
    if isinstance(network, DeepSet) and network.spec.torque:
        for name, head in network.torque.items():
            assert isinstance(head, nn.Linear)
            found[f"torque.{name}"] = head
    return found


def _spec(description: dict[str, Any], tensors: dict[str, Tensor]) -> DeepSetSpec:
    window, limits = description["window"], description["input_range"] or {}
    ranges: dict[str, Any] = {name: tuple(map(tuple, ends)) for name, ends in limits.items()}
    types, kind = description["types"], FORMATS[description["format"]]
    first = f"rho.{types[0]}." if kind == "deep-set" else f"pair.{types[0]}.{types[0]}."
    depth = sum(name.startswith(first) and name.endswith(".weight") for name in tensors)
    hidden = {} if kind != "deep-set" else {"hidden": tensors[f"{first}0.weight"].shape[1]}
    return DeepSetSpec(
        types=tuple(types),
        window=FadeWindow(**{name: tuple(pair) for name, pair in window.items()}),
        input_range=InputRange(**ranges) if ranges else None,
        anchor_height_m=description["anchor_height_m"] or None,  # 0 in a file means none
        layers=depth,
        kind=kind,
        torque=f"torque.{types[0]}.weight" in tensors,
        **hidden,
    )
