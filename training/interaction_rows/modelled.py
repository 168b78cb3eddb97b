"""Predictions of a force model for rows, to compare it with labels or another model."""

from __future__ import annotations

import numpy as np

from swarm_envs.interactions import InteractionModel, load
from swarm_envs.interactions.forces import all_forces
from swarm_envs.state import FloatArray
from swarm_envs.training.interaction_rows.rows import InteractionRows
from swarm_envs.vehicles import GRAM_FORCE

__all__ = ["modelled_force_g"]


def modelled_force_g(rows: InteractionRows, name: str | InteractionModel) -> FloatArray:
    """Return the force (R, 3) of an included model, or that of a file, in each row, gram-force.

    Raises:
        ValueError: the model has no forces on a vehicle of the rows, or is a function.
    """
    model, found = load(name), np.zeros((len(rows), 3))
    if unknown := sorted({*rows.types} - {*model.types}):
        raise ValueError(
            f"the rows have vehicles {', '.join(unknown)}, but {model.name} has no forces on them; "
            "give a model of these types, and no function"
        )
    place = np.array([model.types.index(kind) for kind in rows.types])
    for count in range(rows.neighbor_type.shape[1] + 1):
        own = rows.select(rows.has_neighbor.sum(axis=1) == count)
        if not len(own):
            continue
        order = np.argsort(~own.has_neighbor, axis=1, kind="stable")[:, :count]
        pair = np.take_along_axis(own.neighbor, order[..., None], axis=1)
        others = np.take_along_axis(own.neighbor_type, order, axis=1)
        position = np.concatenate([own.position[:, None], own.position[:, None] + pair[..., :3]], 1)
        velocity = np.concatenate([own.velocity[:, None], own.velocity[:, None] + pair[..., 3:]], 1)
        kinds = place[np.concatenate([own.ego_type[:, None], others], axis=1)]
        out = np.empty_like(position)
        all_forces(model.packed, kinds, position, velocity, out)
        found[rows.has_neighbor.sum(axis=1) == count] = out[:, 0] / GRAM_FORCE
    return found
