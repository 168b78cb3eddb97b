"""Which view a compute unit is in, and when it proposes another."""

from __future__ import annotations

import math

from swarm_envs.baselines.mlr_dmpc.messages import DroneState, MembershipView, UnitMessage, ViewId
from swarm_envs.baselines.mlr_dmpc.radio import Inbox

LISTENING_ROUNDS = 2
"""A unit that comes back is silent for so long: a slot given away before stays given away."""
_ANNOUNCED_ROUNDS = 20
_LONE_ROUNDS = 15


_SILENCE = 11.5
"""A unit is left out when only one silence in exp(11) would be as long by loss alone."""
_LEAST_SILENT_ROUNDS = 6
"""Rounds of silence below which no unit is left out of a view."""


class _Absences:
    """For how long each unit has been silent, weighed by how much else was lost meanwhile.

    A round in which most messages were lost says little about a missing one; in a blackout nobody
    is left out.
    """

    def __init__(self, num_units: int) -> None:
        self.count = num_units
        self._rounds = [0] * num_units
        self._evidence = [0.0] * num_units

    def observe(self, heard: frozenset[int], log_odds: float) -> None:
        """Note who was heard, and minus the logarithm of the share lost in that round."""
        for unit in range(len(self._rounds)):
            silent = unit not in heard
            self._rounds[unit] = self._rounds[unit] + 1 if silent else 0
            self._evidence[unit] = self._evidence[unit] + log_odds if silent else 0.0

    def gone(self, unit: int) -> bool:
        """Whether a unit has been silent for too long for loss alone."""
        enough = self._rounds[unit] >= _LEAST_SILENT_ROUNDS
        return enough and self._evidence[unit] >= _SILENCE

    def present(self, unit: int) -> bool:
        """Whether a unit was heard lately."""
        return self._rounds[unit] < _LEAST_SILENT_ROUNDS


class Membership:
    """The view of one compute unit, which starts or comes back in round `since`."""

    def __init__(
        self, unit: int, view: MembershipView, num_units: int, num_drones: int, since: int
    ) -> None:
        self.view = view
        self.adopted = since
        """Round at which the view was adopted."""
        self._unit, self._num_drones, self._since = unit, num_drones, since
        self._highest = view.id
        self._absences = _Absences(num_units)
        self.joining: set[int] = set()
        """Drones that have said that they are not in the air yet."""
        self.gone: set[int] = set()
        """Drones that have said that they have left the air."""
        self._behind_since: int | None = None
        self._others_behind = False
        self._retry = since + LISTENING_ROUNDS

    def update(self, inbox: Inbox[UnitMessage], present: frozenset[int]) -> bool:
        """Take in a round; whether another view is now in force.

        `present`: units that were heard, or whose slots are known to be given away.
        """
        drones = len(self.view.drones)
        lost = max(drones - len(inbox.states), 0)
        self._absences.observe(present, -math.log((lost + 0.5) / (drones + 1)))
        for state in inbox.states:
            self._note(state)
        before = self.view
        for message in inbox.slots.values():
            self._highest = max(self._highest, message.view)
            if message.members is not None and message.members.id > self.view.id:
                self._adopt(message.members, inbox.round + 1)
        self._others_behind = any(m.view < self.view.id for m in inbox.slots.values()) or any(
            state.lock < self.view.id for state in inbox.states
        )
        behind = self._highest > self.view.id
        if not behind:
            self._behind_since = None
        elif self._behind_since is None:
            self._behind_since = inbox.round
        return self.view is not before

    def propose(self, round_: int) -> bool:
        """Adopt a view of one's own if the present one no longer fits; whether it did."""
        if round_ < self._since + LISTENING_ROUNDS:
            return False
        if self._highest > self.view.id:
            return self._propose_blindly(round_)
        if self._unit not in self.view.units:
            return round_ >= self._retry and self._proposed(round_)
        gone = {unit for unit in self.view.units if self._absences.gone(unit)}
        joining, left = self.joining - self.view.drones, self.gone & self.view.drones
        if not (gone or joining or left):
            return False
        first = min((u for u in self.view.units if u not in gone), default=self._unit)
        return first == self._unit and self._proposed(round_)

    @property
    def member(self) -> bool:
        """Whether the unit belongs to the highest view that it knows of."""
        return self._unit in self.view.units and self._highest <= self.view.id

    def announced(self, round_: int) -> MembershipView | None:
        """The view, as long as somebody may not have heard of it."""
        new = self.view.id.epoch > 0 and round_ - self.adopted < _ANNOUNCED_ROUNDS
        return self.view if new or self._others_behind else None

    def _note(self, state: DroneState) -> None:
        self._highest = max(self._highest, state.lock)
        for mark, drones in ((state.joining, self.joining), (state.gone, self.gone)):
            if mark:
                drones.add(state.drone)
            else:
                drones.discard(state.drone)

    def _propose_blindly(self, round_: int) -> bool:
        """Nobody says who belongs to a higher view: after a while, claim every drone there is."""
        waiting = self._behind_since
        if waiting is None or round_ - waiting < _LONE_ROUNDS:
            return False
        self._behind_since = None
        return self._proposed(round_, frozenset(range(self._num_drones)))

    def _proposed(self, round_: int, drones: frozenset[int] | None = None) -> bool:
        units = {unit for unit in self.view.units if not self._absences.gone(unit)} | {self._unit}
        units |= {unit for unit in range(self._absences.count) if self._absences.present(unit)}
        if drones is None:
            drones = (self.view.drones | self.joining) - self.gone
        id_ = ViewId(self._highest.epoch + 1, self._unit)
        self._retry = round_ + 2 * (self._retry - self._since)
        self._adopt(MembershipView(id_, tuple(sorted(units)), drones), round_)
        self._highest = id_
        return True

    def _adopt(self, view: MembershipView, round_: int) -> None:
        self.view, self.adopted = view, round_
