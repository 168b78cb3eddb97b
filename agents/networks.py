"""Policy networks in numpy: multilayer perceptrons, optionally with a deep set of the neighbors.

A deep set (Zaheer et al. 2017) applies a network phi to the features of every neighbor joined with
those of the drone. The actor's inputs are the drone's features, the maximum and the sum of the
outputs; they depend on neither the order nor the number of the neighbors.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from swarm_envs.agents.features import MASK, FeatureSizes
from swarm_envs.envs.observation import Float32Array

__all__ = ["Layers", "Network"]

Layers = tuple[tuple[Float32Array, Float32Array], ...]
"""Weight (out, in) and bias (out,) of each layer of a network, in order."""
ACTIVATIONS = ("tanh", "relu")  # Activation functions of the hidden layers


@dataclass(frozen=True)
class Network:
    """A network that maps features to the mean action."""

    layers: Layers
    """The layers of the actor; the last has no activation."""
    phi: Layers | None = None
    """The layers of the deep set, which map the features of a drone and a neighbor to a code, with
    an activation after the last layer too; None if the neighbors' features are inputs of the
    actor."""
    activation: str = "tanh"
    """The activation function, one of `ACTIVATIONS`."""

    def __call__(self, values: Float32Array, sizes: FeatureSizes) -> Float32Array:
        """Return mean actions (..., width) for features (..., `sizes.width`)."""
        if self.phi is not None:
            values = self._encoded(values, sizes, self.phi)
        *hidden, (weight, bias) = self.layers
        actions: Float32Array = self._hidden(values, hidden) @ weight.T + bias
        return actions

    def _encoded(self, values: Float32Array, sizes: FeatureSizes, phi: Layers) -> Float32Array:
        own, around = sizes.split(values)
        present = around[..., MASK, None]
        (weight, bias), *deeper = phi
        shared = own @ weight[:, : sizes.own].T + bias  # the same for every neighbor
        members = self._active(around @ weight[:, sizes.own :].T + shared[..., None, :])
        members = self._hidden(members, deeper)
        return np.concatenate([own, *pooled(members, present)], axis=-1)

    def _active(self, values: Float32Array) -> Float32Array:
        active: Float32Array = (
            np.tanh(values) if self.activation == "tanh" else np.maximum(values, np.float32(0.0))
        )
        return active

    def _hidden(
        self, values: Float32Array, layers: list[tuple[Float32Array, Float32Array]]
    ) -> Float32Array:
        for weight, bias in layers:
            values = self._active(values @ weight.T + bias)
        return values


def pooled(members: Float32Array, present: Float32Array) -> tuple[Float32Array, Float32Array]:
    """Return the maximum and the sum (..., width) of a set's members.

    Args:
        members: (..., K, width).
        present: (..., K, 1) mask of the members; without any, both results are 0.
    """
    largest = np.where(present > 0, members, np.float32(-1.0)).max(axis=-2, initial=-1.0)
    some = np.where(present.any(axis=-2), largest, np.float32(0.0))
    return some, (members * present).sum(axis=-2)


def to_tensors(network: Network) -> dict[str, Float32Array]:
    """Return the tensors of a network by name, such as `actor.<layer>.weight`."""
    tensors = {}
    for part, layers in (("actor", network.layers), ("phi", network.phi)):
        for k, (weight, bias) in enumerate(layers or ()):
            tensors[f"{part}.{k}.weight"] = np.ascontiguousarray(weight, dtype=np.float32)
            tensors[f"{part}.{k}.bias"] = np.ascontiguousarray(bias, dtype=np.float32)
    return tensors


def layers_from_tensors(tensors: Mapping[str, Float32Array], name: str, width: int) -> Layers:
    """Return the layers with tensors `<name>.0.weight`, `<name>.0.bias` and so on.

    Raises:
        KeyError: a tensor is missing.
        ValueError: widths of layers do not fit each other.
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
