"""The information of a compute unit on drones: trajectories that each may fly, and their contents.

Each drone has a row of slots. A slot holds the number of an identity, whether the drone may fly it,
and its contents if they are known; trajectories that it does not fly are kept for a while.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from swarm_envs.baselines.mlr_dmpc.trajectory import Identity, Trajectory
from swarm_envs.state import BoolArray, IntArray

_FREE = -1  # The number in a slot that is not used
_SLOTS = 8  # Slots of each drone at first
_REMEMBERED = 3  # Trajectories that are kept for requests of others, even if they are not flown


class SeparationGuarantee(NamedTuple):
    """The separation of a plan of unknown contents from the trajectories flown when it was made."""

    round: int
    """The round in which it was planned, separated by planes from all trajectories flown then."""
    parents: tuple[Trajectory, ...]
    """The trajectories that the drone may have flown then, one of which gave the planes."""


class InformationTrackers:
    """The candidates of N drones at one compute unit (D_iw), in rows of C slots.

    `covering`: the candidates contain the true one (Lemma L1); in the paper's word, the tracker is
    not deprecated. `sole`: there is no other candidate either. All units of the view that also
    received a drone's last message hold the same candidates for it (Lemma L2).
    """

    def __init__(self, num_drones: int) -> None:
        self.numbers: IntArray = np.full((num_drones, _SLOTS), _FREE)
        """(N, C) identities by `Identity.number`."""
        self.possible: BoolArray = np.zeros((num_drones, _SLOTS), dtype=bool)
        """(N, C) True if the drone may fly it now or from the next round on."""
        self.located: BoolArray = np.zeros(num_drones, dtype=bool)
        """(N,) True if it sent a message, locked to the unit's view, since that was adopted."""
        self.confirmed: IntArray = np.full(num_drones, -1)
        """(N,) round of the drone's last such message, or -1."""
        self._known: BoolArray = np.zeros((num_drones, _SLOTS), dtype=bool)
        self._contents: npt.NDArray[Any] = np.full((num_drones, _SLOTS), None, dtype=object)
        self._guarantees: dict[tuple[int, int], SeparationGuarantee] = {}

    @property
    def lacking(self) -> BoolArray:
        """(N, C) True for candidates of unknown contents."""
        return np.asarray(self.possible & ~self._known)

    @property
    def covering(self) -> BoolArray:
        """(N,) True if the true trajectory is among the candidates (Lemma L1)."""
        return np.asarray(self.located & ~self.lacking.any(axis=1))

    def sole(self, drone: int) -> Trajectory | None:
        """Return the only trajectory that the drone can fly; None if there are several."""
        (slots,) = np.nonzero(self.possible[drone])
        if not self.located[drone] or len(slots) != 1 or not self._known[drone, slots[0]]:
            return None
        only: Trajectory = self._contents[drone, slots[0]]
        return only

    def candidates(self, drones: BoolArray) -> tuple[IntArray, list[Trajectory]]:
        """Return drones and contents of known candidates of drones (N,), by drone and identity."""
        rows, slots = self._ordered(self.possible & self._known & drones[:, None])
        return rows, self._contents[rows, slots].tolist()

    def missing(self, drones: BoolArray) -> list[tuple[int, Identity]]:
        """Return drones and identities of candidates of unknown contents, in the same order."""
        rows, slots = self._ordered(self.lacking & drones[:, None])
        numbers = self.numbers[rows, slots].tolist()
        return [(i, Identity.of(one)) for i, one in zip(rows.tolist(), numbers, strict=True)]

    def newest(self) -> list[Trajectory | None]:
        """Return by drone the candidate of known contents with the latest start."""
        numbers = np.where(self.possible & self._known, self.numbers, _FREE)
        slots = numbers.argmax(axis=1)[:, None]
        found = np.take_along_axis(self._contents, slots, axis=1)
        found[np.take_along_axis(numbers, slots, axis=1) == _FREE] = None
        newest: list[Trajectory | None] = found.ravel().tolist()
        return newest

    def settled(self, round_: int) -> BoolArray:
        """Return (N,) True if at most one candidate has begun and none lacks its contents."""
        begun = self.possible & (self.numbers >> 8 < round_)
        return np.asarray(self.covering & self.possible.any(axis=1) & (begun.sum(axis=1) <= 1))

    def guarantee(self, drone: int, identity: Identity) -> SeparationGuarantee | None:
        """Return the guarantee of a plan of unknown contents, if there is one."""
        return self._guarantees.get((drone, identity.number))

    def contents(self, drone: int, identity: Identity) -> Trajectory | None:
        """Return a trajectory if it is still stored."""
        (slots,) = np.nonzero((self.numbers[drone] == identity.number) & self._known[drone])
        return self._contents[drone, slots[0]] if len(slots) else None

    def lose(self, drones: BoolArray | slice = slice(None)) -> None:
        """Mark drones as not located."""
        self.located[drones], self.confirmed[drones] = False, -1

    def locate(
        self,
        drones: IntArray,
        numbers: IntArray,
        round_: int,
        at_rest: Callable[[int], Trajectory | None],
    ) -> None:
        """Store the present trajectories, by numbers (D,), that drones (D,) of the view reported.

        Other candidates that have begun are discarded. `at_rest` gives the trajectory of a drone at
        rest, which its message fully describes.
        """
        later = self.numbers[drones] >> 8 > round_
        self.possible[drones] &= later & self.located[drones][:, None]
        slots = self._slots(drones, numbers)
        self.possible[drones, slots] = True
        self.located[drones], self.confirmed[drones] = True, round_
        unknown = ~self._known[drones, slots]
        for drone, slot in zip(drones[unknown].tolist(), slots[unknown].tolist(), strict=True):
            self._contents[drone, slot] = at_rest(drone)
            self._known[drone, slot] = self._contents[drone, slot] is not None
        self._forget(drones)

    def add(self, drones: IntArray, identity: Identity, promises: bool) -> None:
        """Add a plan that may have been sent to one of the drones (D,).

        `promises`: True to store the guarantee of a plan of unknown contents.
        """
        if promises:
            self._promise(drones, identity)
        slots = self._slots(drones, np.full(len(drones), identity.number))
        self.possible[drones, slots] = True

    def learn(self, drone: int, contents: Trajectory) -> None:
        """Store a trajectory of the drone, possible or not."""
        (slot,) = self._slots(np.array([drone]), np.array([contents.identity.number]))
        self._contents[drone, slot], self._known[drone, slot] = contents, True

    def strike(self, planned: Mapping[int, int]) -> None:
        """Discard plans, by number, of all drones but the only one to which each was sent."""
        recent = self.possible & (self.numbers >= min(planned, default=math.inf))
        for drone, slot in np.argwhere(recent).tolist():
            if planned.get(int(self.numbers[drone, slot]), drone) != drone:
                self.possible[drone, slot] = False

    def _ordered(self, slots: BoolArray) -> tuple[IntArray, IntArray]:
        """Return drones and slots of a mask (N, C), by drone and then by number."""
        rows, columns = np.nonzero(slots)
        order = np.lexsort((self.numbers[rows, columns], rows))
        return rows[order], columns[order]

    def _slots(self, drones: IntArray, numbers: IntArray) -> IntArray:
        """Return the slot (D,) of a number (D,) in each drone's row, or a free one."""
        rows = self.numbers[drones]
        match, free = rows == numbers[:, None], rows == _FREE
        if not (match | free).any(axis=1).all():
            more = InformationTrackers(len(self.located))
            for name in ("numbers", "possible", "_known", "_contents"):
                both = np.concatenate([getattr(self, name), getattr(more, name)], axis=1)
                setattr(self, name, both)
            return self._slots(drones, numbers)
        slots = np.where(match.any(axis=1), match.argmax(axis=1), free.argmax(axis=1))
        self.numbers[drones, slots] = numbers
        return np.asarray(slots)

    def _promise(self, drones: IntArray, identity: Identity) -> None:
        """Store the guarantee of an unknown plan, unless it may follow another unknown one."""
        planned = identity.start_round - 1
        before = self.lacking[drones] & (self.numbers[drones] >> 8 <= planned)
        for drone in drones[self.located[drones] & ~before.any(axis=1)].tolist():
            _, known = self.candidates(np.arange(len(self.located)) == drone)
            parents = tuple(one for one in known if one.identity.start_round <= planned)
            promise = SeparationGuarantee(planned, parents)
            self._guarantees.setdefault((drone, identity.number), promise)

    def _forget(self, drones: IntArray) -> None:
        """Free the slots of impossible trajectories, except for the newest contents."""
        numbers = np.where(self._known[drones], self.numbers[drones], _FREE)
        oldest = np.partition(numbers, -_REMEMBERED, axis=1)[:, -_REMEMBERED, None]
        possible = self.possible[drones]
        self._known[drones] &= possible | (numbers >= oldest)
        used = possible | self._known[drones]
        self.numbers[drones] = np.where(used, self.numbers[drones], _FREE)
        if self._guarantees:
            self._guarantees = {
                (drone, number): promise
                for (drone, number), promise in self._guarantees.items()
                if (self.possible[drone] & (self.numbers[drone] == number)).any()
            }
