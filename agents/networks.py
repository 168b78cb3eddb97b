"""Networks that act, in numpy: multilayer perceptrons, and deep sets over the neighbours.

A deep set gives every neighbour to a network phi, one for each type of vehicle, pools what comes
out, and continues with that and the drone's own numbers: the order of neighbours has no effect, and
there may be any number of them (Zaheer et al. 2017; for types as in Neural-Swarm2, Sec. III-C).
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np

from swarm_envs.agents.features import FeatureSizes
from swarm_envs.envs.observation import Float32Array

__all__ = ["ANY", "Layers", "Network", "plain"]

Layers = tuple[tuple[Float32Array, Float32Array], ...]
"""Weight (out, in) and bias (out,) of each layer of a network, in order; tanh between them."""

ENCODERS = ("mlp", "deep-set")
"""How neighbours are encoded: one after another, or as a set."""
POOLINGS = ("mean", "max", "sum")
"""What becomes of a set's members: their mean, largest values, or sum; zero if there are none."""
ANY = ""
"""Stands for vehicles of every type."""


@dataclass(frozen=True)
class Network:
    """From features to the mean action."""

    layers: Layers
    """of the actor; the last has no tanh"""
    phi: Mapping[str, Layers] | None = None
    """of a deep set: the network of each type of neighbour, tanh after the last layer too; under
    `ANY` alone if types are not observed; None: neighbours are given one after another"""
    pooling: str = "mean"
    """of a deep set: one of `POOLINGS`"""

    def __call__(self, values: Float32Array, sizes: FeatureSizes) -> Float32Array:
        """Mean actions (..., width) for features (..., `sizes.width`)."""
        if self.phi is not None:
            values = self._encoded(values, sizes)
        *hidden, (weight, bias) = self.layers
        actions: Float32Array = _squashed(values, hidden) @ weight.T + bias
        return actions

    def _encoded(self, values: Float32Array, sizes: FeatureSizes) -> Float32Array:
        own, around = sizes.split(values)
        present = around[..., sizes.mask, None]
        members: Any = 0.0
        assert self.phi is not None
        for token, layers in self.phi.items():
            column = sizes.mask if token == ANY else sizes.neighbor_column(token)
            members = members + around[..., column, None] * _squashed(around, layers)
        return np.concatenate([own, pooled(members, present, self.pooling)], axis=-1)


def pooled(members: Float32Array, present: Float32Array, pooling: str) -> Float32Array:
    """Pool (..., K, width) members of a set, those that are present (..., K, 1): (..., width)."""
    if pooling == "max":
        found = np.where(present > 0, members, np.float32(-1.0)).max(axis=-2, initial=-1.0)
        return np.where(present.any(axis=-2), found, np.float32(0.0))
    total: Float32Array = members.sum(axis=-2)
    if pooling == "sum":
        return total
    return total / np.maximum(present.sum(axis=-2), np.float32(1.0))


def act(networks: Mapping[str, Network], values: Float32Array, sizes: FeatureSizes) -> Float32Array:
    """Actions (..., width): every drone by the network of its type, or all by that of `ANY`."""
    if ANY in networks:
        return networks[ANY](values, sizes)
    actions: Any = 0.0
    for token, network in networks.items():
        own = values[..., sizes.own_column(token), None]
        actions = actions + own * network(values, sizes)
    made: Float32Array = actions
    return made


def plain(layers: Layers) -> dict[str, Network]:
    """One multilayer perceptron for vehicles of every type."""
    return {ANY: Network(layers)}


def to_tensors(networks: Mapping[str, Network]) -> dict[str, Float32Array]:
    """Tensors by name: `actor.<layer>.weight`, `phi.<type>.<layer>.bias`.

    They stand behind `<type>/` where drones of each type have a network of their own.
    """
    tensors = {}
    for owner, network in networks.items():
        before = f"{owner}/" if owner else ""
        parts = {f"{before}actor": network.layers}
        for token, layers in (network.phi or {}).items():
            parts[f"{before}phi.{token}" if token else f"{before}phi"] = layers
        for name, layers in parts.items():
            for k, (weight, bias) in enumerate(layers):
                tensors[f"{name}.{k}.weight"] = np.ascontiguousarray(weight, dtype=np.float32)
                tensors[f"{name}.{k}.bias"] = np.ascontiguousarray(bias, dtype=np.float32)
    return tensors


def layers_from_tensors(tensors: Mapping[str, Float32Array], name: str, width: int) -> Layers:
    """The layers `<name>.0.weight`, `<name>.0.bias` and so on, which take in so many numbers.

    Raises:
        ValueError: they do not fit each other, or take in another width.
        KeyError: a tensor is missing.
    """
    weight_of_layer = re.compile(rf"{re.escape(name)}\.[^.]*\.weight")
    count = sum(weight_of_layer.fullmatch(key) is not None for key in tensors)
    if not count:
        raise KeyError(f"{name}.0.weight")
    layers = tuple(
        (tensors[f"{name}.{k}.weight"], tensors[f"{name}.{k}.bias"]) for k in range(count)
    )
    for weight, bias in layers:
        if weight.ndim != 2 or bias.shape != weight.shape[:1]:
            raise ValueError(f"a layer has weights {weight.shape} and biases {bias.shape}")
    inputs = [width, *(weight.shape[0] for weight, _ in layers)]
    if any(weight.shape[1] != into for (weight, _), (into, _) in zip(layers, pairwise(inputs))):
        raise ValueError(f"the layers of {name!r} do not lead from {width} features")
    return layers


def _squashed(
    values: Float32Array, layers: Iterable[tuple[Float32Array, Float32Array]]
) -> Float32Array:
    for weight, bias in layers:
        values = np.tanh(values @ weight.T + bias)
    return values
