"""A network's weights as one vector, which makes Adam and averages of weights cheap."""

from __future__ import annotations

import torch
from torch import Tensor, nn


class FlatWeights:
    """All parameters of a network as views of one vector, their gradients of another.

    Twenty small matrices cost an optimiser twenty times the calls of one vector.
    """

    values: nn.Parameter
    """(P,) the weights; changing them changes the network."""

    def __init__(self, network: nn.Module) -> None:
        """Move the parameters of `network` into one vector."""
        self._parameters = list(network.parameters())
        flat = torch.cat([p.detach().reshape(-1) for p in self._parameters])
        self.values = nn.Parameter(flat)
        self.values.grad = torch.zeros_like(flat)
        for parameter, piece in zip(self._parameters, self._pieces(flat), strict=True):
            parameter.data = piece
        gradient = self._pieces(self.values.grad)
        for parameter, piece in zip(self._parameters, gradient, strict=True):
            parameter.grad = piece  # autograd adds to it in place

    def _pieces(self, flat: Tensor) -> list[Tensor]:
        """Views of a vector in the shapes of the parameters."""
        parts = torch.split(flat, [p.numel() for p in self._parameters])
        return [part.view(p.shape) for part, p in zip(parts, self._parameters, strict=True)]

    def matrices(self, flat: Tensor | None = None) -> list[Tensor]:
        """The weight matrices in a vector of weights, as views; by default in `values`."""
        flat = self.values.detach() if flat is None else flat
        return [piece for piece in self._pieces(flat) if piece.ndim == 2]

    def clear_gradient(self) -> None:
        """Set the gradient to zero, in place."""
        assert self.values.grad is not None
        self.values.grad.zero_()

    @torch.no_grad()
    def set(self, flat: Tensor) -> None:
        """Give the network other weights, (P,)."""
        self.values.copy_(flat)

    def check_finite(self, step: int, loss: float, learning_rate: float) -> None:
        """Refuse to go on from weights that no further step could repair.

        Args:
            step: the optimiser's step that left them, from 1.
            loss: before that step.
            learning_rate: which the user may lower.

        Raises:
            ValueError: a weight is not finite.
        """
        if not bool(self.values.isfinite().all()):
            raise ValueError(
                f"training diverged: step {step} left weights that are not finite, at loss "
                f"{loss:g} and learning_rate {learning_rate:g}; give a lower learning_rate, and "
                "look for labels far from all others"
            )

    def release(self) -> None:
        """Give every parameter storage of its own again, and no gradient."""
        for parameter in self._parameters:
            parameter.data = parameter.detach().clone()
            parameter.grad = None
