"""The messages of drones and compute units, and how they are packed into bytes.

A view names the compute units and drones that take part. Drones lock to one view, so that units of
two views never plan for the same drone.
"""

from __future__ import annotations

import math
import struct
from dataclasses import dataclass, field, replace
from enum import IntEnum
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from swarm_envs.baselines.mlr_dmpc.mlr_dmpc_config import MlrDmpcConfig
from swarm_envs.baselines.mlr_dmpc.trajectory import Identity, Trajectory, hover
from swarm_envs.state import BoolArray, FloatArray, IntArray


class ViewId(NamedTuple):
    """The identity of a view; a later epoch, then the higher proposer, takes precedence."""

    epoch: int  # Counts up with each proposal
    proposer: int  # The compute unit that proposed it

    @property
    def number(self) -> int:
        """Both as one integer, in the same order."""
        return self.epoch << 8 | self.proposer

    @staticmethod
    def of(number: int) -> ViewId:
        """Return the identity that has a number."""
        return ViewId(number >> 8, number & 255)


class MembershipView(NamedTuple):
    """The compute units and drones that take part."""

    id: ViewId
    units: tuple[int, ...]  # Compute units that plan, ascending
    drones: frozenset[int]  # Drones that are planned for and avoided
    gone: frozenset[int] = frozenset()  # Drones that have announced that they have landed

    def covers(self, earlier: MembershipView) -> bool:
        """Return True if each drone of an earlier view is in this one or has left."""
        return earlier.drones <= self.drones | self.gone

    def leader(self, round_: int) -> int:
        """Return the unit that selects in a round which drones are planned in the next one."""
        return self.units[round_ % len(self.units)]

    def rank(self, unit: int, round_: int) -> int:
        """Return the rank of a unit's selected drone: (k + w) mod M over the members."""
        return (round_ + self.units.index(unit)) % len(self.units)


NONE = -1  # No drone
UNSURE = -2  # A unit that was absent does not know which drone it planned for, if any
RECENT = 4  # The rounds whose own plans every message of a unit names


@dataclass(frozen=True, eq=False)
class DroneStates:
    """The drones' messages of a round. Rows of drones that sent none are meaningless."""

    round: int  # The round in which they are sent
    present: BoolArray  # (N,) True if the drone sent a message
    identity: IntArray  # (N,) `Identity.number` of the present trajectory
    lock: IntArray
    """(N,) `ViewId.number` of the view that the drone has locked to; it accepts plans of no
    other."""
    target: FloatArray  # (N, 3) target, m, as the message carries it
    kinematics: FloatArray
    """(N, 3, 3) position, velocity and acceleration, 16 bit; at rest the position, float32."""
    resting: BoolArray
    """(N,) True if the trajectory has ended, so that the position describes it fully."""
    joining: BoolArray  # (N,) True if it is not airborne yet: no plan for it has been accepted
    gone: BoolArray  # (N,) True if it is no longer airborne
    reinitialised: BoolArray  # (N,) True if it has abandoned a reference from which it was far off
    _paths: dict[int, Trajectory] = field(default_factory=dict)

    def heard(self, arrived: BoolArray) -> DroneStates:
        """Return the messages that have arrived (N,)."""
        return replace(self, present=self.present & arrived)

    def at_rest(self, drone: int, config: MlrDmpcConfig) -> Trajectory | None:
        """Return the trajectory of a drone at rest, which its message fully describes, or None."""
        if not self.resting[drone]:
            return None
        if drone not in self._paths:
            identity = Identity.of(int(self.identity[drone]))
            resting = hover(self.kinematics[drone, 0], config.num_inputs, config.input_sampling_s)
            self._paths[drone] = replace(resting, identity=identity)
        return self._paths[drone]


class MessageKind(IntEnum):
    """The kind of a message in a compute unit's slot."""

    EMPTY = 0  # No trajectory
    PLAN = 1  # A new trajectory for a drone, from the next round on
    RELAY = 2  # A trajectory that another unit has requested
    ANSWER = 3  # A drone's own trajectory, in a slot that was given to it


class Missing(NamedTuple):
    """A trajectory that a drone may fly and whose contents a unit lacks."""

    drone: int
    identity: Identity


