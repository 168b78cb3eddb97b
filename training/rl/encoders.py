"""The networks of `swarm_envs.agents.networks` in torch, for every algorithm: what flies is a twin.

Where every type of vehicle has a policy of its own, each type's trunk fills its own columns, one of
them with ones, and the others have zeros: the linear layer behind them, which gives actions or
values, then has weights and a bias for each.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
import torch
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
from torch import Tensor, nn
from torch.nn import functional

from swarm_envs.agents.features import FeatureSizes
from swarm_envs.agents.networks import ANY, Layers, Network
from swarm_envs.training.rl.rl_config import RlConfig


@dataclass(frozen=True)
class EncoderSpec:
    """What the networks of a policy look like."""

    sizes: FeatureSizes  # numbers that are taken in
    encoder: str  # one of `swarm_envs.agents.networks.ENCODERS`
    pooling: str  # how a deep set's neighbours become one row
    hidden: tuple[int, ...]  # widths of the hidden layers
    set_hidden: tuple[int, ...]  # widths of phi's layers
    activation: str  # what follows every hidden layer
    owners: tuple[str, ...]  # types of drones with a network of their own, or `ANY` alone


def encoder_spec(config: RlConfig, sizes: FeatureSizes, types: tuple[str, ...]) -> EncoderSpec:
    """Of a run's options, with the features and types of vehicles that it has."""
    owners = types if config.per_type else (ANY,)
    widths = config.hidden, config.set_hidden
    return EncoderSpec(sizes, config.encoder, config.pooling, *widths, config.activation, owners)


class SetEncoder(nn.Module):
    """A drone's own numbers, and those of its neighbours as a set."""

    def __init__(self, spec: EncoderSpec) -> None:
        super().__init__()
        self.spec, code = spec, spec.set_hidden[-1]
        self.phi = hidden_layers(
            (spec.sizes.own + spec.sizes.neighbor, *spec.set_hidden), spec.activation
        )
        self.score = None
        if spec.encoder == "attention":
            narrow = hidden_layers((2 * code, code), spec.activation)
            self.score = nn.Sequential(*narrow, nn.Linear(code, 1))
        twice = spec.encoder == "deep-set" and spec.pooling == "max-sum"
        self.width = spec.sizes.own + code * (1 + twice)

    def forward(self, values: Tensor) -> Tensor:
        """(B, `width`) for features (B, `sizes.width`)."""
        sizes, (first, *deeper, last) = self.spec.sizes, self.phi
        assert isinstance(first, nn.Linear)
        own = values[:, : sizes.own]
        around = values[:, sizes.own :].reshape(-1, sizes.num_neighbors, sizes.neighbor)
        present = around[..., sizes.mask, None]
        shared = functional.linear(own, first.weight[:, : sizes.own], first.bias)
        members = functional.linear(around, first.weight[:, sizes.own :]).add_(shared[:, None])
        for layer in deeper:
            members = layer(members)
        members = last(members.mul_(present))  # so that who is not there is 0
        if self.score is None:
            return torch.cat([own, pool_members(members, present, self.spec)], dim=1)
        mean = members.sum(dim=1, keepdim=True) / present.sum(dim=1, keepdim=True).clamp(min=1.0)
        scores = self.score(torch.cat([members, mean.expand_as(members)], dim=-1))
        weights = torch.softmax(scores.masked_fill(present == 0, -1e9), dim=1)
        return torch.cat([own, (weights * members).sum(dim=1)], dim=1)


def pool_members(members: Tensor, present: Tensor, spec: EncoderSpec) -> Tensor:
    """Twin of `swarm_envs.agents.networks.pooled`: of (B, K, width), 0 where `present` is."""
    parts = []
    if "max" in spec.pooling:
        lowest = members if spec.activation == "relu" else members - (present == 0).float()
        parts.append(lowest.max(dim=1).values * present.amax(dim=1))
    if spec.pooling != "max":
        parts.append(members.sum(dim=1))
    if spec.pooling == "mean":
        parts[0] = parts[0] / present.sum(dim=1).clamp(min=1.0)
    return torch.cat(parts, dim=1)


class Trunk(nn.Module):
    """From features to the last hidden layer."""

    def __init__(self, spec: EncoderSpec) -> None:
        super().__init__()
        self.set = None if spec.encoder == "mlp" else SetEncoder(spec)
        width = self.set.width if self.set else spec.sizes.width
        self.body = hidden_layers((width, *spec.hidden), spec.activation)

    def forward(self, values: Tensor) -> Tensor:
        """(B, last width) for features (B, `sizes.width`)."""
        latent: Tensor = self.body(values if self.set is None else self.set(values))
        return latent


class Trunks(nn.Module):
    """The trunk of each type of drone; see the module for what comes out."""

    def __init__(self, spec: EncoderSpec) -> None:
        super().__init__()
        self.spec = spec
        self.each = [Trunk(spec) for _ in spec.owners]
        self.trunks = nn.ModuleList(self.each)
        self.width = len(spec.owners) * (spec.hidden[-1] + (spec.owners != (ANY,)))

    def forward(self, values: Tensor) -> Tensor:
        """(B, `width`) for features (B, `sizes.width`)."""
        if self.spec.owners == (ANY,):
            latent: Tensor = self.each[0](values)
            return latent
        parts = []
        for token, trunk in zip(self.spec.owners, self.each, strict=True):
            own = values[:, self.spec.sizes.own_column(token), None]
            parts += [own * trunk(values), own]
        return torch.cat(parts, dim=1)


