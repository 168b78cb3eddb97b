"""A compute unit's information on the swarm, its view, and the half-spaces of guarantees.

A plan that was sent but not received is avoided by its guarantee. Drone j's plan q of round r, by
unit v, satisfies n . Theta^-1 (q - p) >= d for the trajectory p that drone i flew, with n the
normal of the plane (15) between p and j's old trajectory c, if v had p. If i still flies p, a new
plan p' of i with n . Theta^-1 (p' - p) <= 0 satisfies n . Theta^-1 (q - p') >= d for any q. The
present trajectory has no slack to these half-spaces: half of `SPARE_M` covers the rounding of its
state.
"""

from __future__ import annotations

import math

import numpy as np

from swarm_envs.baselines.mlr_dmpc import messages
from swarm_envs.baselines.mlr_dmpc.avoidance_planes import (
    SPARE_M,
    HalfSpaces,
    Neighbors,
    voronoi_planes,
)
from swarm_envs.baselines.mlr_dmpc.information_tracker import InformationTrackers
from swarm_envs.baselines.mlr_dmpc.mlr_dmpc_config import MlrDmpcConfig
from swarm_envs.baselines.mlr_dmpc.radio import Inbox
from swarm_envs.baselines.mlr_dmpc.trajectory import (
    Identity,
    Trajectory,
    all_positions_from,
    sampled_positions,
)
from swarm_envs.state import BoolArray, FloatArray

LISTENING_ROUNDS = 2
"""Rounds for which a unit that comes back is silent, as it may have given its slots away before."""
_ANNOUNCED_ROUNDS = 20
_LONE_ROUNDS = 15


_SILENCE = 11.5
"""A unit is excluded when only one silence in exp(11.5) would be as long by loss alone."""
_LEAST_SILENT_ROUNDS = 6  # Rounds of silence below which no unit is excluded


