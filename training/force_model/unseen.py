"""Types that no training row shows as a drone, or as a neighbour: their networks are silent.

A network that saw no row holds the random numbers that it started with. It is set to zero, and the
report says so: a type that was never a neighbour pushes nobody, one that never was the drone of a
row feels nothing.
"""

from __future__ import annotations

import numpy as np
import torch
from torch import nn

from swarm_envs.training.force_model.network import DeepSet, ForceNetwork, layers
from swarm_envs.training.force_model.pairwise import PairwiseSum
from swarm_envs.training.interaction_rows.rows import BoolArray, InteractionRows


def silence_unseen(network: ForceNetwork, rows: InteractionRows) -> list[str]:
    """Set the outputs of networks that saw no training row to zero.

    Args:
        network: trained; changed in place.
        rows: what it was trained on; its validation rows do not count.

    Returns:
        What was silenced, a sentence each.
    """
    types = rows.types
    training = rows.select(~rows.validation)
    pairs = shown_pairs(training)
    felt = [bool((training.ego_type == index).any()) for index in range(len(types))]
    said = [
        f"type {name!r} is the drone of no training row: the model says it feels nothing"
        for name, seen in zip(types, felt, strict=True)
        if not seen
    ]
    silent = [name for name, seen in zip(types, felt, strict=True) if not seen]
    if isinstance(network, PairwiseSum):
        _silence(*(network.environment[name] for name in silent))
        unknown = [(a, b) for i, a in enumerate(types) for j, b in enumerate(types)
                   if not pairs[i, j] and felt[j]]  # fmt: skip
        _silence(*(network.network_of(a, b) for a in types for b in silent))
        _silence(*(network.network_of(a, b) for a, b in unknown))
        return said + [never_together(a, b) + "it does not push it" for a, b in unknown]
    assert isinstance(network, DeepSet)
    _silence(*(network.rho[name] for name in silent))
    if network.spec.torque:
        _silence(*(network.torque[name] for name in silent))
    quiet = [name for name, row in zip(types, pairs, strict=True) if not row.any()]
    _silence(*(network.phi[name] for name in quiet))
    guessed = [
        never_together(a, b) + "what it does to it is guessed from other pairs"
        for i, a in enumerate(types)
        for j, b in enumerate(types)
        if not pairs[i, j] and pairs[i].any() and felt[j]
    ]
    silenced = [
        f"type {name!r} is a neighbour in no training row: the model says it pushes nobody"
        for name in quiet
    ]
    return said + silenced + guessed


def shown_pairs(rows: InteractionRows) -> BoolArray:
    """Which of T types is a neighbour (first axis) of which (second) in some row, (T, T)."""
    pairs = np.zeros((len(rows.types), len(rows.types)), dtype=np.bool_)
    egos = np.repeat(rows.ego_type[:, None], rows.neighbor_type.shape[1], axis=1)
    pairs[rows.neighbor_type[rows.has_neighbor], egos[rows.has_neighbor]] = True
    return pairs


def never_together(above: str, below: str) -> str:
    """Beginning of a note on a pair of types that no training row shows."""
    return f"type {above!r} is a neighbour of type {below!r} in no training row: "


@torch.no_grad()
def _silence(*modules: nn.Module) -> None:
    for module in modules:
        last = layers(module)[-1]
        last.weight.zero_()
        last.bias.zero_()
