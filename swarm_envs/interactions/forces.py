"""The force on every drone of an environment, whatever the model: one compiled entry."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from swarm_envs.compiled import borrowing_kernel, kernel
from swarm_envs.errors import check_array, unknown_name
from swarm_envs.interactions.blocks import Scratch, scratch_for
from swarm_envs.interactions.deep_set import deep_set_forces
from swarm_envs.interactions.field import LEARNED, PAIRWISE, WAKE, ForceField
from swarm_envs.interactions.pairwise import pairwise_forces
from swarm_envs.interactions.wake import wake_forces
from swarm_envs.interactions.window import find_pairs, pair_weight
from swarm_envs.state import BoolArray, FloatArray, IntArray

CHUNK = 128
"""Drones whose forces are evaluated together: enough to fill blocks, few enough for the cache."""


@borrowing_kernel
def swarm_forces(
    field: ForceField,
    drones: int,
    types: IntArray,
    position: FloatArray,
    velocity: FloatArray,
    scratch: Scratch,
    out: FloatArray,
) -> None:
    """Write the interaction and drag forces on M drones, in environments of `drones` each.

    Args:
        field: the model.
        drones: number of drones in each environment, N; M is it or a multiple.
        types: (M,) interaction types, indices into the model's types.
        position: (M, 3) m, world frame.
        velocity: (M, 3) m/s, world frame.
        scratch: working memory for M drones, from `scratch_for`; knows their pairs afterwards.
        out: (M, 3) forces f_a, N, world frame; overwritten.
    """
    drag, order = field.drag, scratch.order
    scratch.found[0] = find_pairs(
        field.window, drones, position, order, scratch.pairs, scratch.weight
    )
    for i in range(position.shape[0]):
        for k in range(3):
            out[i, k] = -drag[types[i], k] * velocity[i, k]
    if field.kind == LEARNED:
        deep_set_forces(field, types, position, velocity, scratch, out)
    elif field.kind == WAKE:
        wake_forces(field, types, position, velocity, scratch, out)
    elif field.kind == PAIRWISE:
        pairwise_forces(field, types, position, velocity, scratch, out)


@kernel
def all_forces(
    field: ForceField,
    types: IntArray,
    position: FloatArray,
    velocity: FloatArray,
    out: FloatArray,
) -> None:
    """`swarm_forces` for arrays that lead with (E, N)."""
    drones = position.shape[1]
    total, chunk = types.size, max(1, CHUNK // drones) * drones
    scratch = scratch_for(field, min(chunk, total), drones)
    kinds, places = types.reshape(total), position.reshape(total, 3)
    speeds, forces = velocity.reshape(total, 3), out.reshape(total, 3)
    for a in range(0, total, chunk):
        b = min(a + chunk, total)
        swarm_forces(field, drones, kinds[a:b], places[a:b], speeds[a:b], scratch, forces[a:b])


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
    field: ForceField,
    position: FloatArray,
    velocity: FloatArray,
    scratch: Scratch,
    out: BoolArray,
) -> None:
    """Mark the drones whose force is an extrapolation.

    A drone is marked when its own height (if too low) or speed, or the offset or relative speed of
    a neighbour inside the interaction volume, lies outside what was measured.

    Args:
        field: the model.
        position: (M, 3) m.
        velocity: (M, 3) m/s.
        scratch: with which their forces have just been evaluated.
        out: (M,) marks, overwritten.
    """
    own, measured, pairs = field.environment_range, field.pair_range, scratch.pairs
    for i in range(position.shape[0]):
        outside = -position[i, 2] > own[1, 0]
        for k in range(3):
            outside |= not own[0, k + 1] <= -velocity[i, k] <= own[1, k + 1]
        out[i] = outside
    for pair in range(scratch.found[0]):
        i, j = pairs[0, pair], pairs[1, pair]
        outside = out[i]
        for k in range(3):
            offset, speed = position[j, k] - position[i, k], velocity[j, k] - velocity[i, k]
            outside |= not measured[0, k] <= offset <= measured[1, k]
            outside |= not measured[0, k + 3] <= speed <= measured[1, k + 3]
        out[i] = outside


def types_array(names: tuple[str, ...], types: tuple[str, ...], where: str = "") -> IntArray:
    """Indices (N,) of interaction type names in a model's types.

    Raises:
        ValueError: a name is not among them; the message says `where` it was asked for.
    """
    for name in names:
        if name not in types:
            raise ValueError(unknown_name("interaction type", name, types, where))
    return np.array([types.index(name) for name in names], dtype=np.int64)


def check_states(
    position: npt.ArrayLike, velocity: npt.ArrayLike, drones: int
) -> tuple[FloatArray, FloatArray]:
    """Return positions and velocities of environments with N drones as (E, N, 3) arrays.

    Raises:
        ValueError: the shapes are others, or an entry is not finite.
    """
    try:
        environments = np.shape(position)[:1]
    except ValueError:
        environments = (1,)  # ragged: no array at all, which is said below
    shape = (*environments, drones, 3)
    return (
        check_array("position", position, shape, "(E, N, 3), N drones in the team"),
        check_array("velocity", velocity, shape, "the shape of position"),
    )
