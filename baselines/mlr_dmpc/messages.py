"""What drones and compute units tell each other in their slots."""

from __future__ import annotations

from enum import IntEnum
from typing import NamedTuple

from swarm_envs.baselines.mlr_dmpc.trajectory import Identity, Trajectory
from swarm_envs.baselines.mlr_dmpc.views import View, ViewId
from swarm_envs.state import FloatArray

NONE = -1
"""No drone."""
UNSURE = -2
"""A unit no longer knows which drone it planned for, if any: it has been away."""
RECENT = 4
"""Rounds whose own plans every message of a unit names."""


class DroneState(NamedTuple):
    """What a drone says in its own slot."""

    drone: int
    """Whose slot it is."""
    round: int
    """When it is sent."""
    identity: Identity
    """Of the trajectory that it flies in this round."""
    lock: ViewId
    """The highest view that it has heard; it accepts plans of no other."""
    target: FloatArray
    """(3,) where it wants to go, m, as the message carries it."""
    kinematics: FloatArray
    """(1, 3) position at rest, float32; else (3, 3) with velocity and acceleration, 16 bit."""
    joining: bool = False
    """It is not in the air yet: no plan for it has been accepted."""
    gone: bool = False
    """It has left the air."""
    reinitialised: bool = False
    """It was so far off its reference that it has given that up."""

    @property
    def resting(self) -> bool:
        """Whether its trajectory has ended, so that the position is all there is to know."""
        return len(self.kinematics) == 1


class Kind(IntEnum):
    """What a message in a compute unit's slot carries."""

    EMPTY = 0
    """No trajectory."""
    PLAN = 1
    """A new trajectory for a drone, flown from the next round on."""
    RELAY = 2
    """A trajectory that another unit has asked for."""
    ANSWER = 3
    """Its own trajectory, by a drone that was given the slot."""


class Missing(NamedTuple):
    """A trajectory of which a unit knows that it may be flown, but not what it is."""

    drone: int
    """Whose."""
    identity: Identity
    """Which."""


class UnitMessage(NamedTuple):
    """What is said in a compute unit's slot."""

    kind: Kind
    """What it carries."""
    round: int
    """When it is sent."""
    unit: int
    """Whose slot it is."""
    view: ViewId
    """Of the sender: plans are for drones locked to it."""
    drone: int = NONE
    """Whose trajectory it carries."""
    trajectory: Trajectory | None = None
    """The trajectory."""
    selection: tuple[int, ...] | None = None
    """By the round's leader: drones that may be planned anew in the next round, by rank."""
    current: tuple[int, ...] | None = None
    """The same for this round, as far as the unit knows: others may have missed it."""
    recent: tuple[int, ...] = (UNSURE,) * RECENT
    """Drones that the unit planned for in this round and the ones before, newest first."""
    donations: tuple[int, ...] = ()
    """Drones to which the slot is given in the next rounds."""
    missing: tuple[Missing, ...] = ()
    """Contents that the unit lacks."""
    complete: bool = False
    """Whether it lacks nothing else and has located every drone."""
    members: View | None = None
    """The view itself, while it is new."""
    priorities: tuple[tuple[int, int], ...] = ()
    """Drones and their priorities, highest first, as many as fit."""


SlotMessages = dict[int, UnitMessage]
"""By slot."""
