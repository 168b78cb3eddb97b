"""Communication between drones, with a limited range, delay and packet loss."""

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

_ACTIVE = 15  # Column of a message that is 1 until the episode of its sender ends
_PLACE = slice(16, 19)  # The sender's true position, by which the range is measured
_WIDTH = 19


class Communication:
    """The messages of drones, and the observations of neighbors by received messages.

    At each decision a drone broadcasts its measured position and velocity, its goal, type and
    loads. Drones that are within the range at this time, by true positions, receive the message
    after the delay, unless it is lost. A neighbor without a received message in a decision is not
    observed (`mask` 0). The observing drone's own state is not delayed.

    Args:
        neighbors: (E, N, K, width) fields of the observed neighbors, nearest first, as
            `write_neighbor` orders them; `write` overwrites them.
        mask: (E, N, K), overwritten too: 1 if there is a neighbor.
        range_m: the largest distance to a sender, m.
        delay: number of decisions between sending and receiving.
        loss: probability that a message to a drone is lost.
    """

    def __init__(
        self,
        neighbors: Float32Array,
        mask: Float32Array,
        range_m: float,
        delay: int,
        loss: float,
    ) -> None:
        self._neighbors, self._mask = neighbors, mask
        self._range_m, self._delay, self._loss = range_m, delay, loss
        num_envs, num_drones, _ = mask.shape
        self.messages: FloatArray = np.zeros((num_envs, delay + 1, num_drones, _WIDTH))
        """The messages of the last decisions, at the index of the decision modulo `delay` + 1."""
        self.keys: npt.NDArray[np.uint64] = np.zeros(num_envs, np.uint64)
        """The key of the random numbers of each environment's episode."""

    def begin(self, environment: int, generator: np.random.Generator) -> None:
        """Clear the messages of an environment, and sample the key of its losses."""
        self.messages[environment] = 0.0
        if self._loss > 0.0:
            self.keys[environment] = generator.integers(2**63)

    def write(
        self,
        where: npt.NDArray[np.intp],
        seen: Records,
        drones: Records,
        decisions: npt.NDArray[Any],
    ) -> None:
        """Send the messages of a decision, and write the neighbors that are received.

        Args:
            where: (E',) indices of the environments.
            seen: (E, N) measured records of the drones.
            drones: (E, N) true records.
            decisions: (E,) number of the decision in each episode.
        """
        slots, now = self._delay + 1, decisions[where].astype(np.int64)
        self.messages[where, now % slots] = _messages(seen[where], drones[where])
        sent = self.messages[where, (now - self._delay) % slots]
        received = self._received(where, now, sent)
        received &= (drones["active"][where] + drones["crashed"][where] > 0.0)[..., None]
        position, velocity = seen["position"][where], seen["velocity"][where]
        offset = sent[:, None, :, :3] - position[:, :, None]
        distance = np.where(received, _norm(offset), np.inf)
        nearest = np.argsort(distance, axis=-1, kind="stable")[..., : self._mask.shape[2]]
        found = np.take_along_axis(received, nearest, axis=2)
        fields = sent[np.arange(len(where))[:, None, None], nearest]
        fields[..., :3] -= position[:, :, None]
        fields[..., 3:6] = (fields[..., 3:6] - velocity[:, :, None]) / SPEED_LIMIT
        self._neighbors[where], self._mask[where] = 0.0, 0.0
        width, count = self._neighbors.shape[3], nearest.shape[2]
        self._neighbors[where, :, :count] = np.where(found[..., None], fields[..., :width], 0.0)
        self._mask[where, :, :count] = found

    def _received(
        self, where: npt.NDArray[np.intp], now: npt.NDArray[np.int64], sent: FloatArray
    ) -> BoolArray:
        """Return (E', N, N), True where drone i receives the message of drone j."""
        drones = sent.shape[1]
        place = sent[..., _PLACE]
        received: BoolArray = _norm(place[:, None] - place[:, :, None]) <= self._range_m
        received &= (sent[..., _ACTIVE] > 0.0)[:, None, :] & ~np.eye(drones, dtype=np.bool_)
        received &= (now >= self._delay)[:, None, None]
        if self._loss > 0.0:
            links = np.arange(drones**2, dtype=np.uint64).reshape(drones, drones)
            counter: Any = now.astype(np.uint64)[:, None, None] * np.uint64(drones**2) + links
            key: Any = self.keys[where][:, None, None]
            received &= uniform(key, counter) >= self._loss
        return received


def _norm(vectors: FloatArray) -> FloatArray:
    """Return the lengths of vectors (..., 3)."""
    return np.sqrt(np.einsum("...k,...k->...", vectors, vectors))


def _messages(seen: Records, drones: Records) -> FloatArray:
    """Return the messages (E, N, 19): position, velocity, goal, type, loads, activity, place."""
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
        drones["position"],
    ]
    return np.concatenate(parts, axis=-1)
