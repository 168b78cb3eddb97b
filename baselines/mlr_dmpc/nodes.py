"""The nodes of the network: drones, which fly the plans they accept, and compute units."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Collection, Mapping, Sequence
from typing import Any

import numpy as np

from swarm_envs.baselines.mlr_dmpc.compute_unit import ComputeUnit, UnitRound
from swarm_envs.baselines.mlr_dmpc.messages import (
    Codec,
    DroneStates,
    MembershipView,
    MessageKind,
    UnitMessage,
    ViewId,
)
from swarm_envs.baselines.mlr_dmpc.mlr_dmpc_config import MlrDmpcConfig
from swarm_envs.baselines.mlr_dmpc.radio import Inbox, RoundLog
from swarm_envs.baselines.mlr_dmpc.swarm_information import SwarmInformation
from swarm_envs.baselines.mlr_dmpc.trajectory import (
    NOBODY,
    Identity,
    Trajectory,
    is_at_rest,
    state_at,
)
from swarm_envs.baselines.mlr_dmpc.unit_planner import Planner, PlanningOptions
from swarm_envs.state import FloatArray

_CONTINUOUS = 1e-5  # The largest difference of a plan's first state from the reference, SI
_REPORTED_ROUNDS = 30
_LOST_M, _LOST_SPEED = 0.5, 10.0


class Drone:
    """A drone, which hovers at first; if not `airborne`, it joins with its first plan."""

    def __init__(
        self,
        index: int,
        start: Trajectory,
        view: MembershipView,
        config: MlrDmpcConfig,
        airborne: bool = True,
    ) -> None:
        self.index, self.flying = index, start
        self.view = view
        """The view to which it is locked: it accepts no plan of another."""
        self.airborne = airborne
        """True if it is airborne."""
        self.gone = False
        """True if it is no longer airborne."""
        self._config = config
        self._granted: dict[tuple[int, int], tuple[int, ...]] = {}
        self.gave_up = -(10**6)
        """The round in which it last gave up its reference."""

    def leave(self) -> None:
        """Land. The others avoid the drone until they receive the news."""
        self.gone, self.airborne = True, False

    def answers(self, round_: int) -> dict[int, Any]:
        """Return its trajectory as messages by slot, for the slots that it was given."""
        kind, drone, plan = MessageKind.ANSWER, self.index, self.flying
        return {
            unit: UnitMessage(kind, round_, unit, self.view.id, drone, plan, donations=rest)
            for (unit, granted), rest in self._granted.items()
            if granted == round_
        }

    def minds(self, message: Any) -> bool:
        """Return True if a message concerns this drone."""
        named = message.drone == self.index or self.index in getattr(message, "donations", ())
        return named or getattr(message, "members", None) is not None

    def accepts(self, message: Any) -> bool:
        """Return True if it would fly a plan that was the only message received in a round."""
        if message.kind is not MessageKind.PLAN or message.drone != self.index or self.gone:
            return False
        plan = message.trajectory
        assert plan is not None
        if message.view != self._follows(message).id:
            return False
        if plan.identity.start_round != message.round + 1:
            return False
        here = state_at(self.flying, message.round + 1, self._config)
        return bool(np.abs(plan.state - here).max() <= _CONTINUOUS)

    def _follows(self, message: Any) -> MembershipView:
        """Return the view to which it is locked after a message (Lemma L5).

        A higher view is followed only if it covers the present one: units that do not know all its
        drones could still plan for the others.
        """
        new: MembershipView | None = message.members
        if new is None or new.id <= self.view.id or not new.covers(self.view):
            return self.view
        return new

    def receive(self, inbox: Inbox[Any]) -> Trajectory | None:
        """Process a round's messages; return the accepted plan, flown from the next round on."""
        accepted = None
        self._granted = {key: one for key, one in self._granted.items() if key[1] > inbox.round}
        sent = [m for m in inbox.slots.values() if m.kind is not MessageKind.ANSWER]
        for message in sorted(sent, key=lambda one: one.view):
            self.view = self._follows(message)
        for message in sent:
            for ahead, drone in enumerate(message.donations, start=1):
                if drone == self.index:
                    rest = message.donations[ahead:]
                    self._granted[message.unit, inbox.round + ahead] = rest
            if self.accepts(message):
                accepted = message.trajectory
        if self.gone:
            return None
        if accepted is not None:
            self.flying, self.airborne = accepted, True
            self.gave_up = -(10**6)
        return accepted

    def give_up(self, measured: FloatArray, round_: int) -> bool:
        """Hover in place if position and velocity (2, 3) are far off the reference; True if so."""
        off = np.linalg.norm(measured - state_at(self.flying, round_, self._config)[:2], axis=1)
        if off[0] <= _LOST_M and off[1] <= _LOST_SPEED:
            return False
        state = np.zeros((3, 3))
        state[0] = measured[0]
        jerk = np.zeros_like(self.flying.jerk)
        identity = Identity(round_, NOBODY)
        self.flying = Trajectory(identity, state, jerk, self._config.input_sampling_s)
        self.gave_up = round_
        return True


