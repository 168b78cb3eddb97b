"""What changes a network's weights: one flat vector, SOAP, and limits of the spectral norms.

SOAP (Vyas et al. 2024, arXiv:2409.11321) is Adam in the eigenbasis of Shampoo's preconditioner.
For a weight matrix with gradient G, moving averages of G G^T and G^T G have eigenvectors Q_L and
Q_R. Adam's second moment is kept of Q_L^T G Q_R, where its entries are nearly uncorrelated. On the
matrices of a deep set this takes about a quarter of Adam's passes. Biases get plain Adam.

Spectral norms (Neural-Swarm2, eq. 12) are held without reparametrisation: after each step of the
optimiser the weight matrices themselves are scaled, so the weights file holds what was trained.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from typing import Any, Literal

import torch
from torch import Tensor, nn


class FlatWeights:
    """All parameters of a network as views of one vector, their gradients of another.

    Twenty small matrices cost an optimiser twenty times the calls of one vector.
    """

    values: nn.Parameter  # (P,) the weights; changing them changes the network

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
        """Refuse to go on from weights of a step, from 1, that no further step could repair."""
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


Spectral = Literal["clip", "exact", "none"]
"""What is done about spectral norms: at most, exactly, or nothing."""


@torch.no_grad()
def hold_spectral_norms(weights: Iterable[Tensor], norm: float, kind: Spectral = "clip") -> None:
    """Scale weight matrices in place so that they keep to a spectral norm, gamma^(1/L).

    `clip` scales a matrix whose norm is above `norm` down to it and never up, as the published code
    does; `exact` scales every matrix to exactly this norm, as eq. (12) is written.
    """
    if kind == "none":
        return
    for weight in weights:
        if weight.ndim != 2 or (kind == "clip" and _bound(weight) <= norm):
            continue
        found = float(torch.linalg.matrix_norm(weight, 2))
        if found == 0.0 and kind == "exact":
            raise ValueError(
                f"a weight matrix of shape {tuple(weight.shape)} is zero, so it cannot be scaled "
                f"to the spectral norm {norm}; train with the spectral clip instead"
            )
        if kind == "exact" or found > norm:
            weight.mul_(norm / found)


def _bound(weight: Tensor) -> float:
    """Upper bound of the spectral norm: (sum of its singular values' 8th powers)^(1/8).

    Some two per cent above it for our matrices, at a fifth of the cost of their singular values.
    """
    gram = weight @ weight.T if weight.shape[0] < weight.shape[1] else weight.T @ weight
    square = gram @ gram
    # Rounding must not hide a norm above the limit.
    return float(torch.linalg.vector_norm(square)) ** 0.25 * (1.0 + 1e-5)


_MOMENTS = (0.9, 0.999)
_PRECONDITIONER = 0.98
_REFRESH = 10
_FLOOR = 1e-8


class Soap(torch.optim.Optimizer):
    """SOAP on the flat weights of a network, all matrices at once in a padded stack."""

    def __init__(self, weights: FlatWeights, rate: float) -> None:
        """Start with empty moments; the rate is of the size of Adam's."""
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
        """Move the weights by one step."""
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
                # One orthogonal iteration. The small multiple keeps columns of a null space, such
                # as that of the padding, as they are.
                basis = state[f"{side}_basis"]
                turned = torch.linalg.qr(state[side] @ basis + 1e-12 * basis)[0]
                state[f"{side}_basis"] = turned


def _padded_places(shapes: Sequence[tuple[int, int]], size: int) -> Tensor:
    """Places of the matrices' entries in a flattened stack of square ones."""
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