class Membership:
    """The view of one compute unit, which starts or comes back in round `since`."""

    def __init__(
        self, unit: int, view: messages.MembershipView, num_units: int, num_drones: int, since: int
    ) -> None:
        self._adopt(view, since, num_drones)
        self._unit, self._since = unit, since
        self._highest = view.id
        # (M,) rounds of silence, and its evidence of failure: a round in which most messages were
        # lost adds little, so that no unit is excluded in a blackout.
        self._silent = np.zeros(num_units, dtype=np.int64)
        self._evidence = np.zeros(num_units)
        self.joining: BoolArray = np.zeros(num_drones, dtype=bool)
        """(N,) True for drones that have announced that they are not airborne yet."""
        self.gone: BoolArray = np.zeros(num_drones, dtype=bool)
        """(N,) True for drones that have announced that they have landed."""
        self._heard_of = self.drones.copy()
        self._behind_since: int | None = None
        self._others_behind = False
        self._retry = since + LISTENING_ROUNDS

    def update(self, inbox: Inbox[messages.UnitMessage], present: frozenset[int]) -> bool:
        """Process a round in which units were `present`; return True if the view has changed."""
        drones, states = len(self.view.drones), inbox.states
        lost = max(drones - int(states.present.sum()), 0)
        silent = ~np.isin(np.arange(len(self._silent)), list(present))
        self._silent = np.where(silent, self._silent + 1, 0)
        self._evidence -= math.log((lost + 0.5) / (drones + 1))
        self._evidence[~silent] = 0.0
        locks = states.lock[states.present]
        self._highest = max(self._highest, messages.ViewId.of(int(locks.max(initial=0))))
        self._heard_of |= states.present
        self.gone |= states.present & states.gone
        self.joining = np.where(states.present, states.joining, self.joining)
        before = self.view
        for message in inbox.slots.values():
            self._highest = max(self._highest, message.view)
            if message.members is not None:
                self._heard_of[list(message.members.drones)] = True
                self.gone[list(message.members.gone)] = True
                if message.members.id > self.view.id:
                    self._adopt(message.members, inbox.round + 1, len(self.gone))
        self._others_behind = any(m.view < self.view.id for m in inbox.slots.values()) or bool(
            (locks < self.view.id.number).any()
        )
        behind = self._highest > self.view.id
        if not behind:
            self._behind_since = None
        elif self._behind_since is None:
            self._behind_since = inbox.round
        return self.view is not before

    def propose(self, round_: int) -> bool:
        """Adopt a new view if the present one no longer fits; return True if it did."""
        if round_ < self._since + LISTENING_ROUNDS:
            return False
        if self._highest > self.view.id:  # No message has named its members
            waiting = self._behind_since
            if waiting is None or round_ - waiting < _LONE_ROUNDS:
                return False
            self._behind_since = None
            return self._proposed(round_)
        if self._unit not in self.view.units:
            return round_ >= self._retry and self._proposed(round_)
        gone = self._silent_units()
        new, left = self._heard_of & ~self.drones & ~self.gone, self.gone & self.drones
        if not (gone or (new | left).any()):
            return False
        first = min((u for u in self.view.units if u not in gone), default=self._unit)
        return first == self._unit and self._proposed(round_)

    @property
    def member(self) -> bool:
        """True if the unit belongs to the highest view of any message."""
        return self._unit in self.view.units and self._highest <= self.view.id

    def announced(self, round_: int) -> messages.MembershipView | None:
        """Return the view as long as a member may not have received it, else None."""
        new = self.view.id.epoch > 0 and round_ - self.adopted < _ANNOUNCED_ROUNDS
        return self.view if new or self._others_behind else None

    def _silent_units(self) -> set[int]:
        """Return units of the view whose silence is too long to be due to message loss."""
        silent = (self._silent >= _LEAST_SILENT_ROUNDS) & (self._evidence >= _SILENCE)
        return {unit for unit in self.view.units if silent[unit]}

    def _proposed(self, round_: int) -> bool:
        """Adopt a view with all members and an identity that was never used before (Lemma L6).

        Each proposal raises the epoch by at least one, and in round r none is above r + 1. So a
        unit that comes back uses none that it may have used before.
        """
        units = {*self.view.units} - self._silent_units() | {self._unit}
        units |= {*np.flatnonzero(self._silent < _LEAST_SILENT_ROUNDS).tolist()}
        id_ = messages.ViewId(max(self._highest.epoch, self._since) + 1, self._unit)
        self._retry = round_ + 2 * (self._retry - self._since)  # Exponential backoff
        drones, gone = self._heard_of & ~self.gone, self.gone
        members = (frozenset(np.flatnonzero(some).tolist()) for some in (drones, gone))
        view = messages.MembershipView(id_, tuple(sorted(units)), *members)
        self._adopt(view, round_, len(gone))
        self._highest = id_
        return True

    def _adopt(self, view: messages.MembershipView, round_: int, num_drones: int) -> None:
        self.view = view
        self.adopted = round_
        """The round in which the view was adopted."""
        self.drones: BoolArray = np.isin(np.arange(num_drones), list(view.drones))
        """(N,) True for drones of the view."""


_GIVEN_UP_ROUNDS = 2


