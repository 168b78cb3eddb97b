"""Working memory of the forces on a crowd: the drones of a few environments, side by side."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from swarm_envs.interactions.packed import PackedField
from swarm_envs.neighbors import FEW
from swarm_envs.state import FloatArray, IntArray
from swarm_envs.tables import Records, aligned

CROWD = 128
"""Drones whose forces are evaluated together: enough to fill blocks, few enough for the cache."""
SAMPLES = 32
"""Samples to which a network is applied at once."""

DRONE = np.dtype(
    [
        ("position", np.float64, (3,)),  # m, world frame; the first of all, see `Scratch.columns`
        ("velocity", np.float64, (3,)),  # m/s, world frame
        ("force", np.float64, (3,)),  # N, world frame
        ("motion", np.float64, (4,)),  # its -z and -v, kept within what was measured
        ("type", np.int64),  # interaction type
        ("outside", np.int64),  # whether the force is an extrapolation past what was measured
        ("low", np.int64),  # whether it feels the ground
        ("felt", np.int64),  # whether it feels anything of networks; else they give exactly 0
        ("pushed", np.float64),  # sum of all wakes on it
    ],
    align=True,
)
"""A drone of the crowd. Its type, position and velocity are set by the caller."""
PAIR = np.dtype(
    [
        ("i", np.int64),
        ("j", np.int64),
        ("weight", np.float64),  # what the window leaves of it
        ("motion", np.float64, (6,)),  # p_j - p_i and v_j - v_i, kept within what was measured
    ],
    align=True,
)
"""Drone `j` is felt by drone `i`."""
DESK = np.dtype(
    [
        ("pairs", np.int64),  # how many there are
        ("feeling", np.int64),  # how many drones are listed in `Scratch.felt`
        ("used", np.int64),  # how many samples the rows hold
        ("x", np.float64, (CROWD,)),  # m: of all environments' first drones, then all second
        ("y", np.float64, (CROWD,)),
        ("z", np.float64, (CROWD,)),
        ("near", np.int64, (CROWD,)),  # 1 where a pair is inside the interaction volume
        ("slot", np.int64, (SAMPLES,)),  # 2 i + part: to which drone's sum a sample is added
        ("share", np.float64, (SAMPLES,)),  # with which factor
    ],
    align=True,
)
"""Counters and lists of one evaluation."""


class Scratch(NamedTuple):
    """Working memory for C environments of N drones, M = C N; drone i of place c is c N + i."""

    drones: Records
    """(M,) records of `DRONE`."""
    columns: FloatArray
    """(M, 18) the same memory as plain numbers; the first three are the position."""
    order: IntArray | None
    """(2, M) the drones of each environment, by their index there, as last sorted along x; and
    indices for a moment. None if they are few."""
    felt: IntArray
    """(M,) the drones that feel more than drag."""
    pairs: Records
    """(P,) records of `PAIR`."""
    desk: Records
    """(1,) records of `DESK`."""
    rows: Records
    """Rows `v` of (2, width) numbers in the model's precision, each with two samples: `SAMPLES` / 2
    for the inputs of a layer, as many for its outputs, then one for the codes of each drone: as it
    flies, and alone at the anchor height."""


def scratch_for(field: PackedField, places: int, drones: int) -> Scratch:
    """Working memory to evaluate forces in up to `places` environments of `drones` at once.

    Raises:
        ValueError: these are more drones than is possible.
    """
    total = places * drones
    if drones <= FEW and total > CROWD:
        raise ValueError(f"{places} environments of {drones} drones are more than {CROWD} drones")
    memory = np.zeros(total, DRONE)
    number, shape = field.weights.dtype["v"].subdtype or (np.dtype(np.float64), (1, 1))
    row = np.dtype([("v", number, (2, shape[1]))])
    order = np.empty((2, total), np.int64)
    order[:] = np.arange(total) % max(1, drones)
    return Scratch(
        memory,
        memory.view(np.float64).reshape(total, -1),
        order if drones > FEW else None,
        np.zeros(total, np.int64),
        np.zeros(max(1, total * (drones - 1)), PAIR),
        np.zeros(1, DESK),
        aligned(SAMPLES + total, row),
    )
