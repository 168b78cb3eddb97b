"""Networks and their optimisers as named tensors: what checkpoints hold in place of pickles."""

from __future__ import annotations

from collections.abc import Mapping

import torch
from torch import Tensor


def optimiser_tensors(optimiser: torch.optim.Optimizer, prefix: str) -> dict[str, Tensor]:
    """What an optimiser remembers: `<prefix><parameter's place>.<entry>`."""
    return {
        f"{prefix}{place}.{name}": torch.as_tensor(value).clone()
        for place, entries in optimiser.state_dict()["state"].items()
        for name, value in entries.items()
    }


def load_optimiser(
    optimiser: torch.optim.Optimizer, tensors: Mapping[str, Tensor], prefix: str
) -> None:
    """Give an optimiser what `optimiser_tensors` took of another.

    Raises:
        RuntimeError, ValueError: that one had other parameters.
    """
    state: dict[int, dict[str, Tensor]] = {}
    for name, tensor in without_prefix(tensors, prefix).items():
        place, _, entry = name.partition(".")
        state.setdefault(int(place), {})[entry] = tensor
    groups = optimiser.state_dict()["param_groups"]
    optimiser.load_state_dict({"state": state, "param_groups": groups})


def without_prefix(tensors: Mapping[str, Tensor], prefix: str) -> dict[str, Tensor]:
    """Those whose names begin so, by what follows."""
    return {n.removeprefix(prefix): t for n, t in tensors.items() if n.startswith(prefix)}