class SwarmNodes(ABC):
    """The drones and compute units of a swarm, which exchange messages in each round."""

    def __init__(
        self, drones: Sequence[Drone], targets: FloatArray, options: PlanningOptions, codec: Codec
    ) -> None:
        self.drones, self.options, self.codec = drones, options, codec
        self.units: list[Any] = [
            self.make_unit(unit, targets, 0) for unit in range(options.num_units)
        ]
        """The compute units by index; None if a unit is dead."""
        self.reports: dict[int, UnitRound] = {}
        """The report of each unit's last round, by index."""
        self._inboxes: dict[int, Inbox[Any]] = {}

    @abstractmethod
    def make_unit(self, unit: int, targets: FloatArray, since: int) -> Any:
        """Return a compute unit that starts, or comes back, in a round."""

    def message_bytes(self, message: Any) -> int:
        """Return the size of a message in a compute unit's slot, bytes."""
        return len(self.codec.pack(message))

    def send(
        self, k: int, targets: FloatArray, alive: Collection[int], present: Collection[int]
    ) -> tuple[DroneStates, dict[int, Any], dict[int, int]]:
        """Return the messages of round k: drones' states, units' messages by slot, senders."""
        slots, senders = {}, {}
        for unit in range(self.options.num_units):
            if unit not in alive:
                self.units[unit] = None
                continue
            if self.units[unit] is None:
                self.units[unit] = self.make_unit(unit, targets, k)
            message = self.units[unit].step(self._inboxes.get(unit), k)
            self.reports[unit] = self.units[unit].report
            if message is not None:
                slots[unit], senders[unit] = message, len(self.drones) + unit
        for drone in self.drones:
            for unit, answer in drone.answers(k).items() if drone.index in present else ():
                if unit not in slots:
                    slots[unit], senders[unit] = answer, drone.index
        return self._states(k, targets, present), slots, senders

    def _states(self, k: int, targets: FloatArray, present: Collection[int]) -> DroneStates:
        """Return the drones' messages of round k, with targets (N, 3) as messages carry them."""
        drones, config = self.drones, self.options.config
        exact = np.array([state_at(drone.flying, k, config) for drone in drones])
        kinematics = self.codec.carried(exact)
        resting = np.array([is_at_rest(drone.flying, k, config) for drone in drones])
        kinematics[resting] = 0.0
        kinematics[resting, 0] = exact[resting, 0].astype(np.float32)
        gone = np.array([drone.gone for drone in drones])
        return DroneStates(
            k,
            np.isin(np.arange(len(drones)), list(present)),
            np.array([drone.flying.identity.number for drone in drones]),
            np.array([drone.view.id.number for drone in drones]),
            self.codec.carried(targets[:, None])[:, 0],
            kinematics,
            resting,
            joining=np.array([not drone.airborne for drone in drones]) & ~gone,
            gone=gone,
            reinitialised=np.array([k - drone.gave_up < _REPORTED_ROUNDS for drone in drones]),
        )

    def receive(
        self, log: RoundLog[Any], alive: Collection[int], present: Collection[int]
    ) -> dict[int, Trajectory]:
        """Process the messages that arrived in a round; return the plans accepted, by drone."""
        first_unit = len(self.drones)
        self._inboxes = {unit: log.inbox(first_unit + unit) for unit in alive}
        accepted = {}
        for drone in self.drones:
            if drone.index in present:
                sent = {u: m for u, m in log.slots.items() if drone.minds(m)}
                heard = {u: m for u, m in sent.items() if log.arrived[log.senders[u], drone.index]}
                plan = drone.receive(Inbox(log.round, log.states, heard))
                accepted.update({drone.index: plan} if plan is not None else {})
        return accepted

    def may_fly(self, log: RoundLog[Any]) -> list[list[Trajectory]]:
        """Return the trajectories that each drone may fly next, whichever messages arrive."""
        return [
            ([drone.flying] if drone.airborne else [])
            + [
                message.trajectory
                for message in log.slots.values()
                if log.states.present[drone.index] and message.trajectory and drone.accepts(message)
            ]
            for drone in self.drones
        ]

    def bytes_sent(self, log: RoundLog[Any]) -> int:
        """Return the size of all messages of a round, bytes."""
        states = sum(map(len, self.codec.pack_states(log.states)))
        return states + sum(self.message_bytes(message) for message in log.slots.values())


class RecoveryNodes(SwarmNodes):
    """Nodes with this package's recovery; `informed`: True if units know the hovers."""

    def __init__(
        self,
        hovers: list[Trajectory],
        targets: FloatArray,
        options: PlanningOptions,
        informed: bool,
        joins: Mapping[int, int],
    ) -> None:
        codec = Codec(len(hovers), options.num_units, options.config)
        codec.check_sizes(hovers[0])
        members = frozenset(range(len(hovers))) - joins.keys()
        self._view = MembershipView(ViewId(0, 0), tuple(range(options.num_units)), members)
        drones = [
            Drone(i, one, self._view, options.config, i not in joins)
            for i, one in enumerate(hovers)
        ]
        super().__init__(drones, targets, options, codec)
        for unit in self.units if informed else ():
            indices, numbers = np.array(sorted(members)), np.full(len(members), NOBODY)
            unit.information.trackers.locate(indices, numbers, -1, hovers.__getitem__)

    def make_unit(self, unit: int, targets: FloatArray, since: int) -> ComputeUnit:
        """Return a unit that knows the first view and the targets."""
        options = self.options
        information = SwarmInformation(
            unit, self._view, options.num_units, targets, options.config, since
        )
        return ComputeUnit(information, Planner(options), self.codec, since)
