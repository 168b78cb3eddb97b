"""Synchronous rounds: everybody sends in a slot of their own, and the radio loses some of it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Generic, TypeVar

import numpy as np

from swarm_envs.baselines.mlr_dmpc.loss import LossModel, LossProcess
from swarm_envs.baselines.mlr_dmpc.messages import DroneState
from swarm_envs.state import BoolArray

M = TypeVar("M")
"""What is said in compute units' slots."""


@dataclass(frozen=True)
class Inbox(Generic[M]):
    """What somebody has heard in a round."""

    round: int
    """When it was sent."""
    states: list[DroneState]
    """From drones' slots."""
    slots: dict[int, M]
    """From compute units' slots."""


@dataclass(frozen=True)
class RoundLog(Generic[M]):
    """All that was said in a round, and to whom it came: enough to replay it."""

    round: int
    """When it was sent."""
    states: dict[int, DroneState]
    """By drone."""
    slots: dict[int, M]
    """By compute unit's slot."""
    senders: dict[int, int]
    """Node that sent in each unit's slot: a drone where the slot was given to it."""
    arrived: BoolArray
    """(senders, receivers) by node, drones first; whether a message sent there came through."""


class Network(Generic[M]):
    """Carries a round's messages.

    Args:
        num_drones: N; nodes 0 to N - 1.
        num_units: M; nodes N to N + M - 1.
        loss: what is lost.
        seed: of the draws.
    """

    def __init__(self, num_drones: int, num_units: int, loss: LossModel, seed: int) -> None:
        self.num_drones = num_drones
        self._loss = LossProcess(loss, num_drones, num_units, seed)

    def carry(
        self,
        round_: int,
        states: dict[int, DroneState],
        slots: dict[int, M],
        senders: dict[int, int],
    ) -> RoundLog[M]:
        """Send a round's messages."""
        return RoundLog(round_, states, slots, senders, self._loss.arrivals(round_))

    def to_unit(self, log: RoundLog[M], unit: int) -> Inbox[M]:
        """What a compute unit hears of a round."""
        heard = log.arrived[:, self.num_drones + unit]
        states = [state for drone, state in log.states.items() if heard[drone]]
        return Inbox(log.round, states, self._slots(log, heard))

    def to_drone(self, log: RoundLog[M], drone: int) -> Inbox[M]:
        """What a drone hears of a round: it does not listen to other drones' states."""
        return Inbox(log.round, [], self._slots(log, log.arrived[:, drone]))

    def _slots(self, log: RoundLog[M], heard: BoolArray) -> dict[int, M]:
        return {unit: message for unit, message in log.slots.items() if heard[log.senders[unit]]}


_TRAFFIC_BYTES = np.array([16, 32, 64]) * 32.0 + 3 * 242.0
_ROUND_MS = np.array([255.0, 349.0, 809.0])


def round_length_s(num_drones: int, num_units: int) -> float:
    """How long a round must last for its computation and traffic, s.

    Straight lines in the bytes sent through the reference's three points, 255, 349 and 809 ms for
    16, 32 and 64 drones with three compute units, and on beyond them.

    Args:
        num_drones: N slots of 32 bytes.
        num_units: M slots of 242 bytes.
    """
    traffic = 32.0 * num_drones + 242.0 * num_units
    k = 0 if traffic < _TRAFFIC_BYTES[1] else 1
    slope = (_ROUND_MS[k + 1] - _ROUND_MS[k]) / (_TRAFFIC_BYTES[k + 1] - _TRAFFIC_BYTES[k])
    length = _ROUND_MS[k] + slope * (traffic - _TRAFFIC_BYTES[k])
    return float(1e-3 * max(length, 0.0))
