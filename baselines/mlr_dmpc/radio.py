"""The radio: every node sends in its own slot of synchronous rounds, and messages may be lost.

Losses of single messages, outages of receivers and bursts are drawn by keyed hashes.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Generic, TypeVar

import numpy as np
import numpy.typing as npt

from swarm_envs.baselines.mlr_dmpc.messages import DroneStates
from swarm_envs.errors import check_integer, check_number, check_type
from swarm_envs.state import BoolArray, FloatArray

__all__ = ["Jam", "LossModel"]

Who = str | tuple[str, ...]  # `all`, `drones`, `units`, `drone 3`, `unit 0`, or several of these

_UINT = npt.NDArray[np.uint64]
_MESSAGE, _OUTAGE, _TURN, _BURST = range(4)


def _names(who: Who) -> tuple[str, ...]:
    return (who,) if isinstance(who, str) else who


@dataclass(frozen=True, kw_only=True)
class Jam:
    """Rounds in which the messages of some nodes do not reach some others.

    Raises:
        ValueError: The rounds are not in order, or a name is unknown.
    """

    first_round: int
    """The first round that is jammed."""
    last_round: int
    """The last round that is jammed."""
    senders: Who = "all"
    """The nodes whose messages are lost."""
    receivers: Who = "all"
    """The nodes that do not receive them."""

    def __post_init__(self) -> None:
        """Raise ValueError for a value out of range."""
        for name in ("first_round", "last_round"):
            check_integer(name, getattr(self, name), at_least=0)
        for name in ("senders", "receivers"):
            check_type(name, getattr(self, name), str | tuple)
        if self.first_round > self.last_round:
            raise ValueError(
                f"a jam from round {self.first_round} to {self.last_round}: rounds must be in order"
            )
        for field in ("senders", "receivers"):
            for name in _names(getattr(self, field)):
                if not re.fullmatch(r"all|drones|units|(drone|unit) \d+", str(name)):
                    raise ValueError(
                        f"{field} has {name!r}, which names no drone: use all, drones, units, "
                        "'drone 3' or 'unit 0'"
                    )


@dataclass(frozen=True, kw_only=True)
class GilbertElliott:
    """A channel per receiver that is good or bad and changes at random between rounds.

    Raises:
        ValueError: A probability is outside [0, 1].
    """

    turns_bad: float
    """The probability that a good channel is bad in the next round."""
    turns_good: float
    """The probability that a bad channel is good in the next round."""
    loss_when_bad: float = 1.0
    """The share of messages that a bad channel loses."""

    def __post_init__(self) -> None:
        """Raise ValueError for a value out of range."""
        for name in ("turns_bad", "turns_good", "loss_when_bad"):
            check_number(name, getattr(self, name), at_least=0.0, at_most=1.0)


@dataclass(frozen=True, kw_only=True)
class LossModel:
    """The causes of message loss; a node's message to itself always arrives.

    Raises:
        ValueError: A probability is outside [0, 1].
    """

    unit_loss: float = 0.0
    """The probability that a compute unit misses a message."""
    drone_loss: float = 0.0
    """The probability that a drone misses a message."""
    outage: float = 0.0
    """The probability that a receiver misses a whole round."""
    bursts: GilbertElliott | None = None
    """The channel of each receiver, or None."""
    jams: tuple[Jam, ...] = ()
    """Periods in which all messages between certain nodes are lost."""

    def __post_init__(self) -> None:
        """Raise ValueError for a value out of range."""
        for name in ("unit_loss", "drone_loss", "outage"):
            check_number(name, getattr(self, name), at_least=0.0, at_most=1.0)
        check_type("bursts", self.bursts, GilbertElliott | None)
        check_type("jams", self.jams, tuple)
        for jam in self.jams:
            check_type("one of jams", jam, Jam)

    @classmethod
    def of(cls, loss: float | LossModel) -> LossModel:
        """Return a model for a share of messages lost, or the model itself.

        Raises:
            ValueError: The share is outside [0, 1].
        """
        if isinstance(loss, LossModel):
            return loss
        if isinstance(loss, bool) or not isinstance(loss, int | float) or not 0.0 <= loss <= 1.0:
            raise ValueError(f"loss is {loss!r}, but must be a share in [0, 1]")
        return cls(unit_loss=float(loss), drone_loss=float(loss))


class LossProcess:
    """The losses of each round, drawn by seed, round, sender and receiver (drones before units)."""

    def __init__(self, model: LossModel, num_drones: int, num_units: int, seed: int) -> None:
        self._model, self._seed = model, seed
        self._num_drones, self._nodes = num_drones, num_drones + num_units
        self._jams = [
            (jam, self._mask(jam.senders), self._mask(jam.receivers)) for jam in model.jams
        ]
        self._rates = np.full(self._nodes, model.unit_loss)
        self._rates[:num_drones] = model.drone_loss
        self._bad: list[BoolArray] = []

    def arrivals(self, round_: int) -> BoolArray:
        """Return (senders, receivers) True if a message of a round arrives."""
        model, nodes = self._model, np.arange(self._nodes)
        arrived = np.ones((self._nodes, self._nodes), dtype=bool)
        if self._rates.any():
            arrived &= self._draws(_MESSAGE, round_, nodes[:, None], nodes) >= self._rates
        if model.outage:
            arrived &= self._draws(_OUTAGE, round_, 0, nodes) >= model.outage
        if model.bursts:
            lost = self._draws(_BURST, round_, nodes[:, None], nodes) < model.bursts.loss_when_bad
            arrived &= ~(lost & self._channel(model.bursts, round_))
        for jam, senders, receivers in self._jams:
            if jam.first_round <= round_ <= jam.last_round:
                arrived &= ~np.outer(senders, receivers)
        np.fill_diagonal(arrived, True)
        return arrived

    def _channel(self, bursts: GilbertElliott, round_: int) -> BoolArray:
        """Return (receivers,) True if the channel is bad, stepped forward from round 0."""
        nodes = np.arange(self._nodes)
        while len(self._bad) <= round_:
            draw = self._draws(_TURN, len(self._bad), 0, nodes)
            if not self._bad:
                share = bursts.turns_bad / max(bursts.turns_bad + bursts.turns_good, 1e-12)
                self._bad.append(draw < share)
                continue
            before = self._bad[-1]
            self._bad.append(np.where(before, draw >= bursts.turns_good, draw < bursts.turns_bad))
        return self._bad[round_]

    def _draws(
        self, kind: int, round_: int, senders: int | npt.NDArray[np.int64], receivers: _Ints
    ) -> FloatArray:
        """Return draws, uniform in [0, 1), as hashes of their keys."""
        key = _mixed(np.array([self._seed], dtype=np.uint64) + np.uint64(kind << 48))
        key = _mixed(key ^ np.uint64(round_))
        key = _mixed(key ^ (np.asarray(senders).astype(np.uint64) << np.uint64(20)))
        key = _mixed(key ^ receivers.astype(np.uint64))
        return (key >> np.uint64(11)).astype(np.float64) * 2.0**-53

    def _mask(self, who: Who) -> BoolArray:
        counts = {"drone": self._num_drones, "unit": self._nodes - self._num_drones}
        nodes = [(kind, i) for kind, count in counts.items() for i in range(count)]
        mask = np.zeros(self._nodes, dtype=bool)
        for name in _names(who):
            meant = [name in ("all", f"{kind}s", f"{kind} {i}") for kind, i in nodes]
            if not any(meant):
                raise ValueError(
                    f"a jam names {name!r}, but there are "
                    f"{counts['drone']} drones and {counts['unit']} units"
                )
            mask |= meant
        return mask


_Ints = npt.NDArray[np.int64]


def _mixed(key: _UINT) -> _UINT:
    """Apply the finalizer of splitmix64 (Steele et al. 2014)."""
    key = key + np.uint64(0x9E3779B97F4A7C15)
    key = (key ^ (key >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    key = (key ^ (key >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return key ^ (key >> np.uint64(31))


M = TypeVar("M")  # The messages in compute units' slots


@dataclass(frozen=True)
class Inbox(Generic[M]):
    """The messages that a node has received in a round."""

    round: int  # The round in which they were sent
    states: DroneStates  # Messages in drones' slots
    slots: dict[int, M]  # Messages by compute unit's slot


@dataclass(frozen=True)
class RoundLog(Generic[M]):
    """All messages of a round and their receivers, enough to replay it."""

    round: int  # The round in which they were sent
    states: DroneStates  # Messages in drones' slots
    slots: dict[int, M]  # Messages by compute unit's slot
    senders: dict[int, int]
    """The node that sent in each unit's slot: a drone where the slot was given to it."""
    arrived: BoolArray
    """(senders, receivers) by node, drones first: True if a message arrived."""

    def inbox(self, node: int) -> Inbox[M]:
        """Return the messages that a node has received."""
        arrived = self.arrived[:, node]
        slots = {unit: m for unit, m in self.slots.items() if arrived[self.senders[unit]]}
        return Inbox(self.round, self.states.heard(arrived[: len(self.states.present)]), slots)
