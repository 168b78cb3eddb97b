"""Messages as bytes: what a slot carries, to the bit."""

from __future__ import annotations

import math
import struct

import numpy as np
import numpy.typing as npt

from swarm_envs.baselines.mlr_dmpc.config import MlrDmpcConfig
from swarm_envs.baselines.mlr_dmpc.messages import (
    NONE,
    RECENT,
    UNSURE,
    DroneState,
    Kind,
    Missing,
    UnitMessage,
)
from swarm_envs.baselines.mlr_dmpc.trajectory import Identity, Trajectory
from swarm_envs.baselines.mlr_dmpc.views import View, ViewId
from swarm_envs.state import FloatArray

STATE_BYTES = 32
"""A drone's slot."""
SLOT_BYTES = 242
"""A compute unit's slot."""
REQUEST_BYTES = 132
"""A message without a trajectory."""
_TRAJECTORY_BYTES = 204  # for which the reference's slots are made
_STEPS = 65535
_FLAGS = ("joining", "gone", "reinitialised")


class Codec:
    """Packs and unpacks messages of a swarm; knows their sizes without packing.

    Slots and sender are known from when a message arrives, so no message carries them.
    """

    def __init__(self, num_drones: int, num_units: int, config: MlrDmpcConfig) -> None:
        self._config, self._num_units = config, num_units
        self._id_bytes = 1 if num_drones <= 254 else 2
        self._mask_bytes = (math.ceil(num_units / 8), math.ceil(num_drones / 8))
        self._trajectory_bytes = 36 + 12 * (config.num_inputs - 1)
        lower, upper = np.array(config.box)
        self._lower = np.stack([lower, *([[-1.0] * 3] * 2)])
        self._span = np.stack([upper - lower, *([[2.0] * 3] * 2)])
        limits = np.array([config.speed_limit, config.acceleration_limit])[:, None]
        self._lower[1:] *= limits
        self._span[1:] *= limits

    @property
    def slot_bytes(self) -> int:
        """Most that a unit's slot carries; plans with more jerks than the reference's need more."""
        return SLOT_BYTES + max(0, self._trajectory_bytes - _TRAJECTORY_BYTES)

    def carried(self, kinematics: FloatArray) -> FloatArray:
        """(n, 3) position (and velocity, acceleration) as 16 bit carry them, within bounds."""
        count = len(kinematics)
        return self._lower[:count] + self._steps(kinematics) * (self._span[:count] / _STEPS)

    def carried_targets(self, targets: FloatArray) -> FloatArray:
        """(N, 3) targets as 16 bit carry them."""
        steps = np.rint((targets - self._lower[0]) / self._span[0] * _STEPS)
        return np.asarray(self._lower[0] + steps * (self._span[0] / _STEPS))

    def state_size(self, state: DroneState) -> int:
        """Bytes of a drone's message."""
        return 25 if state.resting else 31

    def pack_state(self, state: DroneState) -> bytes:
        """A drone's message, at most 32 bytes."""
        flags = sum(getattr(state, name) << bit for bit, name in enumerate(_FLAGS))
        head = _packed_identity(state.identity) + struct.pack("<HBB", *state.lock, flags)
        target = self._steps(state.target[None]).astype("<u2").tobytes()
        if state.resting:
            return head + target + state.kinematics.astype("<f4").tobytes()
        return head + target + self._steps(state.kinematics).astype("<u2").tobytes()

    def unpack_state(self, data: bytes, drone: int, round_: int) -> DroneState:
        """The message that a drone has sent in a round."""
        identity = _unpacked_identity(data[:3], round_)
        epoch, proposer, bits = struct.unpack("<HBB", data[3:7])
        flags = {name: bool(bits >> bit & 1) for bit, name in enumerate(_FLAGS)}
        target = self._unsteps(np.frombuffer(data[7:13], "<u2").reshape(1, 3))[0]
        body = data[13:]
        if len(body) == 12:
            kinematics = np.frombuffer(body, "<f4").astype(np.float64).reshape(1, 3)
        else:
            kinematics = self._unsteps(np.frombuffer(body, "<u2").reshape(3, 3))
        lock = ViewId(epoch, proposer)
        return DroneState(drone, round_, identity, lock, target, kinematics, **flags)

    def limit(self, kind: Kind) -> int:
        """Most bytes that a message may have."""
        return REQUEST_BYTES if kind is Kind.EMPTY else self.slot_bytes

    def size(self, message: UnitMessage) -> int:
        """Bytes of a message."""
        count, width = len(message.donations), self._id_bytes
        size = 5 + width * (count + len(message.missing))
        size += 3 * len(message.missing) + (width + 1) * len(message.priorities)
        if message.kind is not Kind.ANSWER:
            size += width * RECENT
        size += width * self._num_units * sum(one is not None for one in _selections(message))
        if message.members is not None:
            size += sum(self._mask_bytes)
        if message.trajectory is not None:
            size += width + self._trajectory_bytes + (0 if message.kind is Kind.PLAN else 3)
        return size

    def filled(self, message: UnitMessage, ranked: list[tuple[int, int]]) -> UnitMessage:
        """The message with as many priorities as fit; what others can do without goes first.

        Raises:
            ValueError: even without them it does not fit.
        """
        limit = self.limit(message.kind)
        if self.size(message) > limit:
            message = message._replace(members=None)
        if self.size(message) > limit:
            message = message._replace(current=None)
        while self.size(message) > limit and message.missing:
            message = message._replace(missing=message.missing[:-1], complete=False)
        room = (limit - self.size(message)) // (self._id_bytes + 1)
        if room < 0:
            raise ValueError(f"{message} does not fit into {limit} bytes: use fewer compute units")
        return message._replace(priorities=tuple(ranked[:room]))

    def pack(self, message: UnitMessage) -> bytes:
        """A message in a compute unit's slot."""
        head = message.kind | (message.selection is not None) << 2
        head |= (message.members is not None) << 3
        head |= len(message.donations) << 4 | len(message.missing) << 6
        flags = message.complete | (message.current is not None) << 1
        out = struct.pack("<BHBB", head, *message.view, flags)
        if message.kind is not Kind.ANSWER:
            out += self._ids(message.recent)
        for selection in _selections(message):
            if selection is not None:
                padding = (NONE,) * (self._num_units - len(selection))
                out += self._ids(selection + padding)
        out += self._ids(message.donations)
        for missing in message.missing:
            out += self._ids((missing.drone,)) + _packed_identity(missing.identity)
        if message.members is not None:
            for ids, size in zip((message.members.units, message.members.drones), self._mask_bytes):
                out += sum(1 << i for i in ids).to_bytes(size, "little")
        if message.trajectory is not None:
            out += self._ids((message.drone,))
            out += pack_trajectory(message.trajectory, message.kind is not Kind.PLAN)
        for drone, level in message.priorities:
            out += self._ids((drone,)) + bytes([level])
        return out

    def unpack(self, data: bytes, unit: int, round_: int) -> UnitMessage:
        """The message that was sent in a unit's slot in a round."""
        reader = _Reader(data)
        head, epoch, proposer, flags = struct.unpack("<BHBB", reader.take(5))
        view, kind = ViewId(epoch, proposer), Kind(head & 3)
        message = UnitMessage(kind, round_, unit, view, complete=bool(flags & 1))
        if kind is not Kind.ANSWER:
            message = message._replace(recent=self._read_ids(reader, RECENT))
        if head >> 2 & 1:
            message = message._replace(selection=self._read_ids(reader, self._num_units))
        if flags >> 1 & 1:
            message = message._replace(current=self._read_ids(reader, self._num_units))
        donations = self._read_ids(reader, head >> 4 & 3)
        missing = []
        for _ in range(head >> 6):
            (drone,) = self._read_ids(reader, 1)
            missing.append(Missing(drone, _unpacked_identity(reader.take(3), round_)))
        message = message._replace(donations=donations, missing=tuple(missing))
        if head >> 3 & 1:
            units, drones = (
                [i for i in range(8 * size) if bits >> i & 1]
                for size in self._mask_bytes
                for bits in [int.from_bytes(reader.take(size), "little")]
            )
            message = message._replace(members=View(view, tuple(units), frozenset(drones)))
        if kind is not Kind.EMPTY:
            message = self._with_trajectory(reader, message)
        pairs = []
        while reader.left:
            (drone,) = self._read_ids(reader, 1)
            pairs.append((drone, reader.take(1)[0]))
        return message._replace(priorities=tuple(pairs))

    def _with_trajectory(self, reader: _Reader, message: UnitMessage) -> UnitMessage:
        (drone,) = self._read_ids(reader, 1)
        sent = Identity(message.round + 1, message.unit) if message.kind is Kind.PLAN else None
        size = self._trajectory_bytes + (3 if sent is None else 0)
        trajectory, _ = unpack_trajectory(reader.take(size), sent, message.round, self._config)
        return message._replace(drone=drone, trajectory=trajectory)

    def _steps(self, kinematics: FloatArray) -> npt.NDArray[np.int64]:
        count = len(kinematics)
        share = (kinematics - self._lower[:count]) / self._span[:count]
        return np.rint(np.minimum(np.maximum(share, 0.0), 1.0) * _STEPS).astype(np.int64)

    def _unsteps(self, steps: npt.NDArray[np.uint16]) -> FloatArray:
        count = len(steps)
        return np.asarray(self._lower[:count] + steps * (self._span[:count] / _STEPS))

    def _ids(self, ids: tuple[int, ...]) -> bytes:
        special = {NONE: 256**self._id_bytes - 1, UNSURE: 256**self._id_bytes - 2}
        return b"".join(special.get(i, i).to_bytes(self._id_bytes, "little") for i in ids)

    def _read_ids(self, reader: _Reader, count: int) -> tuple[int, ...]:
        size = self._id_bytes
        special = {256**size - 1: NONE, 256**size - 2: UNSURE}
        read = (int.from_bytes(reader.take(size), "little") for _ in range(count))
        return tuple(special.get(i, i) for i in read)