class UnitMessage(NamedTuple):
    """The message in a compute unit's slot."""

    kind: MessageKind
    round: int  # The round in which it is sent
    unit: int  # The unit whose slot it is
    view: ViewId  # The sender's view: plans are for drones locked to it
    drone: int = NONE  # The drone of the trajectory
    trajectory: Trajectory | None = None
    selection: tuple[int, ...] | None = None
    """The drones that may be replanned in the next round, by rank; from the round's leader."""
    current: tuple[int, ...] | None = None
    """The selection for this round, if the unit has received it: others may have missed it."""
    recent: tuple[int, ...] = (UNSURE,) * RECENT
    """Drones that the unit planned for in this round and the ones before, newest first."""
    donations: tuple[int, ...] = ()  # Drones to which the slot is given in the next rounds
    missing: tuple[Missing, ...] = ()  # Contents that the unit lacks
    complete: bool = False  # True if it lacks nothing else and has located every drone
    members: MembershipView | None = None  # The view itself, while it is new
    priorities: tuple[tuple[int, int], ...] = ()
    """Drones and their priorities, highest first, as many as fit."""


SLOT_BYTES = 242  # The size of a compute unit's slot
REQUEST_BYTES = 132  # The largest message without a trajectory
_TRAJECTORY_BYTES = 204  # The trajectory for which the reference's slots are sized
_STEPS = 65535
_FLAGS = ("joining", "gone", "reinitialised")
_HEAD = np.dtype(
    [
        ("round", "<u2"),
        ("unit", "u1"),
        ("epoch", "<u2"),
        ("proposer", "u1"),
        ("flags", "u1"),
        ("target", "<u2", 3),
    ]
)  # The head of a drone's message


