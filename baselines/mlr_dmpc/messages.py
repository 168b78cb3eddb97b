"""What drones and compute units tell each other in their slots, and how it is packed into bytes.

Views say who takes part; drones lock to them so that no two of them plan at a time.
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
    """What orders views: a later epoch wins, then the higher proposer."""

    epoch: int  # Counts up with each proposal
    proposer: int  # Compute unit that proposed it

    @property
    def number(self) -> int:
        """Both as one integer, in the same order."""
        return self.epoch << 8 | self.proposer

    @staticmethod
    def of(number: int) -> ViewId:
        """The identity that has a number."""
        return ViewId(number >> 8, number & 255)


class MembershipView(NamedTuple):
    """Compute units and drones that take part."""

    id: ViewId  # Its place in the order
    units: tuple[int, ...]  # Compute units that plan, ascending
    drones: frozenset[int]  # Drones that are planned for and avoided
    gone: frozenset[int] = frozenset()  # Drones that have announced that they left the air

    def covers(self, earlier: MembershipView) -> bool:
        """Whether no drone of an earlier view is forgotten: each is in this one, or has left."""
        return earlier.drones <= self.drones | self.gone

    def leader(self, round_: int) -> int:
        """Who says in a round which drones are planned in the next one."""
        return self.units[round_ % len(self.units)]

    def rank(self, unit: int, round_: int) -> int:
        """Which of the selected drones a unit takes: (k + w) mod M over the members."""
        return (round_ + self.units.index(unit)) % len(self.units)


NONE = -1  # No drone
UNSURE = -2  # A unit no longer knows which drone it planned for, if any: it has been away
RECENT = 4  # Rounds whose own plans every message of a unit names


@dataclass(frozen=True, eq=False)
class DroneStates:
    """What drones say in their own slots of a round. Rows of who says nothing are meaningless."""

    round: int  # When it is sent
    present: BoolArray  # (N,) whose messages these are
    identity: IntArray  # (N,) `Identity.number` of the trajectory that each flies in this round
    lock: IntArray
    """(N,) `ViewId.number` of the view that it has locked to; it accepts plans of no other."""
    target: FloatArray  # (N, 3) where it wants to go, m, as the message carries it
    kinematics: FloatArray
    """(N, 3, 3) position, velocity and acceleration, 16 bit; at rest the position, float32."""
    resting: BoolArray
    """(N,) whether its trajectory has ended, so that the position is all there is to know."""
    joining: BoolArray  # (N,) it is not in the air yet: no plan for it has been accepted
    gone: BoolArray  # (N,) it has left the air
    reinitialised: BoolArray  # (N,) it was so far off its reference that it has given that up
    _paths: dict[int, Trajectory] = field(default_factory=dict)

    def heard(self, arrived: BoolArray) -> DroneStates:
        """Those messages that have arrived (N,)."""
        return replace(self, present=self.present & arrived)

    def at_rest(self, drone: int, config: MlrDmpcConfig) -> Trajectory | None:
        """The trajectory of a drone that rests, which its message carries whole."""
        if not self.resting[drone]:
            return None
        if drone not in self._paths:
            identity = Identity.of(int(self.identity[drone]))
            resting = hover(self.kinematics[drone, 0], config.num_inputs, config.input_sampling_s)
            self._paths[drone] = replace(resting, identity=identity)
        return self._paths[drone]


class MessageKind(IntEnum):
    """What a message in a compute unit's slot carries."""

    EMPTY = 0  # No trajectory
    PLAN = 1  # A new trajectory for a drone, flown from the next round on
    RELAY = 2  # A trajectory that another unit has asked for
    ANSWER = 3  # Its own trajectory, by a drone that was given the slot


class Missing(NamedTuple):
    """A trajectory of which a unit knows that it may be flown, but not what it is."""

    drone: int  # Whose
    identity: Identity  # Which


class UnitMessage(NamedTuple):
    """The message in a compute unit's slot."""

    kind: MessageKind  # What it carries
    round: int  # When it is sent
    unit: int  # Whose slot it is
    view: ViewId  # Of the sender: plans are for drones locked to it
    drone: int = NONE  # Whose trajectory it carries
    trajectory: Trajectory | None = None  # The trajectory
    selection: tuple[int, ...] | None = None
    """By the round's leader: drones that may be replanned in the next round, by rank."""
    current: tuple[int, ...] | None = None
    """The same for this round, as far as the unit knows: others may have missed it."""
    recent: tuple[int, ...] = (UNSURE,) * RECENT
    """Drones that the unit planned for in this round and the ones before, newest first."""
    donations: tuple[int, ...] = ()  # Drones to which the slot is given in the next rounds
    missing: tuple[Missing, ...] = ()  # Contents that the unit lacks
    complete: bool = False  # Whether it lacks nothing else and has located every drone
    members: MembershipView | None = None  # The view itself, while it is new
    priorities: tuple[tuple[int, int], ...] = ()
    """Drones and their priorities, highest first, as many as fit."""


SLOT_BYTES = 242  # A compute unit's slot
REQUEST_BYTES = 132  # A message without a trajectory
_TRAJECTORY_BYTES = 204  # for which the reference's slots are made
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
)  # of a drone's message


class Codec:
    """Packs the messages of a swarm.

    Slot, sender and round are known from when a message arrives, so no message carries them. No two
    messages that can be sent in one slot have the same bytes: nodes are handed the messages
    themselves, and bytes are counted.
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
        """Refuse more compute units and drones than messages can name.

        What messages cannot do without: the selection, three donated slots and a relayed
        trajectory, such as one that hovers; the selection and a view.
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
                f"say which take part of more than {self._num_drones - 4 * over}: use fewer drones"
            )

    def carried(self, kinematics: FloatArray) -> FloatArray:
        """(..., n, 3) position (and velocity, acceleration) as 16 bit carry them, in bounds."""
        lower, span = (side[: kinematics.shape[-2]] for side in (self._lower, self._span))
        return np.asarray(lower + self._steps(kinematics) * (span / _STEPS))

    def pack_states(self, states: DroneStates) -> list[bytes]:
        """The messages of those drones that say something, at most 32 bytes each."""
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
        """The message with as many priorities as fit; what others can do without goes first."""
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
        """A message in a compute unit's slot."""
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
        end = 1 << self._id_bits  # negative ones, NONE and UNSURE, become the largest numbers
        together = sum(i % end << k * self._id_bits for k, i in enumerate(ids))
        return together.to_bytes(math.ceil(len(ids) * self._id_bits / 8), "little")


def pack_trajectory(trajectory: Trajectory, named: bool) -> bytes:
    """A trajectory in float32 without its last jerk, which is zero; `named`: after its identity."""
    name = _packed_identity(trajectory.identity) if named else b""
    numbers = np.concatenate([trajectory.state, trajectory.jerk[:-1]])
    return name + numbers.astype("<f4").tobytes()


def _packed_identity(identity: Identity) -> bytes:
    return struct.pack("<HB", identity.start_round & 0xFFFF, identity.compute_unit)