def pack_trajectory(trajectory: Trajectory, named: bool) -> bytes:
    """A trajectory in float32, after its identity if that is not clear from the slot.

    The last jerk is zero and is not sent.
    """
    name = _packed_identity(trajectory.identity) if named else b""
    numbers = np.concatenate([trajectory.state, trajectory.jerk[:-1]])
    return name + numbers.astype("<f4").tobytes()


def unpack_trajectory(
    data: bytes, identity: Identity | None, round_: int, config: MlrDmpcConfig
) -> tuple[Trajectory, bytes]:
    """A trajectory, and the bytes after it.

    Args:
        data: bytes that begin with it.
        identity: if that is not among them.
        round_: when it was sent.
        config: how many jerks there are.
    """
    if identity is None:
        identity, data = _unpacked_identity(data[:3], round_), data[3:]
    size = 36 + 12 * (config.num_inputs - 1)
    numbers = np.frombuffer(data[:size], "<f4").reshape(-1, 3)
    jerk = np.concatenate([numbers[3:], np.zeros((1, 3))])
    return Trajectory(identity, numbers[:3], jerk, config.input_sampling_s), data[size:]


def _selections(message: UnitMessage) -> tuple[tuple[int, ...] | None, ...]:
    return message.selection, message.current


class _Reader:
    """Bytes, taken from the front."""

    def __init__(self, data: bytes) -> None:
        self._data, self._at = data, 0

    @property
    def left(self) -> int:
        return len(self._data) - self._at

    def take(self, count: int) -> bytes:
        self._at += count
        return self._data[self._at - count : self._at]


def _packed_identity(identity: Identity) -> bytes:
    return struct.pack("<HB", identity.start_round & 0xFFFF, identity.compute_unit)


def _unpacked_identity(data: bytes, round_: int) -> Identity:
    """The identity whose start, known to 16 bit, is not after the next round."""
    low, unit = struct.unpack("<HB", data)
    return Identity(round_ + 1 - ((round_ + 1 - low) & 0xFFFF), unit)
