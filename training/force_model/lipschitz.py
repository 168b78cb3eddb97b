"""The largest gradients of a force network at random inputs.

They are lower bounds of a Lipschitz constant. The measured force changes by 100-150 g/m.
"""

from __future__ import annotations

import numpy as np
import torch

from swarm_envs.training.force_model.network import Batch, ForceNetwork
from swarm_envs.training.interaction_rows import NO_NEIGHBOR

SAMPLES = 20_000
"""Number of random inputs; more would find gradients that are larger by a few percent."""


def random_inputs(types: int, count: int, neighbors: int, rng: np.random.Generator) -> Batch:
    """Return random float64 inputs that cover the volume and the regions of large gradients.

    Neighbors are uniform in the interaction volume; a third is within about 8 cm of the axis, a
    tenth on it, and a tenth at rest. Heights are from 7 cm to 1.5 m, half of them below 0.6 m. The
    types of the drone and its neighbors are uniform.
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


def steepest(network: ForceNetwork, neighbors: int, rng: np.random.Generator) -> dict[str, float]:
    """Return the largest gradients of a float64 network at random inputs.

    One is with respect to a neighbor's relative position, in g/m, the other with respect to all
    inputs, positions in m and velocities in m/s, in g per unit.
    """
    batch = random_inputs(len(network.types), SAMPLES, neighbors, rng)
    inputs = batch.environment.requires_grad_(), batch.pair.requires_grad_()
    at_environment, at_pair = torch.autograd.grad(network(batch).sum(), inputs)
    position = torch.linalg.vector_norm(at_pair[..., :3], dim=-1)
    whole = torch.linalg.vector_norm(torch.cat([at_environment, at_pair.flatten(1)], 1), dim=1)
    return {
        "position_gradient_g_per_m": float(position.max()),
        "input_gradient_g_per_unit": float(whole.max()),
    }
