"""The networks of `swarm_envs.agents.networks` in torch, for training."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import torch
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
from torch import Tensor, nn

from swarm_envs.agents.features import MASK, FeatureSizes
from swarm_envs.agents.networks import Layers, Network

ACTIVATIONS: dict[str, type[nn.Module]] = {"tanh": nn.Tanh, "relu": nn.ReLU}


class SetEncoder(nn.Module):
    """Deep set: a drone's own features, and the maximum and the sum of its neighbors' codes.

    Args:
        sizes: the numbers of features.
        widths: the widths of the layers of phi.
        activation: one of `ACTIVATIONS`, after every layer.
    """

    def __init__(self, sizes: FeatureSizes, widths: Sequence[int], activation: str) -> None:
        super().__init__()
        self.sizes = sizes
        self.phi = hidden_layers((sizes.own + sizes.neighbor, *widths), activation)
        self.width = sizes.own + 2 * widths[-1]

    def forward(self, values: Tensor) -> Tensor:
        """Return (B, `width`) for features (B, `sizes.width`)."""
        sizes = self.sizes
        own = values[:, : sizes.own]
        around = values[:, sizes.own :].reshape(-1, sizes.num_neighbors, sizes.neighbor)
        present = around[..., MASK, None]
        beside = own[:, None].expand(-1, sizes.num_neighbors, -1)
        codes = self.phi(torch.cat([beside, around], dim=-1)) * present
        # Codes are at least -1, so that absent neighbors never are the maximum
        largest = (codes - (present == 0).float()).amax(dim=1) * present.amax(dim=1)
        return torch.cat([own, largest, codes.sum(dim=1)], dim=1)


class SetExtractor(BaseFeaturesExtractor):  # type: ignore[misc]  # SB3's base has no types here
    """The deep set as a features extractor of Stable-Baselines3."""

    def __init__(
        self, observation_space: Any, sizes: FeatureSizes, widths: Sequence[int], activation: str
    ) -> None:
        encoder = SetEncoder(sizes, widths, activation)
        super().__init__(observation_space, encoder.width)
        self.encoder = encoder

    def forward(self, values: Tensor) -> Tensor:
        """Return the encoding of features (B, width)."""
        encoded: Tensor = self.encoder(values)
        return encoded


class Actor(nn.Module):
    """A network that maps features (..., `sizes.width`) to the mean action.

    Args:
        sizes: the numbers of features.
        hidden: the widths of the hidden layers.
        actions: the width of an action.
        set_hidden: the widths of the layers of phi; None for no deep set.
        activation: one of `ACTIVATIONS`.
    """

    def __init__(
        self,
        sizes: FeatureSizes,
        hidden: Sequence[int],
        actions: int,
        set_hidden: Sequence[int] | None = None,
        activation: str = "relu",
    ) -> None:
        super().__init__()
        self.activation = activation
        self.set = None if set_hidden is None else SetEncoder(sizes, set_hidden, activation)
        width = sizes.width if self.set is None else self.set.width
        self.body = hidden_layers((width, *hidden), activation)
        self.head = nn.Linear(hidden[-1], actions)

    def forward(self, values: Tensor) -> Tensor:
        """Return (..., actions) for features (..., `sizes.width`)."""
        flat = values.reshape(-1, values.shape[-1])
        means: Tensor = self.head(self.body(flat if self.set is None else self.set(flat)))
        return means.reshape(*values.shape[:-1], -1)

    def network(self) -> Network:
        """Return the network in numpy."""
        phi = None if self.set is None else linear_layers(self.set.phi)
        return Network(linear_layers(self.body, self.head), phi, self.activation)

    @torch.no_grad()
    def fill(self, network: Network) -> None:
        """Copy the weights of a network of the same shape.

        Raises:
            ValueError: the network has another shape or activation.
        """
        own = self.network()
        if _shape(network) != _shape(own):
            raise ValueError(
                f"the policy of --start has layers {_shape(network)}, but this run has "
                f"{_shape(own)}; use the same widths, activation, neighbors and types"
            )
        modules = [] if self.set is None else linear_modules(self.set.phi)
        modules += linear_modules(self.body, self.head)
        for layer, (weights, biases) in zip(
            modules, (*(network.phi or ()), *network.layers), strict=True
        ):
            layer.weight.copy_(torch.from_numpy(weights))
            layer.bias.copy_(torch.from_numpy(biases))


def _shape(network: Network) -> tuple[str, list[Any], list[Any]]:
    phi, layers = ([w.shape for w, _ in part or ()] for part in (network.phi, network.layers))
    return network.activation, phi, layers


def hidden_layers(widths: Sequence[int], activation: str) -> nn.Sequential:
    """Return linear layers from the first width to the last, each with an activation."""
    parts: list[nn.Module] = []
    for into, out in pairwise(widths):
        parts += [nn.Linear(into, out), ACTIVATIONS[activation]()]
    return nn.Sequential(*parts)


def linear_modules(*networks: nn.Module) -> list[nn.Linear]:
    """Return the linear layers of modules, in order."""
    return [m for network in networks for m in network.modules() if isinstance(m, nn.Linear)]


def linear_layers(*networks: nn.Module) -> Layers:
    """Return the weights and biases of the linear layers of modules as numpy arrays, in order."""
    return tuple(
        (layer.weight.detach().numpy().copy(), layer.bias.detach().numpy().copy())
        for layer in linear_modules(*networks)
    )
