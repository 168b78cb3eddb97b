"""Communication between drones: neighbors are observed within a range, late, and not always."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from swarm_envs.envs.observation import Float32Array
from swarm_envs.noise import uniform
from swarm_envs.state import BoolArray, FloatArray
from swarm_envs.tables import Records
from swarm_envs.tasks.base import SPEED_LIMIT
from swarm_envs.vehicles import GRAVITY, SMALL

__all__ = ["Communication"]

_ACTIVE = 15  # Column of a message that is 1 while its sender flies
_WIDTH = 16


class Communication:
    """The messages that drones exchange, and the neighbors that they observe by them.

    At each decision a drone broadcasts its position and velocity as it measures them, its goal,
    type and loads. A drone receives the messages of the drones within the range when they were
    sent, after the delay; each is lost with a probability of its own. A neighbor without a message
    in a decision is not observed in it (`mask` 0). The observing drone's own state is not late.

    Args:
        num_envs: E.
        num_drones: N.
        range_m: the largest distance to a sender, m.
        delay: decisions between sending and receiving.
        loss: probability that a message is lost.
    """

    def __init__(
        self,
        num_envs: int,
        num_drones: int,
        range_m: float,
        delay: int,
        loss: float,
    ) -> None:
        self._square, self._delay, self._loss = range_m**2, delay, loss
        self.messages: FloatArray = np.zeros((num_envs, delay + 1, num_drones, _WIDTH))
        """The messages of the last decisions; a slot is a decision, modulo their number."""
        self.keys: npt.NDArray[np.uint64] = np.zeros(num_envs, np.uint64)
        """The random stream of each episode."""

    def begin(self, environment: int, generator: np.random.Generator) -> None:
        """Begin an episode: nothing has been sent, and losses follow the generator."""
        self.messages[environment] = 0.0
        if self._loss > 0.0:
            self.keys[environment] = generator.integers(2**63)

    def write(
        self,
        where: npt.NDArray[np.intp],
        seen: Records,
        drones: Records,
        decisions: npt.NDArray[Any],
        neighbors: Float32Array,
        mask: Float32Array,
    ) -> None:
        """Send the messages of a decision, and write the neighbors that are received.

        Args:
            where: indices of the environments.
            seen: (E, N) records of the drones as they are measured.
            drones: (E, N) true records.
            decisions: (E,) number of the decision in each episode.
            neighbors: (E, N, K, width) observed fields of the neighbors, nearest first, written.
            mask: (E, N, K), written: 1 where there is a neighbor.
        """
        slots, now = self._delay + 1, decisions[where].astype(np.int64)
        self.messages[where, now % slots] = _messages(seen[where], drones[where])
        sent = self.messages[where, (now - self._delay) % slots]
        received = self._received(where, now, sent)
        received &= (drones["active"][where] + drones["crashed"][where] > 0.0)[..., None]
        neighbors[where], mask[where] = 0.0, 0.0
        offset = sent[:, None, :, :3] - seen["position"][where][:, :, None]
        square = np.where(received, np.einsum("eijk,eijk->eij", offset, offset), np.inf)
        nearest = np.argsort(square, axis=-1, kind="stable")[..., : mask.shape[2], None]
        found = np.take_along_axis(received[..., None], nearest, axis=2)
        velocity = sent[:, None, :, 3:6] - seen["velocity"][where][:, :, None]
        others = np.broadcast_to(sent[:, None, :, 6:_ACTIVE], (*square.shape, _ACTIVE - 6))
        fields = np.concatenate([offset, velocity / SPEED_LIMIT, others], axis=-1)
        near = np.take_along_axis(fields, nearest, axis=2)[..., : neighbors.shape[3]]
        count = nearest.shape[2]
        neighbors[where, :, :count] = np.where(found, near, 0.0)
        mask[where, :, :count] = found[..., 0]

    def _received(
        self, where: npt.NDArray[np.intp], now: npt.NDArray[np.int64], sent: FloatArray
    ) -> BoolArray:
        """Return (E', N, N), True where drone i receives the message of drone j."""
        drones = sent.shape[1]
        apart = sent[:, None, :, :3] - sent[:, :, None, :3]
        received: BoolArray = np.einsum("eijk,eijk->eij", apart, apart) <= self._square
        received &= (sent[..., _ACTIVE] > 0.0)[:, None, :] & ~np.eye(drones, dtype=np.bool_)
        received &= (now >= self._delay)[:, None, None]
        if self._loss > 0.0:
            links = np.arange(drones**2, dtype=np.uint64).reshape(drones, drones)
            counter: Any = now.astype(np.uint64)[:, None, None] * np.uint64(drones**2) + links
            key: Any = self.keys[where][:, None, None]
            received &= uniform(key, counter) >= self._loss
        return received


def _messages(seen: Records, drones: Records) -> FloatArray:
    """Return what drones send (E, N, 16): position, velocity, goal, type, loads and activity."""
    weight = drones["nominal_mass"] * GRAVITY
    parts = [
        seen["position"],
        seen["velocity"],
        drones["goal"] - seen["position"],
        drones["type_code"],
        (4.0 * seen["rotor_limit"] / weight - 1.0)[..., None],
        (drones["nominal_mass"] / SMALL.mass)[..., None],
        seen["battery"][..., None],
        drones["active"][..., None],
    ]
    return np.concatenate(parts, axis=-1)
