"""What units do for each other: take the drones that they know, pass on what others lack."""

from __future__ import annotations

from swarm_envs.baselines.mlr_dmpc.knowledge import Knowledge
from swarm_envs.baselines.mlr_dmpc.messages import NONE, Kind, UnitMessage


def placed(know: Knowledge, chosen: list[int], round_: int) -> tuple[int, ...]:
    """Selected drones, by rank, so that no unit gets one whose trajectory it lacks.

    Args:
        know: what the leader knows.
        chosen: drones that may be planned anew.
        round_: when.
    """
    size = len(know.view.units)
    lacks = {unit: {m.drone for m in wishes} for unit, wishes in know.wishes.items()}
    lacks[know.unit] = {i for i in chosen if know.trackers[i].sole is None}
    slots = [NONE] * size
    taker = {know.view.rank(unit, round_): unit for unit in know.view.units}
    for drone in chosen:
        free = [rank for rank in range(size) if slots[rank] == NONE]
        fits = [r for r in free if drone not in lacks.get(taker[r], ())]
        slots[(fits or free)[0]] = drone
    return tuple(slots)


def relayed(know: Knowledge, message: UnitMessage) -> UnitMessage:
    """The message, with a trajectory that another unit lacks if this one has it."""
    for unit in sorted(know.wishes, key=lambda unit: (unit - know.unit) % 256):
        for wish in know.wishes[unit]:
            contents = know.trackers[wish.drone].contents(wish.identity)
            if contents is not None:
                return message._replace(kind=Kind.RELAY, drone=wish.drone, trajectory=contents)
    return message
