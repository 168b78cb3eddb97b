"""Forces of whole swarms from a network in torch: what the compiled model is held against."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

from swarm_envs.training.force_model.network import Batch, ForceNetwork
from swarm_envs.vehicles import GRAM_FORCE


def swarm_batch(position: Tensor, velocity: Tensor, types: Sequence[int]) -> Batch:
    """Rows of every drone of (E, N, 3) swarms, with all others as its neighbours."""
    envs, drones = position.shape[:2]
    others = torch.tensor([[j for j in range(drones) if j != i] for i in range(drones)])
    others = others.reshape(drones, drones - 1).long()
    kind = torch.tensor(list(types))
    state = torch.cat([position, velocity], dim=-1)
    pair = state[:, others] - state[:, :, None]
    environment = -torch.cat([position[..., 2:], velocity], dim=-1)
    return Batch(
        ego_type=kind.repeat(envs),
        environment=environment.reshape(envs * drones, 4),
        pair=pair.reshape(envs * drones, drones - 1, 6),
        pair_type=kind[others].repeat(envs, 1),
    )


def swarm_force_g(
    network: ForceNetwork, position: Tensor, velocity: Tensor, type_names: Sequence[str]
) -> Tensor:
    """Vertical force (E, N), gram-force, drag included, on every drone of (E, N, 3) swarms."""
    kinds = [network.types.index(name) for name in type_names]
    batch = swarm_batch(position, velocity, kinds)
    force: Tensor = network(batch).reshape(position.shape[:2])
    drag = network.drag[batch.ego_type, 2].reshape(force.shape)
    return force - drag * velocity[..., 2] / GRAM_FORCE