class TrunkExtractor(BaseFeaturesExtractor):  # type: ignore[misc]  # SB3's base has no types here
    """Trunks where Stable-Baselines3 has features extracted, of the first numbers observed."""

    def __init__(self, observation_space: Any, spec: EncoderSpec) -> None:
        trunks = Trunks(spec)
        super().__init__(observation_space, trunks.width)
        self.trunks = trunks

    def forward(self, values: Tensor) -> Tensor:
        """What comes out of the trunks."""
        latent: Tensor = self.trunks(values[:, : self.trunks.spec.sizes.width])
        return latent


class Actor(nn.Module):
    """From features (..., `sizes.width`) to the mean action."""

    def __init__(self, spec: EncoderSpec, actions: int) -> None:
        super().__init__()
        self.trunks = Trunks(spec)
        self.head = nn.Linear(self.trunks.width, actions)

    def forward(self, values: Tensor) -> Tensor:
        """(..., actions) for features (..., `sizes.width`)."""
        means: Tensor = self.head(self.trunks(values.reshape(-1, values.shape[-1])))
        return means.reshape(*values.shape[:-1], -1)

    def networks(self) -> dict[str, Network]:
        """The same in numpy, by type of drone."""
        return plain_networks(self.trunks, self.head)


def plain_networks(trunks: Trunks, head: nn.Linear) -> dict[str, Network]:
    """Trunks and the layer behind them in numpy, by type of drone."""
    spec, found = trunks.spec, {}
    for owner, (token, trunk) in enumerate(zip(spec.owners, trunks.each, strict=True)):
        column = owner * (spec.hidden[-1] + 1)
        weight: Tensor = head.weight[:, column : column + spec.hidden[-1]]
        bias: Tensor = head.bias
        if token != ANY:
            bias = bias + head.weight[:, column + spec.hidden[-1]]
        last = (weight.detach().numpy().copy(), bias.detach().numpy().copy())
        phi = score = None
        if trunk.set is not None:
            phi = linear_layers(trunk.set.phi)
            score = linear_layers(trunk.set.score) if trunk.set.score else None
        layers = (*linear_layers(trunk.body), last)
        found[token] = Network(layers, phi, score, spec.pooling, spec.activation)
    return found


@torch.no_grad()
def fill(trunks: Trunks, head: nn.Linear, networks: Mapping[str, Network]) -> None:
    """Let trunks and the layer behind them, of one policy for all types, be these networks."""
    kinds = [
        {owner: (n.pooling, n.activation, _shapes(n)) for owner, n in found.items()}
        for found in (networks, plain_networks(trunks, head))
    ]
    if kinds[0] != kinds[1] or tuple(networks) != (ANY,):
        raise ValueError(
            f"the policy to start from has networks {kinds[0]}, but this run's are {kinds[1]}; "
            "give it the same encoder, widths, activation, neighbours and types, and no --per-type"
        )
    network, own = networks[ANY], trunks.each[0]
    pairs: list[tuple[nn.Module | None, Layers | None]] = [(own.body, network.layers[:-1])]
    pairs.append((head, network.layers[-1:]))
    if own.set is not None:
        pairs += [(own.set.phi, network.phi), (own.set.score, network.score)]
    for module, layers in pairs:
        linear = [m for m in module.modules() if isinstance(m, nn.Linear)] if module else []
        for layer, (weights, biases) in zip(linear, layers or (), strict=True):
            layer.weight.copy_(torch.from_numpy(weights))
            layer.bias.copy_(torch.from_numpy(biases))


def _shapes(network: Network) -> list[list[tuple[int, ...]]]:
    parts = (network.layers, network.phi, network.score)
    return [[weight.shape for weight, _ in part or ()] for part in parts]


def linear_layers(network: nn.Module) -> Layers:
    """Weights and biases of the linear layers in numpy, in order."""
    return tuple(
        (layer.weight.detach().numpy().copy(), layer.bias.detach().numpy().copy())
        for layer in network.modules()
        if isinstance(layer, nn.Linear)
    )


class _Tanh(torch.autograd.Function):
    """Hyperbolic tangent by numpy, whose kernel takes a small part of the time of torch's."""

    @staticmethod
    def forward(context: Any, values: Tensor) -> Tensor:
        """In place: what a linear layer gives is used nowhere else."""
        array = values.detach().numpy()
        np.tanh(array, out=array)
        context.mark_dirty(values)
        context.save_for_backward(values)
        return values

    @staticmethod
    def backward(context: Any, gradient: Tensor) -> Tensor:
        """The slope is 1 - tanh^2."""
        (values,) = context.saved_tensors
        return torch.addcmul(gradient, gradient * values, values, value=-1.0)


class Tanh(nn.Module):
    """Hyperbolic tangent, in place, of values on the CPU."""

    def forward(self, values: Tensor) -> Tensor:
        """Of any shape."""
        found: Tensor = _Tanh.apply(values)  # type: ignore[no-untyped-call]
        return found


def hidden_layers(widths: Sequence[int], activation: str) -> nn.Sequential:
    """Linear layers from the first width to the last, an activation after each."""
    follows: nn.Module = nn.ReLU(inplace=True) if activation == "relu" else Tanh()
    parts: list[nn.Module] = []
    for into, out in pairwise(widths):
        parts += [nn.Linear(into, out), follows]
    return nn.Sequential(*parts)