class Codec:
    """Packs the messages of a swarm.

    Slot, sender and round follow from the time at which a message arrives, so no message carries
    them. Messages that can be sent in one slot differ in their bytes: nodes therefore receive the
    messages themselves, and bytes are only counted.
    """

    def __init__(self, num_drones: int, num_units: int, config: MlrDmpcConfig) -> None:
        self._config, self._num_units, self._num_drones = config, num_units, num_drones
        self._id_bits = max(math.ceil(math.log2(num_drones - UNSURE)), 8)
        self._id_bytes = math.ceil(self._id_bits / 8)
        drone_bytes = math.ceil(num_drones / 8)
        self._mask_bytes = (math.ceil(num_units / 8), drone_bytes, drone_bytes)
        # Plans with more jerks than the reference's need larger slots.
        self._slot_bytes = SLOT_BYTES + max(0, 12 * (config.num_inputs + 2) - _TRAJECTORY_BYTES)
        lower, upper = np.array(config.box)
        self._lower = np.stack([lower, *([[-1.0] * 3] * 2)])
        self._span = np.stack([upper - lower, *([[2.0] * 3] * 2)])
        limits = np.array([config.speed_limit, config.acceleration_limit])[:, None]
        self._lower[1:] *= limits
        self._span[1:] *= limits

    def check_sizes(self, hovering: Trajectory) -> None:
        """Raise ValueError for more compute units or drones than messages can name.

        A message must have room for the selection, three donated slots and a relayed trajectory,
        here `hovering`; a message without a trajectory for the selection and a view.
        """
        units, view = self._num_units, MembershipView(ViewId(0, 0), (), frozenset())
        fullest = UnitMessage(
            MessageKind.RELAY, 0, 0, view.id, 0, hovering, (0,) * units, donations=(0, 0, 0)
        )
        over = len(self.pack(fullest)) - self._slot_bytes
        if over > 0:
            raise ValueError(
                f"compute_units is {units}, but a slot of {self._slot_bytes} bytes has no room to "
                f"name the drones of more than {units - math.ceil(8 * over / self._id_bits)}: use "
                "fewer units"
            )
        news = fullest._replace(kind=MessageKind.EMPTY, trajectory=None, donations=(), members=view)
        over = len(self.pack(news)) - REQUEST_BYTES
        if over > 0:
            raise ValueError(
                f"there are {self._num_drones} drones, but {REQUEST_BYTES} bytes have no room to "
                f"name more than {self._num_drones - 4 * over} members: use fewer drones"
            )

    def carried(self, kinematics: FloatArray) -> FloatArray:
        """Return position (and velocity, acceleration) (..., n, 3) rounded to 16 bit, in bounds."""
        lower, span = (side[: kinematics.shape[-2]] for side in (self._lower, self._span))
        return np.asarray(lower + self._steps(kinematics) * (span / _STEPS))

    def pack_states(self, states: DroneStates) -> list[bytes]:
        """Return the drones' messages, at most 32 bytes each."""
        heads = np.zeros(len(states.present), dtype=_HEAD)
        heads["round"], heads["unit"] = states.identity >> 8 & 0xFFFF, states.identity & 255
        heads["epoch"], heads["proposer"] = states.lock >> 8, states.lock & 255
        heads["flags"] = sum(getattr(states, name) << bit for bit, name in enumerate(_FLAGS))
        heads["target"] = self._steps(states.target[:, None])[:, 0]
        moving = self._steps(states.kinematics).astype("<u2")
        bodies = [
            states.kinematics[i, 0].astype("<f4") if r else moving[i]
            for i, r in enumerate(states.resting)
        ]
        return [heads[i].tobytes() + bodies[i].tobytes() for i in np.flatnonzero(states.present)]

    def filled(self, message: UnitMessage, order: list[tuple[int, int]]) -> UnitMessage:
        """Return the message with as many priorities as fit; less needed fields are dropped."""
        empty = message.kind is MessageKind.EMPTY
        limit = REQUEST_BYTES if empty else self._slot_bytes
        if len(self.pack(message)) > limit:
            message = message._replace(members=None)
        if len(self.pack(message)) > limit:
            message = message._replace(current=None)
        while len(self.pack(message)) > limit and message.missing:
            message = message._replace(missing=message.missing[:-1], complete=False)
        room = (limit - len(self.pack(message))) // (self._id_bytes + 1)
        if room < 0:
            raise ValueError(f"{message} does not fit into {limit} bytes: use fewer compute units")
        return message._replace(priorities=tuple(order[:room]))

    def pack(self, message: UnitMessage) -> bytes:
        """Return the bytes of a message in a compute unit's slot."""
        head = message.kind | (message.selection is not None) << 2
        head |= (message.members is not None) << 3
        head |= len(message.donations) << 4 | len(message.missing) << 6
        flags = message.complete | (message.current is not None) << 1
        out = struct.pack("<BHBB", head, *message.view, flags)
        if message.kind is not MessageKind.ANSWER:
            out += self._ids(message.recent)
        for selection in (message.selection, message.current):
            if selection is not None:
                padding = (NONE,) * (self._num_units - len(selection))
                out += self._ids(selection + padding)
        out += self._ids(message.donations)
        for missing in message.missing:
            out += self._ids((missing.drone,)) + _packed_identity(missing.identity)
        if message.members is not None:
            for ids, size in zip(message.members[1:], self._mask_bytes, strict=True):
                out += sum(1 << i for i in ids).to_bytes(size, "little")
        if message.trajectory is not None:
            out += self._ids((message.drone,))
            out += pack_trajectory(message.trajectory, message.kind is not MessageKind.PLAN)
        for drone, level in message.priorities:
            out += self._ids((drone,)) + bytes([level])
        return out

    def _steps(self, kinematics: FloatArray) -> npt.NDArray[np.int64]:
        count = kinematics.shape[-2]
        share = (kinematics - self._lower[:count]) / self._span[:count]
        return np.rint(np.minimum(np.maximum(share, 0.0), 1.0) * _STEPS).astype(np.int64)

    def _ids(self, ids: tuple[int, ...]) -> bytes:
        end = 1 << self._id_bits  # NONE and UNSURE, which are negative, become the largest numbers
        together = sum(i % end << k * self._id_bits for k, i in enumerate(ids))
        return together.to_bytes(math.ceil(len(ids) * self._id_bits / 8), "little")


def pack_trajectory(trajectory: Trajectory, named: bool) -> bytes:
    """Return a trajectory in float32, without its last jerk of zero; if `named`, with identity."""
    name = _packed_identity(trajectory.identity) if named else b""
    numbers = np.concatenate([trajectory.state, trajectory.jerk[:-1]])
    return name + numbers.astype("<f4").tobytes()


def _packed_identity(identity: Identity) -> bytes:
    return struct.pack("<HB", identity.start_round & 0xFFFF, identity.compute_unit)
