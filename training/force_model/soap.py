"""SOAP: Adam in the eigenbasis of Shampoo's preconditioner (Vyas et al. 2024, arXiv:2409.11321).

For a weight matrix with gradient G, moving averages of G G^T and G^T G have eigenvectors Q_L and
Q_R. Adam's second moment is kept of Q_L^T G Q_R, where its entries are nearly uncorrelated. On the
matrices of a deep set this takes about a quarter of Adam's passes. Biases get plain Adam.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import Any

import torch
from torch import Tensor

from swarm_envs.training.force_model.flat import FlatWeights

_MOMENTS = (0.9, 0.999)
_PRECONDITIONER = 0.98
_REFRESH = 10
_FLOOR = 1e-8


class Soap(torch.optim.Optimizer):
    """SOAP on the flat weights of a network, all matrices at once in a padded stack."""

    def __init__(self, weights: FlatWeights, rate: float) -> None:
        """Start with empty moments.

        Args:
            weights: what is optimised; its gradient is read at every step.
            rate: learning rate, of the size of Adam's.
        """
        super().__init__([weights.values], {"lr": rate})
        shapes = [(matrix.shape[0], matrix.shape[1]) for matrix in weights.matrices()]
        places = torch.arange(weights.values.numel())
        self._source = torch.cat([part.reshape(-1) for part in weights.matrices(places)])
        self._size = max(max(shape) for shape in shapes)
        self._target = _padded_places(shapes, self._size)
        flat, stack = torch.zeros(len(places)), torch.zeros(len(shapes), self._size, self._size)
        basis = torch.eye(self._size).expand_as(stack)
        state: dict[str, Tensor] = {"step": torch.zeros(())}
        state |= {name: flat.clone() for name in ("first", "second")}
        state |= {name: stack.clone() for name in ("rotated", "left", "right")}
        state |= {name: basis.clone() for name in ("left_basis", "right_basis")}
        self.state[weights.values] = state

    @torch.no_grad()
    def step(self, closure: Callable[[], float] | None = None) -> None:  # type: ignore[override]
        """Move the weights by one step.

        Raises:
            ValueError: a closure is given; the gradient is taken as it is.
        """
        if closure is not None:
            raise ValueError("SOAP takes the gradient as it is; call step() without a closure")
        values = self.param_groups[0]["params"][0]
        state, gradient = self.state[values], values.grad
        state["step"] += 1
        first_decay, second_decay = _MOMENTS
        count = int(state["step"])
        state["first"].lerp_(gradient, 1.0 - first_decay)
        state["second"].mul_(second_decay).addcmul_(gradient, gradient, value=1.0 - second_decay)
        mean = state["first"] / (1.0 - first_decay**count)
        spread = 1.0 - second_decay**count
        move = mean / ((state["second"] / spread).sqrt() + _FLOOR)
        self._update_bases(state, self._stack(gradient))
        move[self._source] = self._rotated_move(state, gradient, mean, spread)
        values.sub_(move, alpha=self.param_groups[0]["lr"])

    def _stack(self, flat: Tensor) -> Tensor:
        """Matrices in a vector of weights, (M, n, n) with zeros around each."""
        stack = flat.new_zeros(self.state_of()["left"].shape)
        stack.view(-1)[self._target] = flat[self._source]
        return stack

    def state_of(self) -> dict[str, Any]:
        """Moments, preconditioners and bases: tensors by name, all that a checkpoint needs."""
        state: dict[str, Any] = self.state[self.param_groups[0]["params"][0]]
        return state

    def _rotated_move(
        self, state: dict[str, Any], gradient: Tensor, mean: Tensor, spread: float
    ) -> Tensor:
        """Adam's move of the matrices' entries, made in the eigenbases and turned back."""
        left, right = state["left_basis"], state["right_basis"]
        turned = left.mT @ self._stack(gradient) @ right
        decay = _MOMENTS[1]
        state["rotated"].mul_(decay).addcmul_(turned, turned, value=1.0 - decay)
        scale = (state["rotated"] / spread).sqrt() + _FLOOR
        move: Tensor = left @ (left.mT @ self._stack(mean) @ right / scale) @ right.mT
        return move.reshape(-1)[self._target]

    def _update_bases(self, state: dict[str, Any], gradient: Tensor) -> None:
        """Average the preconditioners, and every tenth step turn the bases after them."""
        begun = int(state["step"]) > 1
        share = 1.0 - _PRECONDITIONER if begun else 1.0
        products = {"left": gradient @ gradient.mT, "right": gradient.mT @ gradient}
        for side, product in products.items():
            state[side].lerp_(product, share)
            if not begun:
                state[f"{side}_basis"] = _eigenvectors(state[side])
            elif int(state["step"]) % _REFRESH == 0:
                state[f"{side}_basis"] = _iterated(state[side], state[f"{side}_basis"])


def _padded_places(shapes: Sequence[tuple[int, int]], size: int) -> Tensor:
    """Where the matrices' entries stand in a flattened stack of square ones."""
    parts = []
    for index, (rows, columns) in enumerate(shapes):
        row = torch.arange(rows)[:, None] * size
        parts.append((index * size * size + row + torch.arange(columns)).reshape(-1))
    return torch.cat(parts)


def _eigenvectors(symmetric: Tensor) -> Tensor:
    """Eigenvectors of (M, n, n) matrices, those of the largest values first.

    A gradient of low rank has a product with many eigenvalues of the size of rounding. On these
    LAPACK's divide and conquer in float32 fails now and then, as the processor rounds: it raises,
    or says nothing and returns NaN (github.com/pytorch/pytorch/issues/59720). In float64 the
    products of float32 numbers are far from its limits.
    """
    for matrices in (symmetric, symmetric.double()):
        with suppress(torch.linalg.LinAlgError):  # type: ignore[attr-defined]
            found: Tensor = torch.linalg.eigh(matrices)[1]
            if bool(found.isfinite().all()):
                return found.to(symmetric.dtype).flip(-1).contiguous()
    # Any orthogonal basis will do to begin with: with this one SOAP is Adam until it is turned.
    return torch.eye(symmetric.shape[-1], dtype=symmetric.dtype).expand_as(symmetric).contiguous()


def _iterated(symmetric: Tensor, basis: Tensor) -> Tensor:
    """One orthogonal iteration towards the eigenvectors of (M, n, n) matrices."""
    # The small multiple keeps columns of a null space, such as that of the padding, as they are.
    return torch.linalg.qr(symmetric @ basis + 1e-12 * basis)[0]
