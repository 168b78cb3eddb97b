"""`pairwise`: a sum of pair forces by small networks, for comparison with the deep set.

The vertical force on drone i, in grams, is

    f_env,I(i)(-z, -v) + sum_j w_ij f_I(j)->I(i)(p_j - p_i, v_j - v_i),

with ReLU networks f and the window w of the interaction volume. Anchor and clamps are the deep
set's. What it cannot say is that two wakes push less than their sum (Neural-Swarm2, Sec. VII-C).
"""

from __future__ import annotations

from swarm_envs.compiled import kernel
from swarm_envs.interactions.deep_set import Networks, network, networks_of
from swarm_envs.interactions.field import ForceField
from swarm_envs.interactions.window import clamp, pair_weight
from swarm_envs.state import FloatArray, IntArray
from swarm_envs.vehicles import GRAM_FORCE


@kernel
def pairwise_forces(
    field: ForceField,
    types: IntArray,
    position: FloatArray,
    velocity: FloatArray,
    out: FloatArray,
) -> None:
    """Add the networks' vertical forces on N drones of one environment to `out`.

    Args:
        field: the model; its networks are those of the pairs, `[neighbour, drone]` in rows, then
            those of the types' environment.
        types: (N,) interaction types.
        position: (N, 3) m.
        velocity: (N, 3) m/s.
        out: (N, 3) forces, N, world frame.
    """
    nets = networks_of(field)
    kinds, anchor, window = field.drag.shape[0], field.anchor_height, field.window
    measured = field.pair_range
    for i in range(position.shape[0]):
        own, force = kinds * kinds + types[i], 0.0
        if anchor == 0.0 or position[i, 2] < anchor:
            force += ground_force(field, nets, own, position[i, 2], velocity, i)
            if anchor > 0.0:
                force -= ground_force(field, nets, own, anchor, velocity, i)
        for j in range(position.shape[0]):
            dx = position[j, 0] - position[i, 0]
            dy = position[j, 1] - position[i, 1]
            dz = position[j, 2] - position[i, 2]
            weight = pair_weight(window, dx, dy, dz) if j != i else 0.0
            if weight > 0.0:
                for k in range(3):
                    apart = position[j, k] - position[i, k]
                    nets.x[k] = clamp(apart, measured[0, k], measured[1, k])
                    moving = velocity[j, k] - velocity[i, k]
                    nets.x[k + 3] = clamp(moving, measured[0, k + 3], measured[1, k + 3])
                force += weight * network(nets, kinds * types[j] + types[i])[0]
        out[i, 2] += force * GRAM_FORCE


@kernel
def ground_force(
    field: ForceField, nets: Networks, n: int, height: float, velocity: FloatArray, i: int
) -> float:
    """Network `n` of the environment of drone `i` at `height` (m): gram-force."""
    measured, x = field.environment_range, nets.x
    x[0] = clamp(-height, measured[0, 0], measured[1, 0])
    for k in range(3):
        x[k + 1] = clamp(-velocity[i, k], measured[0, k + 1], measured[1, k + 1])
    return network(nets, n)[0]


def pairwise_names(types: tuple[str, ...]) -> list[str]:
    """Names of the networks in a weights file, in the order of the field."""
    pairs = [f"pair.{neighbor}.{ego}" for neighbor in types for ego in types]
    return [*pairs, *(f"environment.{name}" for name in types)]
