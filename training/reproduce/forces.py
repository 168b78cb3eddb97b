"""Forces on one drone among neighbours, jointly and as a sum of pairs, in gram-force."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from swarm_envs.interactions import InteractionModel
from swarm_envs.state import FloatArray
from swarm_envs.vehicles import GRAM_FORCE


def force_on_ego_g(
    model: InteractionModel,
    team: Sequence[str],
    position: FloatArray,
    velocity: FloatArray | None = None,
) -> FloatArray:
    """Vertical force f_a,z on the first drone of each swarm.

    Args:
        model: whose forces.
        team: N vehicle types, the same in each swarm.
        position: (R, N, 3) m.
        velocity: (R, N, 3) m/s; None for rest.

    Returns:
        (R,) gram-force, up positive.
    """
    motion = np.zeros_like(position) if velocity is None else velocity
    force: FloatArray = model.forces(position, motion, "".join(team))[:, 0, 2] / GRAM_FORCE
    return force


def superposed_force_g(
    model: InteractionModel,
    team: Sequence[str],
    position: FloatArray,
    velocity: FloatArray | None = None,
) -> FloatArray:
    """What the force on the first drone would be if pairs added up, (R,) gram-force.

    f_0 + sum_j (f_j - f_0), with f_0 of the drone alone over the ground and f_j with neighbour j
    alone. The paper adds rho(phi_env) and rho(phi_j) (Sec. VII-C), which leaves the ground out of
    the pairs; only a network can be asked that, and it was never trained without its ground.

    Args:
        model: whose forces.
        team: N vehicle types, the same in each swarm.
        position: (R, N, 3) m.
        velocity: (R, N, 3) m/s; None for rest.
    """
    motion = np.zeros_like(position) if velocity is None else velocity
    alone = force_on_ego_g(model, team[:1], position[:, :1], motion[:, :1])
    total = alone.copy()
    for j in range(1, len(team)):
        pair = [0, j]
        force = force_on_ego_g(model, [team[0], team[j]], position[:, pair], motion[:, pair])
        total += force - alone
    return total
