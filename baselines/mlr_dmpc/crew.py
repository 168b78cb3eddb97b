"""Drones and compute units that speak one protocol: ours, or the paper's."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Protocol

from swarm_envs.baselines.mlr_dmpc.codec import Codec
from swarm_envs.baselines.mlr_dmpc.drone import Drone
from swarm_envs.baselines.mlr_dmpc.knowledge import Knowledge
from swarm_envs.baselines.mlr_dmpc.messages import DroneState, UnitMessage
from swarm_envs.baselines.mlr_dmpc.network import Inbox, Network, RoundLog
from swarm_envs.baselines.mlr_dmpc.paper import (
    PaperDrone,
    PaperMessage,
    PaperUnit,
    TrustingUnit,
)
from swarm_envs.baselines.mlr_dmpc.planning import Planner, PlanningOptions
from swarm_envs.baselines.mlr_dmpc.trajectory import Trajectory
from swarm_envs.baselines.mlr_dmpc.unit import ComputeUnit, UnitRound
from swarm_envs.baselines.mlr_dmpc.views import View, ViewId
from swarm_envs.state import FloatArray

Spoken = tuple[dict[int, DroneState], dict[int, Any], dict[int, int]]
"""States by drone, messages by slot, and the node that sends in each slot."""


class Crew(Protocol):
    """What a swarm asks of its drones and units."""

    drones: list[Drone]
    """The swarm's drones, by number."""
    num_units: int
    """M, the number of compute units."""
    reports: dict[int, UnitRound]
    """What each unit did in the last round, by its number."""

    def speak(self, k: int, targets: FloatArray, alive: set[int], present: set[int]) -> Spoken:
        """Everybody's messages of a round."""

    def listen(
        self, log: RoundLog[Any], network: Network[Any], alive: set[int], present: set[int]
    ) -> dict[int, Trajectory]:
        """Take in what came through; plans accepted, by drone."""

    def may_fly(self, log: RoundLog[Any]) -> list[list[Trajectory]]:
        """What each drone may fly next, whichever of a round's messages come through."""

    def bytes_sent(self, log: RoundLog[Any]) -> int:
        """In all slots of a round."""


class OurCrew:
    """With the recovery that keeps planning.

    Args:
        hovers: what the drones fly at first.
        targets: (N, 3) m.
        options: of the planners.
        informed: whether the units know both.
        joins: drones that are not in the air yet.
        recovery: unused, True.
    """

    def __init__(
        self,
        hovers: list[Trajectory],
        targets: FloatArray,
        options: PlanningOptions,
        informed: bool,
        joins: Mapping[int, int],
        recovery: bool | str,
    ) -> None:
        self.num_units, self._options = options.num_units, options
        self.codec = Codec(len(hovers), options.num_units, options.config)
        drones = frozenset(range(len(hovers))) - joins.keys()
        self._view = View(ViewId(0, 0), tuple(range(options.num_units)), drones)
        self.drones = [
            Drone(i, one, self._view.id, options.config, self.codec, i not in joins)
            for i, one in enumerate(hovers)
        ]
        self.units: list[ComputeUnit | None] = [
            self._unit(unit, targets, 0) for unit in range(options.num_units)
        ]
        if informed:
            for one in self.units:
                assert one is not None
                _inform(one.knowledge, hovers)
        self.reports: dict[int, UnitRound] = {}
        self._inboxes: dict[int, Inbox[UnitMessage]] = {}

    def speak(self, k: int, targets: FloatArray, alive: set[int], present: set[int]) -> Spoken:
        """Everybody's messages of a round."""
        slots: dict[int, UnitMessage] = {}
        senders: dict[int, int] = {}
        for unit in range(self.num_units):
            message = self._step(unit, k, targets, unit in alive)
            if message is not None:
                slots[unit], senders[unit] = message, len(self.drones) + unit
        carried = self.codec.carried_targets(targets)
        states = {}
        for drone in self.drones:
            if drone.index in present:
                states[drone.index] = drone.state(k, carried[drone.index])
                for unit, answer in drone.answers(k).items():
                    slots[unit], senders[unit] = answer, drone.index
        return states, slots, senders

    def _step(self, unit: int, k: int, targets: FloatArray, alive: bool) -> UnitMessage | None:
        if not alive:
            self.units[unit] = None
            return None
        one = self.units[unit]
        if one is None:  # comes back, and knows of targets what drones will say
            one = self.units[unit] = self._unit(unit, targets, k)
            self._inboxes.pop(unit, None)
        message = one.step(self._inboxes.get(unit), k)
        self.reports[unit] = one.report
        return message

    def _unit(self, unit: int, targets: FloatArray, since: int) -> ComputeUnit:
        know = Knowledge(unit, self._view, self.num_units, targets, self._options.config, since)
        return ComputeUnit(know, Planner(self._options), self.codec, since)

    def listen(
        self,
        log: RoundLog[UnitMessage],
        network: Network[UnitMessage],
        alive: set[int],
        present: set[int],
    ) -> dict[int, Trajectory]:
        """Take in what came through; plans accepted, by drone."""
        self._inboxes = {unit: network.to_unit(log, unit) for unit in alive}
        heard = {i: self.drones[i].receive(network.to_drone(log, i)) for i in present}
        return {i: plan for i, plan in heard.items() if plan is not None}

    def may_fly(self, log: RoundLog[UnitMessage]) -> list[list[Trajectory]]:
        """What each drone may fly next, whichever of a round's messages come through."""
        out = []
        for drone in self.drones:
            plans = [
                m.trajectory
                for m in log.slots.values()
                if drone.index in log.states and m.trajectory and drone.accepts(m)
            ]
            out.append(([drone.flying] if drone.airborne else []) + plans)
        return out

    def bytes_sent(self, log: RoundLog[UnitMessage]) -> int:
        """In all slots of a round."""
        states = sum(self.codec.state_size(state) for state in log.states.values())
        return states + sum(self.codec.size(message) for message in log.slots.values())


