"""Spectral normalization (Neural-Swarm2, version 1, eq. 12), held without reparametrization.

After each step of the optimizer the weight matrices themselves are scaled, so that a weights file
holds what was trained.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Literal

import torch
from torch import Tensor

Spectral = Literal["clip", "exact", "none"]
"""Constraints on spectral norms: a bound, an exact value, or none."""


@torch.no_grad()
def hold_spectral_norms(weights: Iterable[Tensor], norm: float, kind: Spectral = "clip") -> None:
    """Scale weight matrices in place so that they keep to a spectral norm.

    It is gamma^(1/(L+1)) for L + 1 matrices: four here, which Sec. VII-C calls four layers.

    `clip` scales a matrix whose norm is above `norm` down to it and never up, as the published code
    does; `exact` scales every matrix to exactly this norm, as eq. (12) is written.

    Raises:
        ValueError: a matrix is zero and cannot have exactly this norm.
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
    """Return an upper bound of the spectral norm: (sum of 8th powers of singular values)^(1/8).

    It is some two per cent above the norm of our matrices, at a fifth of the cost of their singular
    values.
    """
    gram = weight @ weight.T if weight.shape[0] < weight.shape[1] else weight.T @ weight
    square = gram @ gram
    # Rounding must not hide a norm above the limit.
    return float(torch.linalg.vector_norm(square)) ** 0.25 * (1.0 + 1e-5)
