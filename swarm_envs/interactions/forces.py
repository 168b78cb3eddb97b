"""The force on every drone of an environment, whatever the model: one compiled entry."""

from __future__ import annotations

import numpy as np

from swarm_envs.compiled import borrowing_kernel, kernel
from swarm_envs.interactions.blocks import Scratch, scratch_for
from swarm_envs.interactions.deep_set import deep_set_forces
from swarm_envs.interactions.field import LEARNED, WAKE, ForceField
from swarm_envs.interactions.wake import wake_forces
from swarm_envs.interactions.window import pair_weight
from swarm_envs.state import BoolArray, FloatArray, IntArray


@borrowing_kernel
def environment_forces(
    field: ForceField,
    types: IntArray,
    position: FloatArray,
    velocity: FloatArray,
    scratch: Scratch,
    out: FloatArray,
) -> None:
    """Write the interaction and drag forces on N drones of one environment.

    Args:
        field: the model.
        types: (N,) interaction types, indices into the model's types.
        position: (N, 3) m, world frame.
        velocity: (N, 3) m/s, world frame.
        scratch: working memory for N drones, from `scratch_for`.
        out: (N, 3) forces f_a, N, world frame; overwritten.
    """
    drag = field.drag
    for i in range(position.shape[0]):
        for k in range(3):
            out[i, k] = -drag[types[i], k] * velocity[i, k]
    if field.kind == LEARNED:
        deep_set_forces(field, types, position, velocity, scratch, out)
    elif field.kind == WAKE:
        wake_forces(field, types, position, velocity, out)


@kernel
def all_forces(
    field: ForceField,
    types: IntArray,
    position: FloatArray,
    velocity: FloatArray,
    out: FloatArray,
) -> None:
    """`environment_forces` for every environment: arrays lead with (E, N)."""
    scratch = scratch_for(field, position.shape[1])
    for e in range(position.shape[0]):
        environment_forces(field, types[e], position[e], velocity[e], scratch, out[e])


@borrowing_kernel
def active_pairs(window: FloatArray, position: FloatArray) -> int:
    """Number of ordered pairs of one environment inside the interaction volume.

    Args:
        window: (4,) the model's window, m.
        position: (N, 3) m.
    """
    count = 0
    for i in range(position.shape[0]):
        for j in range(position.shape[0]):
            if i != j:
                dx = position[j, 0] - position[i, 0]
                dy = position[j, 1] - position[i, 1]
                dz = position[j, 2] - position[i, 2]
                count += pair_weight(window, dx, dy, dz) > 0.0
    return count


@borrowing_kernel
def outside_measured_range(
    field: ForceField, position: FloatArray, velocity: FloatArray, out: BoolArray
) -> None:
    """Mark the drones of one environment whose force is an extrapolation.

    A drone is marked when its own height (if too low) or speed, or the offset or relative speed of
    a neighbour inside the interaction volume, lies outside what was measured.

    Args:
        field: the model.
        position: (N, 3) m.
        velocity: (N, 3) m/s.
        out: (N,) marks, overwritten.
    """
    own, pair, window = field.environment_range, field.pair_range, field.window
    for i in range(position.shape[0]):
        outside = -position[i, 2] > own[1, 0]
        for k in range(3):
            outside |= not own[0, k + 1] <= -velocity[i, k] <= own[1, k + 1]
        for j in range(position.shape[0]):
            dx = position[j, 0] - position[i, 0]
            dy = position[j, 1] - position[i, 1]
            dz = position[j, 2] - position[i, 2]
            if j != i and pair_weight(window, dx, dy, dz) > 0.0:
                for k in range(3):
                    offset = position[j, k] - position[i, k]
                    speed = velocity[j, k] - velocity[i, k]
                    outside |= not pair[0, k] <= offset <= pair[1, k]
                    outside |= not pair[0, k + 3] <= speed <= pair[1, k + 3]
        out[i] = outside


def types_array(names: tuple[str, ...], types: tuple[str, ...]) -> IntArray:
    """Indices (N,) of interaction type names in a model's types; the names must be among them."""
    return np.array([types.index(name) for name in names], dtype=np.int64)
