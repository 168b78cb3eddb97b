"""Forces in several environments of a batch at once: the blocks of their networks are fuller."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba.extending import register_jitable

from swarm_envs.compiled import borrowing_kernel
from swarm_envs.interactions.blocks import Scratch, scratch_for
from swarm_envs.interactions.field import ForceField
from swarm_envs.interactions.forces import CHUNK, swarm_forces
from swarm_envs.state import BoolArray, FloatArray, IntArray


class Crowd(NamedTuple):
    """Working memory to evaluate forces in up to C environments at once, nothing to keep."""

    members: IntArray
    """(C,): which environments."""
    types: IntArray
    """(M,): interaction types of their drones, M = C N, one environment after the other."""
    position: FloatArray
    """(M, 3) m."""
    velocity: FloatArray
    """(M, 3) m/s."""
    force: FloatArray
    """(M, 3) N."""
    outside: BoolArray
    """(M,): whose force is an extrapolation."""
    scratch: Scratch
    """Working memory of the force model."""


@register_jitable  # type: ignore[untyped-decorator]
def crowd_for(field: ForceField, drones: int) -> Crowd:
    """Working memory for a model and environments of this many drones."""
    places = max(1, CHUNK // drones)
    total = places * drones
    return Crowd(
        np.zeros(places, np.int64),
        np.zeros(total, np.int64),
        np.zeros((total, 3)),
        np.zeros((total, 3)),
        np.zeros((total, 3)),
        np.zeros(total, np.bool_),
        scratch_for(field, total, drones),
    )


@borrowing_kernel
def crowd_forces(
    field: ForceField,
    count: int,
    types: IntArray,
    position: FloatArray,
    velocity: FloatArray,
    crowd: Crowd,
    out: FloatArray,
) -> None:
    """Write the forces on every drone of the first `count` members of a crowd.

    Args:
        field: the model.
        count: how many of `crowd.members` to evaluate, at least one.
        types: (E, N) interaction types.
        position: (E, N, 3) m, world frame.
        velocity: (E, N, 3) m/s, world frame.
        crowd: keeps the drones' motion and pairs afterwards.
        out: (E, N, 3) forces f_a, N, world frame; those of the members are overwritten.
    """
    drones = types.shape[1]
    for place in range(count):
        e = crowd.members[place]
        for i in range(drones):
            at = place * drones + i
            crowd.types[at] = types[e, i]
            for k in range(3):
                crowd.position[at, k] = position[e, i, k]
                crowd.velocity[at, k] = velocity[e, i, k]
    m = count * drones
    gathered, moving, force = crowd.position[:m], crowd.velocity[:m], crowd.force[:m]
    swarm_forces(field, drones, crowd.types[:m], gathered, moving, crowd.scratch, force)
    for place in range(count):
        e = crowd.members[place]
        for i in range(drones):
            for k in range(3):
                out[e, i, k] = force[place * drones + i, k]