class SwarmInformation:
    """The information of compute unit w: trackers of all drones, the view, announced selections.

    The unit starts, or comes back, in round `since` with the view at deployment and targets
    (N, 3), m.
    """

    def __init__(
        self,
        unit: int,
        view: messages.MembershipView,
        num_units: int,
        targets: FloatArray,
        config: MlrDmpcConfig,
        since: int = 0,
    ) -> None:
        self.unit, self._config = unit, config
        self.membership = Membership(unit, view, num_units, len(targets), since)
        self.trackers = InformationTrackers(len(targets))
        self.targets = np.array(targets)
        self.donated: dict[tuple[int, int], int] = {}
        """The drone to which a unit (first of the key) gave its slot in a round (second)."""
        self.requests: dict[int, tuple[messages.Missing, ...]] = {}
        """The trajectories that each unit requested in the last round."""
        self.reported: dict[int, messages.UnitMessage] = {}
        """The messages received from units in the last round."""
        self.planned: list[messages.Missing] = []
        """The plans of the last round, the unit's own first, which others may lack."""
        self._selections: dict[int, tuple[messages.ViewId, tuple[int, ...]]] = {}
        self._complete: dict[int, list[tuple[int, frozenset[int]]]] = {}
        self._gave_up = np.full(len(targets), -(10**6))
        self._since = since

    @property
    def view(self) -> messages.MembershipView:
        """The view in force at this unit."""
        return self.membership.view

    def selection(self, round_: int) -> tuple[int, ...] | None:
        """Return drones that may be replanned in a round (A_ET), by rank; None if unknown."""
        view, chosen = self._selections.get(round_, (None, None))
        return chosen if view == self.view.id else None

    def select(self, round_: int, chosen: tuple[int, ...]) -> None:
        """Store the drones that may be replanned in a round."""
        self._selections[round_] = self.view.id, chosen

    @property
    def flying(self) -> BoolArray:
        """(N,) True for drones of the view that have not landed."""
        return self.membership.drones & ~self.membership.gone

    def ready(self) -> bool:
        """Return True if every drone has locked to the view and can accept no older plan."""
        located = self.trackers.located | ~self.membership.drones
        return bool(located.all()) and self.membership.member

    def missing(self) -> list[messages.Missing]:
        """Return trajectories of unknown contents that may be flown."""
        return [messages.Missing(*one) for one in self.trackers.missing(self.flying)]

    def has_given_up(self, round_: int) -> BoolArray:
        """Return (N,) True for drones that gave up their references lately: no distance holds."""
        since = round_ - self._gave_up
        return np.asarray(since <= _GIVEN_UP_ROUNDS * self._config.horizon_rounds)

    def had_trajectory(self, unit: int, drone: int, since: int, until: int) -> bool:
        """Return True if a unit certainly had all candidates of a drone in one of the rounds."""
        return any(
            since <= round_ <= until and drone not in lacking
            for round_, lacking in self._complete.get(unit, [])
        )

    def update(self, inbox: Inbox[messages.UnitMessage], own: messages.UnitMessage | None) -> None:
        """Process the messages of the last round and the unit's own message."""
        last = inbox.round
        for message in inbox.slots.values():
            for ahead, drone in enumerate(message.donations, start=1):
                if drone != messages.NONE:
                    self.donated[message.unit, last + ahead] = drone
            if message.kind is messages.MessageKind.ANSWER:
                self.donated[message.unit, last] = message.drone
        given = {unit for unit, round_ in self.donated if round_ == last}
        present = frozenset({*inbox.slots, *given, self.unit})
        if self.membership.update(inbox, present):
            self.trackers.lose()
        self._locate(inbox.states)
        for message in inbox.slots.values():
            if message.current is not None and message.view == self.view.id:
                self.select(last, message.current)
        for unit in self.view.units:
            its_own = own if unit == self.unit and own is not None else inbox.slots.get(unit)
            self._account(unit, its_own, last, given)
        sent = [*([own] if own is not None else []), *inbox.slots.values()]
        self.planned = [
            messages.Missing(message.drone, message.trajectory.identity)
            for message in sent
            if message.kind is messages.MessageKind.PLAN and message.trajectory is not None
        ]
        self.reported = {
            unit: message
            for unit, message in inbox.slots.items()
            if message.kind is not messages.MessageKind.ANSWER and message.view == self.view.id
        }
        for message in self.reported.values():
            if message.selection is not None:
                self.select(last + 1, message.selection)
            self.requests[message.unit] = message.missing
            if message.complete:
                lacking = frozenset(missing.drone for missing in message.missing)
                self._complete.setdefault(message.unit, []).append((last, lacking))
        self.trackers.strike(
            {
                Identity(last - ago + 1, message.unit).number: planned
                for message in self.reported.values()
                for ago, planned in enumerate(message.recent)
                if planned != messages.UNSURE
            }
        )
        self._forget(last)

    def propose(self, round_: int) -> None:
        """Adopt a new view if the present one no longer fits."""
        if self.membership.propose(round_):
            self.trackers.lose()

    def _locate(self, states: messages.DroneStates) -> None:
        present, lock = states.present, self.view.id.number
        self.targets[present] = states.target[present]
        self._gave_up[present & states.reinitialised] = states.round
        self.trackers.lose(present & (states.lock > lock))
        (drones,) = np.nonzero(present & (states.lock == lock))
        self.trackers.locate(
            drones,
            states.identity[drones],
            states.round,
            lambda drone: states.at_rest(drone, self._config),
        )

    def _account(
        self, unit: int, message: messages.UnitMessage | None, last: int, given: set[int]
    ) -> None:
        """Add the plans that may have been sent in a member's slot in the last round."""
        if message is not None and message.trajectory is not None:
            self.trackers.learn(message.drone, message.trajectory)
            if message.kind is messages.MessageKind.PLAN and message.view == self.view.id:
                self.trackers.add(np.array([message.drone]), message.trajectory.identity, False)
        elif message is None and unit not in given and unit != self.unit:
            selection = self.selection(last)
            (drones,) = np.nonzero(self.membership.drones)
            if selection is not None:
                rank = self.view.rank(unit, last)
                chosen = selection[rank] if rank < len(selection) else messages.NONE
                drones = np.array([chosen][: chosen != messages.NONE], dtype=np.int64)
            promises = self._config.planes == "fixed"
            self.trackers.add(drones, Identity(last + 1, unit), promises)

    def _forget(self, last: int) -> None:
        self.donated = {key: one for key, one in self.donated.items() if key[1] >= last}
        self._selections = {k: one for k, one in self._selections.items() if k >= last}
        self.requests = {unit: w for unit, w in self.requests.items() if unit in self.reported}
        oldest = last - 4 * self._config.horizon_rounds
        for unit, entries in self._complete.items():
            if entries and entries[0][0] < oldest:
                self._complete[unit] = [entry for entry in entries if entry[0] >= oldest]


