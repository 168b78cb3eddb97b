"""Networks that act, in numpy: multilayer perceptrons, and sets over the neighbours.

A set encoder gives every neighbour, together with the drone's own numbers, to a network phi, pools
the outputs, and continues with that and the drone's own numbers: the order of neighbours has no
effect, and there may be any number of them (deep sets, Zaheer et al. 2017). Attention pools by a
softmax of scores, each of a neighbour's code and of the mean of all (Batra et al. 2021, Decentral-
ized Control of Quadrotor Swarms with End-to-end Deep Reinforcement Learning, Sec. 3.2).
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
"""Weight (out, in) and bias (out,) of each layer of a network, in order."""

ENCODERS = ("mlp", "deep-set", "attention")
"""How neighbours are encoded: one after another, or as a set that is pooled in one of two ways."""
POOLINGS = ("mean", "max", "sum", "max-sum")
"""What becomes of a deep set's members: their mean, largest values, sum, or largest values and sum;
zero if there are none."""
ACTIVATIONS = ("tanh", "relu")  # What follows every hidden layer
ANY = ""
"""Stands for vehicles of every type."""


@dataclass(frozen=True)
class Network:
    """From features to the mean action."""

    layers: Layers
    """of the actor; nothing follows the last"""
    phi: Layers | None = None
    """of a set: from a drone's own numbers and a neighbour's to its code, an activation after the
    last layer too; None: neighbours are given one after another"""
    score: Layers | None = None
    """of attention: from a code and the mean of all to one number; None for a deep set"""
    pooling: str = "mean"
    """of a deep set: one of `POOLINGS`"""
    activation: str = "tanh"
    """one of `ACTIVATIONS`"""

    def __call__(self, values: Float32Array, sizes: FeatureSizes) -> Float32Array:
        """Mean actions (..., width) for features (..., `sizes.width`)."""
        if self.phi is not None:
            values = self._encoded(values, sizes)
        return self._head(values, self.layers)

    def _encoded(self, values: Float32Array, sizes: FeatureSizes) -> Float32Array:
        own, around = sizes.split(values)
        present = around[..., sizes.mask, None]
        assert self.phi is not None
        (weight, bias), *deeper = self.phi
        shared = own @ weight[:, : sizes.own].T + bias  # the same beside every neighbour
        members = self._active(around @ weight[:, sizes.own :].T + shared[..., None, :])
        members = self._hidden(members, deeper)
        if self.score is None:
            code = pooled(members, present, self.pooling)
        else:
            mean = np.broadcast_to(pooled(members, present, "mean")[..., None, :], members.shape)
            scores = self._head(np.concatenate([members, mean], axis=-1), self.score)
            code = attended(members, present, scores)
        return np.concatenate([own, code], axis=-1)

    def _active(self, values: Float32Array) -> Float32Array:
        active: Float32Array = (
            np.tanh(values) if self.activation == "tanh" else np.maximum(values, np.float32(0.0))
        )
        return active

    def _hidden(
        self, values: Float32Array, layers: Iterable[tuple[Float32Array, Float32Array]]
    ) -> Float32Array:
        for weight, bias in layers:
            values = self._active(values @ weight.T + bias)
        return values

    def _head(self, values: Float32Array, layers: Layers) -> Float32Array:
        *hidden, (weight, bias) = layers
        out: Float32Array = self._hidden(values, hidden) @ weight.T + bias
        return out


def pooled(members: Float32Array, present: Float32Array, pooling: str) -> Float32Array:
    """Pool (..., K, width) members of a set, those that are present (..., K, 1).

    Returns:
        (..., width), or (..., 2 width) for `max-sum`.
    """
    if pooling == "max-sum":
        parts = [pooled(members, present, part) for part in ("max", "sum")]
        return np.concatenate(parts, axis=-1)
    if pooling == "max":
        found = np.where(present > 0, members, np.float32(-1.0)).max(axis=-2, initial=-1.0)
        return np.where(present.any(axis=-2), found, np.float32(0.0))
    total: Float32Array = (members * present).sum(axis=-2)
    if pooling == "sum":
        return total
    return total / np.maximum(present.sum(axis=-2), np.float32(1.0))


def attended(members: Float32Array, present: Float32Array, scores: Float32Array) -> Float32Array:
    """The mean (..., width) of members (..., K, width), weighed by a softmax of scores (..., K, 1).

    Of those that are present (..., K, 1); zero if there are none.
    """
    shown = np.where(present > 0, scores, np.float32(-1e9))
    weights = present * np.exp(shown - shown.max(axis=-2, keepdims=True, initial=-1e9))
    total = np.maximum(weights.sum(axis=-2), np.float32(1e-9))
    mean: Float32Array = (weights * members).sum(axis=-2) / total
    return mean


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
    """Tensors by name: `actor.<layer>.weight`, `phi.<layer>.bias`, `score.<layer>.weight`.

    They stand behind `<type>/` where drones of each type have a network of their own.
    """
    tensors = {}
    for owner, network in networks.items():
        before = f"{owner}/" if owner else ""
        parts = {"actor": network.layers, "phi": network.phi, "score": network.score}
        for part, layers in parts.items():
            name = before + part
            for k, (weight, bias) in enumerate(layers or ()):
                tensors[f"{name}.{k}.weight"] = np.ascontiguousarray(weight, dtype=np.float32)
                tensors[f"{name}.{k}.bias"] = np.ascontiguousarray(bias, dtype=np.float32)
    return tensors


def layers_from_tensors(tensors: Mapping[str, Float32Array], name: str, width: int) -> Layers:
    """The layers `<name>.0.weight`, `<name>.0.bias` and so on, which take in so many numbers."""
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
