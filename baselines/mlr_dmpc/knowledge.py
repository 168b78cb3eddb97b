"""What a compute unit knows of the swarm, and how a round's messages change that."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from swarm_envs.baselines.mlr_dmpc.config import MlrDmpcConfig
from swarm_envs.baselines.mlr_dmpc.membership import Membership
from swarm_envs.baselines.mlr_dmpc.messages import (
    NONE,
    UNSURE,
    DroneState,
    Kind,
    Missing,
    UnitMessage,
)
from swarm_envs.baselines.mlr_dmpc.network import Inbox
from swarm_envs.baselines.mlr_dmpc.tracker import Tracker
from swarm_envs.baselines.mlr_dmpc.trajectory import Identity, Trajectory
from swarm_envs.baselines.mlr_dmpc.views import View, ViewId
from swarm_envs.state import FloatArray

_VOID_ROUNDS = 2


class Knowledge:
    """Trackers of all drones, the view, and what was said about the rounds to come.

    Args:
        unit: who knows.
        view: the view at deployment.
        num_units: M.
        targets: (N, 3) as far as known, m.
        config: parameters.
        since: round at which the unit starts or comes back.
    """

    def __init__(
        self,
        unit: int,
        view: View,
        num_units: int,
        targets: FloatArray,
        config: MlrDmpcConfig,
        since: int = 0,
    ) -> None:
        self.unit, self._config = unit, config
        self.membership = Membership(unit, view, num_units, len(targets), since)
        self.trackers = [Tracker() for _ in targets]
        self.targets = np.array(targets)
        self.gone: set[int] = set()
        self.joining: set[int] = set()
        self.donated: dict[tuple[int, int], int] = {}
        """Drone to which a unit (first) has given its slot in a round (second)."""
        self.wishes: dict[int, tuple[Missing, ...]] = {}
        """What each unit lacked in the last round, as far as heard."""
        self.reported: dict[int, UnitMessage] = {}
        """The last round's messages of units."""
        self._selections: dict[int, tuple[ViewId, tuple[int, ...]]] = {}
        self._complete: dict[int, list[tuple[int, frozenset[int]]]] = {}
        self._void: dict[int, int] = {}
        self._since = since

    @property
    def view(self) -> View:
        """The view in force at this unit."""
        return self.membership.view

    def selection(self, round_: int) -> tuple[int, ...] | None:
        """Drones that may be planned anew in a round (A_ET), by rank, if that is known."""
        view, chosen = self._selections.get(round_, (None, None))
        return chosen if view == self.view.id else None

    def select(self, round_: int, chosen: tuple[int, ...]) -> None:
        """Note which drones may be planned anew in a round."""
        self._selections[round_] = self.view.id, chosen

    def flying(self) -> Iterator[int]:
        """Drones of the view that have not left the air."""
        return (drone for drone in sorted(self.view.drones) if drone not in self.gone)

    def ready(self) -> bool:
        """Whether every drone was heard in the view, so that nobody can accept an older plan."""
        located = all(self.trackers[drone].located for drone in self.view.drones)
        return located and self.membership.member

    def missing(self) -> list[Missing]:
        """Trajectories that may be flown and are not known."""
        return [Missing(i, one) for i in self.flying() for one in self.trackers[i].missing]

    def void(self, drone: int, round_: int) -> bool:
        """Whether a drone has given up its reference lately: no distance is promised then."""
        return round_ - self._void.get(drone, -(10**6)) <= _VOID_ROUNDS * (
            self._config.horizon_rounds
        )

    def knew(self, unit: int, drone: int, since: int, until: int) -> bool:
        """Whether a unit is known to have had all that a drone may fly, in one of some rounds."""
        return any(
            since <= round_ <= until and drone not in lacking
            for round_, lacking in self._complete.get(unit, [])
        )

    def update(self, inbox: Inbox[UnitMessage], own: UnitMessage | None) -> None:
        """Take in the messages of the last round.

        Args:
            inbox: what was heard.
            own: what the unit itself sent.
        """
        last = inbox.round
        for message in inbox.slots.values():
            for ahead, drone in enumerate(message.donations, start=1):
                if drone != NONE:
                    self.donated[message.unit, last + ahead] = drone
            if message.kind is Kind.ANSWER:
                self.donated[message.unit, last] = message.drone
        given = {unit for unit, round_ in self.donated if round_ == last}
        present = frozenset({*inbox.slots, *given, self.unit})
        if self.membership.update(inbox, present):
            self._lose()
        for state in inbox.states:
            self._locate(state)
        for message in inbox.slots.values():
            if message.current is not None and message.view == self.view.id:
                self.select(last, message.current)
        for unit in self.view.units:
            said = own if unit == self.unit and own is not None else inbox.slots.get(unit)
            self._account(unit, said, last, given)
        self.reported = {
            unit: message
            for unit, message in inbox.slots.items()
            if message.kind is not Kind.ANSWER and message.view == self.view.id
        }
        for message in self.reported.values():
            self._hear(message, last)
        self._forget(last)

    def propose(self, round_: int) -> None:
        """Adopt a new view if the present one no longer fits."""
        if self.membership.propose(round_):
            self._lose()

    def _lose(self) -> None:
        for tracker in self.trackers:
            tracker.lose()

    def _locate(self, state: DroneState) -> None:
        drone, tracker = state.drone, self.trackers[state.drone]
        self.targets[drone] = state.target
        for mark, drones in ((state.gone, self.gone), (state.joining, self.joining)):
            if mark:
                drones.add(drone)
            else:
                drones.discard(drone)
        if state.reinitialised:
            self._void[drone] = state.round
        if state.lock != self.view.id:
            if state.lock > self.view.id:
                tracker.lose()
            return
        tracker.locate(state.identity, state.round, self._at_rest(state))

    def _at_rest(self, state: DroneState) -> Trajectory | None:
        """The trajectory of a drone that rests, which its message carries whole."""
        if not state.resting:
            return None
        still = np.zeros((3, 3))
        still[0] = state.kinematics[0]
        jerk = np.zeros((self._config.num_inputs, 3))
        return Trajectory(state.identity, still, jerk, self._config.input_sampling_s)

    def _account(self, unit: int, message: UnitMessage | None, last: int, given: set[int]) -> None:
        """Add what a member's slot may have told a drone in the last round."""
        if message is not None and message.trajectory is not None:
            tracker = self.trackers[message.drone]
            tracker.learn(message.trajectory)
            if message.kind is Kind.PLAN and message.view == self.view.id:
                tracker.add(message.trajectory.identity, message.trajectory)
        elif message is None and unit not in given and unit != self.unit:
            selection = self.selection(last)
            drones = list(self.view.drones)
            if selection is not None:
                rank = self.view.rank(unit, last)
                chosen = selection[rank] if rank < len(selection) else NONE
                drones = [] if chosen == NONE else [chosen]
            for drone in drones:
                self.trackers[drone].add(Identity(last + 1, unit), None)

    def _hear(self, message: UnitMessage, last: int) -> None:
        """Take in all but the trajectory of a unit's message."""
        if message.selection is not None:
            self.select(last + 1, message.selection)
        self.wishes[message.unit] = message.missing
        if message.complete:
            lacking = frozenset(missing.drone for missing in message.missing)
            self._complete.setdefault(message.unit, []).append((last, lacking))
        for ago, planned in enumerate(message.recent):
            identity = Identity(last - ago + 1, message.unit)
            if planned == UNSURE:
                continue
            for drone, tracker in enumerate(self.trackers):
                if drone != planned and identity in tracker.possible:
                    tracker.strike(identity)

    def _forget(self, last: int) -> None:
        """Drop what is too old to matter."""
        self.donated = {key: one for key, one in self.donated.items() if key[1] >= last}
        self._selections = {k: one for k, one in self._selections.items() if k >= last}
        self.wishes = {unit: w for unit, w in self.wishes.items() if unit in self.reported}
        oldest = last - 4 * self._config.horizon_rounds
        for unit, entries in self._complete.items():
            if entries and entries[0][0] < oldest:
                self._complete[unit] = [entry for entry in entries if entry[0] >= oldest]
