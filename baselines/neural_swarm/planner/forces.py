"""How the forces on a whole team change with one robot's state: C_k of eq. (16), A_k of eq. (15).

Of a deep set the derivative is analytic, all knots at once. Other models are differentiated by
central differences, all knots and directions in one call of the compiled kernel.
"""

from __future__ import annotations

import numpy as np

from swarm_envs.baselines.neural_swarm.planner.deep_set_jacobian import deep_set_jacobian
from swarm_envs.interactions import InteractionModel
from swarm_envs.interactions.field import LEARNED
from swarm_envs.state import FloatArray
from swarm_envs.vehicles import Team

STEP = 1e-5
"""Half width of a central difference, m and m/s."""


def force_jacobian(
    model: InteractionModel, team: Team, states: FloatArray, robot: int
) -> FloatArray:
    """Derivative of the forces on every robot by the state of one.

    Where the model has a kink (a ReLU, the end of a measured range, the edge of the interaction
    volume), the derivative of one side, or of central differences a mean.

    Args:
        model: what is believed of the forces.
        team: the N vehicles.
        states: (K, N, 6) positions (m) and velocities (m/s) of all robots at K knots.
        robot: index i of the robot that moves.

    Returns:
        (K, N, 3, 6) d f_a(j) / d x(i): N per m and N per m/s.
    """
    if model.field.kind == LEARNED:
        field = model.with_precision("float64").field
        return deep_set_jacobian(field, model.type_indices(team), states, robot)
    return difference_jacobian(model, team, states, robot)


def difference_jacobian(
    model: InteractionModel, team: Team, states: FloatArray, robot: int, step: float = STEP
) -> FloatArray:
    """The same as `force_jacobian` by central differences, of any model.

    Args:
        model: what is believed of the forces.
        team: the N vehicles.
        states: (K, N, 6) positions (m) and velocities (m/s) at K knots.
        robot: index i of the robot that moves.
        step: half width of a difference, m and m/s.
    """
    knots, robots = states.shape[:2]
    moved = np.broadcast_to(states, (2, 6, *states.shape)).copy()
    for k in range(6):
        moved[0, k, :, robot, k] += step
        moved[1, k, :, robot, k] -= step
    flat = moved.reshape(12 * knots, robots, 6)
    forces = model.forces(flat[..., :3], flat[..., 3:], team).reshape(2, 6, knots, robots, 3)
    return np.moveaxis((forces[0] - forces[1]) / (2.0 * step), 0, -1)