def guaranteed_planes(
    info: SwarmInformation,
    drone: int,
    own: Trajectory,
    other: int,
    round_: int,
    config: MlrDmpcConfig,
) -> HalfSpaces | None:
    """Return half-spaces that keep drone i clear of drone j's unknown plans in round k, or None.

    A drone that is not airborne has none, as plans for j have not avoided its hover.
    """
    if info.has_given_up(round_)[[drone, other]].any() or info.membership.joining[drone]:
        return None
    parents: list[Trajectory] = []
    for _, identity in info.trackers.missing(np.arange(len(info.targets)) == other):
        guarantee = info.trackers.guarantee(other, identity)
        start = own.identity.start_round
        if guarantee is None or start > guarantee.round:
            return None
        author = identity.compute_unit
        knows = own.identity.compute_unit == author
        if not (knows or info.had_trajectory(author, drone, start, guarantee.round)):
            return None
        parents += guarantee.parents
    positions = sampled_positions(own, round_ + 1, config)
    others = np.ascontiguousarray(all_positions_from(parents, round_ + 1, config)[:, 1:])
    nobody = np.zeros(len(others), dtype=np.int64)
    beside = Neighbors(others, nobody, np.zeros(len(others), dtype=bool))
    normals = voronoi_planes(positions, beside, config).normals
    flown = np.einsum("psi,si->ps", normals, positions)
    return HalfSpaces(normals, flown - SPARE_M / 2)


def assign_to_units(info: SwarmInformation, chosen: list[int], round_: int) -> tuple[int, ...]:
    """Return the selected drones by rank, avoiding units that lack the drone's trajectory."""
    size = len(info.view.units)
    lacks = {unit: {m.drone for m in requests} for unit, requests in info.requests.items()}
    lacks[info.unit] = {i for i in chosen if info.trackers.sole(i) is None}
    slots = [messages.NONE] * size
    taker = {info.view.rank(unit, round_): unit for unit in info.view.units}
    for drone in chosen:
        free = [rank for rank in range(size) if slots[rank] == messages.NONE]
        fits = [r for r in free if drone not in lacks.get(taker[r], ())]
        slots[(fits or free)[0]] = drone
    return tuple(slots)


def with_relay(info: SwarmInformation, message: messages.UnitMessage) -> messages.UnitMessage:
    """Return the message with a trajectory that another unit has requested or may lack."""
    order = sorted(info.requests, key=lambda unit: (unit - info.unit) % 256)
    asked = [request for unit in order for request in info.requests[unit]]
    for request in [*asked, *info.planned]:
        contents = info.trackers.contents(*request)
        if contents is not None:
            return message._replace(
                kind=messages.MessageKind.RELAY, drone=request.drone, trajectory=contents
            )
    return message
