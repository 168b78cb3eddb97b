"""The vertical force on one drone of a team, jointly and as a sum over its neighbors."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from swarm_envs.interactions import InteractionModel
from swarm_envs.state import FloatArray
from swarm_envs.vehicles import GRAM_FORCE


def force_on_first_g(
    model: InteractionModel,
    team: Sequence[str],
    position: FloatArray,
    velocity: FloatArray | None = None,
) -> FloatArray:
    """Return f_a,z (R,), g, on the first of a team at positions (R, N, 3), m; at rest if None."""
    motion = np.zeros_like(position) if velocity is None else velocity
    force: FloatArray = model.forces(position, motion, "".join(team))[:, 0, 2] / GRAM_FORCE
    return force


def superposed_force_g(
    model: InteractionModel,
    team: Sequence[str],
    position: FloatArray,
    velocity: FloatArray | None = None,
) -> FloatArray:
    """Return the force on the first drone if the forces of pairs added up, (R,), g.

    f_0 + sum_j (f_j - f_0), with f_0 of the drone alone over the ground and f_j with neighbor j
    alone. The paper adds rho(phi_env) and rho(phi_j) (Sec. VII-C), which leaves the ground out of
    the pairs; only a network can be asked that, and it was never trained without its ground.
    """
    motion = np.zeros_like(position) if velocity is None else velocity
    alone = force_on_first_g(model, team[:1], position[:, :1], motion[:, :1])
    total = alone.copy()
    for j in range(1, len(team)):
        pair = [0, j]
        force = force_on_first_g(model, [team[0], team[j]], position[:, pair], motion[:, pair])
        total += force - alone
    return total
