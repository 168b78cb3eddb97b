"""Penalty that keeps the force's slope near what was measured, where nothing was measured too.

Spectral clipping alone allows slopes of a thousand grams per metre at speeds and places that no
flight visited, and at the edge of the window. The measured air changes by 100-150 g/m.
"""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from swarm_envs.training.force_model.network import Batch, ForceNetwork
from swarm_envs.training.interaction_rows import NO_NEIGHBOR


def random_inputs(types: int, count: int, neighbors: int, rng: np.random.Generator) -> Batch:
    """Draw inputs that cover the volume and the places where the force changes most.

    Neighbours stand uniformly in the interaction volume; for a third they stand within some
    8 cm of the axis, for a tenth on it, for a tenth at rest. Heights lie from 7 cm to 1.5 m, half
    of them below 0.6 m.

    Args:
        types: number of vehicle types, drawn uniformly for the drone and its neighbours.
        count: how many inputs.
        neighbors: how many neighbours each has.
        rng: source of every draw.

    Returns:
        float64 inputs.
    """
    speed = np.array([0.7, 0.7, 1.0])
    pair = rng.uniform(-1.0, 1.0, (count, neighbors, 6)) * [0.36, 0.36, 1.12, 1.1, 1.1, 1.2]
    near = rng.random((count, neighbors)) < 1 / 3
    pair[near, :2] = rng.normal(0.0, 0.08, (int(near.sum()), 2))
    pair[rng.random((count, neighbors)) < 0.1, :2] = 0.0
    pair[rng.random((count, neighbors)) < 0.1, 3:] = 0.0
    height = np.where(
        rng.random(count) < 0.5, rng.uniform(0.07, 0.6, count), rng.uniform(0.6, 1.5, count)
    )
    velocity = rng.uniform(-1.0, 1.0, (count, 3)) * speed
    velocity[rng.random(count) < 0.1] = 0.0
    environment = -np.concatenate([height[:, None], velocity], axis=1)
    kind = rng.integers(types, size=(count, neighbors))
    kind[rng.random(count) < 0.5, 1:] = NO_NEIGHBOR
    return Batch(
        ego_type=torch.from_numpy(rng.integers(types, size=count)),
        environment=torch.from_numpy(environment),
        pair=torch.from_numpy(pair),
        pair_type=torch.from_numpy(kind),
    )


def input_gradient(
    network: ForceNetwork, batch: Batch, keep_graph: bool = False
) -> tuple[Tensor, Tensor]:
    """Gradient of the network's force against its inputs.

    Args:
        network: what to differentiate.
        batch: R inputs.
        keep_graph: let the result be differentiated by the weights.

    Returns:
        (R, 4) against the environment's inputs and (R, K, 6) against the neighbours', in g per m
        and g per m/s.
    """
    environment = batch.environment.detach().requires_grad_(True)
    pair = batch.pair.detach().requires_grad_(True)
    force = network(batch._replace(environment=environment, pair=pair))
    at_environment, at_pair = torch.autograd.grad(
        force.sum(), (environment, pair), create_graph=keep_graph
    )
    return at_environment, at_pair


def joint_norm(environment: Tensor, pair: Tensor) -> Tensor:
    """Euclidean norm (R,) of the inputs (R, 4) and (R, K, 6) joined."""
    norm: Tensor = torch.linalg.vector_norm(torch.cat([environment, pair.flatten(1)], 1), dim=1)
    return norm


def slope_penalty(network: ForceNetwork, batch: Batch, limit: float) -> Tensor:
    """Mean square of what the gradient's norm exceeds `limit` by, (g per unit)^2."""
    norm = joint_norm(*input_gradient(network, batch, keep_graph=True))
    excess = torch.relu(norm - limit)
    return torch.mean(excess * excess)
