"""Drones of some environments in blocks of lanes: the working memory of `fly`, filled and read."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from swarm_envs.compiled import part
from swarm_envs.interactions.packed import CHUNK
from swarm_envs.neighbors import FEW
from swarm_envs.physics.contact import PLACES, SPOT_TYPE
from swarm_envs.physics.hall_lanes import store_estimate
from swarm_envs.state import BoolArray, FloatArray, IntArray
from swarm_envs.tables import (
    ACTIVE,
    ADAPTATION_END,
    BLOCK_TYPE,
    BODY_END,
    CONTACT_COLUMNS,
    CONTACT_VALUES,
    CONTROLLER_END,
    LANES,
    VEHICLE_END,
    Records,
    aligned,
)

FAR = 1e6
"""Where drones whose episode has ended are taken to be, and how far from each other, m."""


class Work(NamedTuple):
    """Working memory of one thread, nothing to keep."""

    blocks: Records
    """Records of `LANES` drones: all drones of a tile, one environment after the other."""
    tile: FloatArray
    """(blocks, rows, LANES) the same memory as plain numbers."""
    members: IntArray
    """(C,) the environments of the tile."""
    due: IntArray
    """(C,) places of those whose force is due."""
    spots: Records
    """(N,) for `meet`."""
    position: FloatArray
    """(N, 3) for `meet_many`."""
    stopped: BoolArray
    """(drones of the tile,) who tumbled in this decision, or ended with its team by that."""


def new_work(num_drones: int) -> Work:
    """Working memory for environments of so many drones."""
    places = max(1, min(PLACES, CHUNK // num_drones))
    blocks = aligned(-(-places * num_drones // LANES), BLOCK_TYPE)
    return Work(
        blocks=blocks,
        tile=blocks.view(np.float64).reshape(len(blocks), -1, LANES),
        members=np.zeros(places, np.int64),
        due=np.zeros(places, np.int64),
        spots=aligned(num_drones if num_drones <= FEW else 0, SPOT_TYPE),
        position=np.zeros((num_drones, 3)),
        stopped=np.zeros(places * num_drones, np.bool_),
    )


@part
def load_tile(
    columns: FloatArray, count: int, controlled: bool, adaptive: bool, begins: bool, work: Work
) -> None:
    """Copy what a step knows of the drones of the first `count` members into the blocks.

    The columns of the tracking loop, and of its adaptation, are left out if there is none. Where a
    decision begins, what was touched in the last one is forgotten. Lanes that are left over in the
    last block repeat the last drone, so that numbers there are sound; they are not written back.
    Drones whose episode has ended come far away from all others, and are not written back either:
    so they neither touch nor push anybody, and stay as they were at their end.
    """
    drones, slot = columns.shape[1], 0
    skipped = BODY_END if controlled else CONTROLLER_END
    end = ADAPTATION_END if adaptive else VEHICLE_END
    for place in range(count):
        for i in range(drones):
            row, lane = columns[work.members[place], i], slot % LANES
            block = work.tile[slot // LANES]
            for c in range(BODY_END):
                block[c, lane] = row[c]
            for c in range(skipped, end):
                block[c, lane] = row[c]
            if begins:
                for k in range(len(CONTACT_COLUMNS)):
                    block[CONTACT_COLUMNS[k], lane] = CONTACT_VALUES[k]
            if row[ACTIVE] == 0.0:
                block[0, lane] = FAR * (i + 1)
            work.stopped[slot] = False
            slot += 1
    last, block = (slot - 1) % LANES, work.tile[(slot - 1) // LANES]
    for lane in range(last + 1, LANES):
        for c in range(end):
            block[c, lane] = block[c, last]


@part
def store_tile(
    columns: FloatArray, count: int, controlled: bool, adaptive: bool, work: Work
) -> None:
    """Copy what a step has changed back from the blocks."""
    for slot in range(count * columns.shape[1]):
        if not work.stopped[slot]:
            store_drone(columns, slot, controlled, adaptive, work)


@part
def store_drone(
    columns: FloatArray, slot: int, controlled: bool, adaptive: bool, work: Work
) -> None:
    """The same of one drone, unless its episode has ended."""
    drones, lane, block = columns.shape[1], slot % LANES, work.tile[slot // LANES]
    row = columns[work.members[slot // drones], slot % drones]
    if row[ACTIVE] == 0.0:
        return
    for c in range(CONTROLLER_END if controlled else BODY_END):
        row[c] = block[c, lane]
    for c in range(VEHICLE_END, ADAPTATION_END if adaptive else VEHICLE_END):
        row[c] = block[c, lane]


@part
def any_tumbles(blocks: Records, count: int) -> bool:
    """Whether a drone of the first `count` blocks has turned too fast in this decision."""
    fast = 0.0
    for n in range(count):
        for lane in range(LANES):
            fast += blocks[n].tumbling[lane]
    return fast > 0.0


@part
def stop_tumbling(
    columns: FloatArray,
    count: int,
    controlled: bool,
    adaptive: bool,
    team: bool,
    hall: bool | None,
    twisting: bool | None,
    work: Work,
) -> None:
    """End the flight of drones that tumble, or of their teams, at this physics step.

    They are written back as they are now, and no more in this decision. They come far away, as in
    `load_tile`: the others fly on.

    Args:
        columns: (E, N, columns) of the drones, written.
        count: members of the tile.
        controlled: whether the tracking loop flies.
        adaptive: whether it adapts.
        team: whether the episode of the team ends with that of one drone.
        hall: True in the world "hall", else None.
        twisting: True if the air has a torque on bodies, else None.
        work: whose blocks are read.
    """
    drones = columns.shape[1]
    for slot in range(count * drones):
        first = slot - slot % drones
        falls = work.blocks[slot // LANES].tumbling[slot % LANES] > 0.0
        for other in range(first, first + drones):
            if falls and (team or other == slot) and not work.stopped[other]:
                store_drone(columns, other, controlled, adaptive, work)
                if hall is not None:  # noqa: SIM114  # what is None is left out
                    store_estimate(columns, work.members, other, work.tile)
                elif twisting is not None:
                    store_estimate(columns, work.members, other, work.tile)
                work.stopped[other] = True
                b = work.blocks[other // LANES]
                b.position[0, other % LANES] = FAR * (other - first + 1)
