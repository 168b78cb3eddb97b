"""Networks that act, in numpy: multilayer perceptrons, and deep sets over the neighbours.

A deep set gives every neighbour to a network phi, one for each type of vehicle, pools what comes
out, and goes on with that and the drone's own numbers: the order of neighbours changes nothing, and
there may be any number of them (Zaheer et al. 2017; for types as in Neural-Swarm2, Sec. III-C).
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np

from swarm_envs.agents.feature_sets import FeatureSizes
from swarm_envs.envs.observation import Float32Array

Layers = tuple[tuple[Float32Array, Float32Array], ...]
"""Weight (out, in) and bias (out,) of each layer of a network, in order; tanh between them."""

ENCODERS = ("mlp", "deep-set")
"""How neighbours are told: one after another, or as a set."""
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


@dataclass(frozen=True)
class Plan:
    """What a file must hold: from so many features to so many actions, for these vehicles."""

    sizes: FeatureSizes
    """Numbers that the networks take in."""
    actions: int
    """Numbers that they give."""
    action: str
    """What these mean, as the option `action` names it."""
    encoder: str
    """How what is observed becomes one row."""
    pooling: str
    """How neighbours become one row, where they are a set."""
    neighbor_types: tuple[str, ...]
    """Vehicles that neighbours may be, each with a network."""
    owners: tuple[str, ...]
    """Vehicles that act, each with a network."""

    def networks(self, tensors: Mapping[str, Float32Array]) -> dict[str, Network]:
        """The networks, every layer's widths checked.

        Raises:
            ValueError: layers do not fit each other, features or actions, or a tensor is left over.
            KeyError: a tensor is missing.
        """
        found = {
            owner: self._network(tensors, f"{owner}/" if owner else "") for owner in self.owners
        }
        extra = set(tensors) - set(to_tensors(found))
        if extra:
            raise ValueError(f"it holds tensors that no network has: {', '.join(sorted(extra))}")
        return found

    def _network(self, tensors: Mapping[str, Float32Array], before: str) -> Network:
        told, phi = self.sizes.width, None
        if self.encoder == "deep-set":
            parts = {
                token: f"{before}phi.{token}" if token else f"{before}phi"
                for token in self.neighbor_types
            }
            phi = {
                token: _chained(tensors, name, self.sizes.neighbor) for token, name in parts.items()
            }
            widths = {len(layers[-1][1]) for layers in phi.values()}
            if len(widths) > 1:
                raise ValueError(f"networks of neighbours give different numbers: {sorted(widths)}")
            told = self.sizes.own + widths.pop()
        layers = _chained(tensors, f"{before}actor", told)
        if len(layers[-1][1]) != self.actions:
            raise ValueError(
                f"its layers do not lead from {told} features to the {self.actions} numbers of "
                f"action {self.action!r}"
            )
        return Network(layers, phi, self.pooling)


def _chained(tensors: Mapping[str, Float32Array], name: str, width: int) -> Layers:
    count = sum(
        key.startswith(f"{name}.")
        and key.endswith(".weight")
        and key.removeprefix(f"{name}.").count(".") == 1
        for key in tensors
    )
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