def _inform(know: Knowledge, hovers: list[Trajectory]) -> None:
    for drone in know.view.drones:
        know.trackers[drone].learn(hovers[drone])
        know.trackers[drone].locate(hovers[drone].identity, -1, None)


class PaperCrew:
    """The paper's protocol, or the one that ignores loss (arguments as for `OurCrew`).

    Raises:
        ValueError: drones are to join: the paper has no way to.
    """

    def __init__(
        self,
        hovers: list[Trajectory],
        targets: FloatArray,
        options: PlanningOptions,
        informed: bool,
        joins: Mapping[int, int],
        recovery: bool | str,
    ) -> None:
        if joins:
            raise ValueError(f"drones {sorted(joins)} join, which only recovery=True can handle")
        self.num_units, self._options = options.num_units, options
        codec = Codec(len(hovers), options.num_units, options.config)
        self._state_size = codec.state_size
        self._carried = codec.carried_targets
        self._papers = [
            PaperDrone(i, one, ViewId(0, 0), options.config, codec) for i, one in enumerate(hovers)
        ]
        self.drones: list[Drone] = list(self._papers)
        self._kind = PaperUnit if recovery else TrustingUnit
        self._hovers = hovers if informed or not recovery else []
        self.units: list[PaperUnit | None] = [
            self._unit(unit, targets, self._hovers) for unit in range(options.num_units)
        ]
        self.reports: dict[int, UnitRound] = {}
        self._inboxes: dict[int, Inbox[PaperMessage]] = {}

    def _unit(self, unit: int, targets: FloatArray, known: list[Trajectory]) -> PaperUnit:
        candidates = [{one.identity: one} for one in known] or [{} for _ in targets]
        planner = Planner(self._options)
        return self._kind(unit, candidates, targets.copy(), planner, self.num_units)

    def speak(self, k: int, targets: FloatArray, alive: set[int], present: set[int]) -> Spoken:
        """Everybody's messages of a round."""
        slots: dict[int, PaperMessage] = {}
        senders: dict[int, int] = {}
        for unit in range(self.num_units):
            one = self.units[unit] if unit in alive else None
            if unit in alive and one is None:
                back = [d.flying for d in self.drones] if self._kind is TrustingUnit else []
                one = self._unit(unit, targets, back)
            self.units[unit] = one
            if one is None:
                continue
            message = one.step(self._inboxes.get(unit), k)
            self.reports[unit] = one.report
            if message is not None:
                slots[unit], senders[unit] = message, len(self.drones) + unit
        carried = self._carried(targets)
        states = {drone.index: drone.state(k, carried[drone.index]) for drone in self.drones}
        for drone in self._papers:
            for unit, answer in drone.replies(k).items():
                if unit not in slots:
                    slots[unit], senders[unit] = answer, drone.index
        return states, slots, senders

    def listen(
        self,
        log: RoundLog[PaperMessage],
        network: Network[PaperMessage],
        alive: set[int],
        present: set[int],
    ) -> dict[int, Trajectory]:
        """Take in what came through; plans accepted, by drone."""
        self._inboxes = {unit: network.to_unit(log, unit) for unit in alive}
        heard = {d.index: d.hear(network.to_drone(log, d.index)) for d in self._papers}
        return {i: plan for i, plan in heard.items() if plan is not None}

    def may_fly(self, log: RoundLog[PaperMessage]) -> list[list[Trajectory]]:
        """What each drone may fly next, whichever of a round's messages come through."""
        return [
            [
                drone.flying,
                *(m.trajectory for m in log.slots.values() if m.trajectory and drone.takes(m)),
            ]
            for drone in self._papers
        ]

    def bytes_sent(self, log: RoundLog[PaperMessage]) -> int:
        """In all slots of a round."""
        states = sum(self._state_size(state) for state in log.states.values())
        return states + sum(len(message.pack()) for message in log.slots.values())
