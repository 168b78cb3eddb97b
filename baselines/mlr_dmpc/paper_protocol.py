"""The paper's protocol, Algorithms 1 and 2 line by line, and the protocol that ignores loss."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import IntEnum
from typing import NamedTuple

import numpy as np

from swarm_envs.baselines.mlr_dmpc.avoidance_planes import Neighbors
from swarm_envs.baselines.mlr_dmpc.compute_unit import UnitRound
from swarm_envs.baselines.mlr_dmpc.messages import (
    NONE,
    Codec,
    MembershipView,
    ViewId,
    pack_trajectory,
)
from swarm_envs.baselines.mlr_dmpc.nodes import Drone, SwarmNodes
from swarm_envs.baselines.mlr_dmpc.radio import Inbox
from swarm_envs.baselines.mlr_dmpc.trajectory import Identity, Trajectory, all_positions_from
from swarm_envs.baselines.mlr_dmpc.unit_planner import (
    JUST_PLANNED,
    Levels,
    Planner,
    PlanningOptions,
    prio_consensus,
    rank_by_priority,
)
from swarm_envs.state import FloatArray

_UNKNOWN = 1


class PaperKind(IntEnum):
    """The kind of a message in a compute unit's slot."""

    EMPTY = 0  # Priorities only
    TRAJECTORY = 1  # A new trajectory
    REQUEST = 2  # A request for a drone's trajectory
    ANSWER = 3  # A drone's trajectory, in the slot of the unit that requested it


class PaperMessage(NamedTuple):
    """The message in a compute unit's slot."""

    kind: PaperKind
    round: int  # The round in which it is sent
    unit: int  # The unit whose slot it is
    drone: int = NONE  # The drone of the trajectory or request
    trajectory: Trajectory | None = None
    priorities: tuple[int, ...] = ()  # (N,) of all drones

    def pack(self) -> bytes:
        """Return the message as bytes."""
        out = bytes([self.kind, self.drone & 0xFF])
        if self.trajectory is not None:
            out += pack_trajectory(self.trajectory, self.kind is PaperKind.ANSWER)
        return out + bytes(self.priorities)


class PaperDrone(Drone):
    """A drone that accepts any newer plan and answers requests."""

    _asked: tuple[int, ...] = ()

    def answers(self, round_: int) -> dict[int, PaperMessage]:
        """Return its trajectory as messages by slot, for units that requested it."""
        return {
            unit: PaperMessage(PaperKind.ANSWER, round_, unit, self.index, self.flying)
            for unit in self._asked
        }

    def accepts(self, message: PaperMessage) -> bool:
        """Return True if it would fly a plan that was the only message received in a round."""
        if message.kind is not PaperKind.TRAJECTORY or message.drone != self.index:
            return False
        assert message.trajectory is not None
        return message.trajectory.identity > self.flying.identity or (
            message.trajectory.identity.start_round > self.flying.identity.start_round
        )

    def receive(self, inbox: Inbox[PaperMessage]) -> Trajectory | None:
        """Process a round's messages; return the accepted plan: the newest, of the highest unit."""
        asking = [m for m in inbox.slots.values() if m.kind is PaperKind.REQUEST]
        self._asked = tuple(m.unit for m in asking if m.drone == self.index)
        plans = [m.trajectory for m in inbox.slots.values() if self.accepts(m) and m.trajectory]
        if not plans:
            return None
        self.flying, self.airborne = max(plans, key=lambda plan: plan.identity), True
        return self.flying


class _UnitState(IntEnum):
    """The state of a unit in Algorithm 1."""

    RUN_DMPC = 0  # Plans
    WAIT = 1  # Learns which trajectories it lacks
    REQUEST_TRAJECTORY = 2  # Requests one
    WAIT_FOR_UPDATE = 3  # Leaves its slot to the answer


@dataclass
class PaperUnit:
    """Compute unit w as published: Algorithm 1, with Algorithm 2 for its information trackers.

    Where text and pseudocode disagree, it follows the pseudocode: the text of 4.2.1 deprecates only
    the tracker of line 13, the pseudocode all. Ambiguities are resolved as in the public code:
    metadata without a match deprecate a tracker; an answer in a unit's slot counts as that unit's
    message; all units request the lowest number first. Priorities follow from the newest of several
    candidates, where Appendix A.1 takes the first, and a plan that fails its check is sent as
    EMPTY.
    """

    unit: int
    candidates: list[dict[Identity, Trajectory]]
    """D_iw by drone; empty if none is known."""
    targets: FloatArray  # (N, 3) m, as last received
    planner: Planner
    report: UnitRound = field(init=False)  # The unit's activity in the last round
    state: _UnitState = _UnitState.REQUEST_TRAJECTORY

    def __post_init__(self) -> None:
        self.deprecated = [not known for known in self.candidates]
        self.report = UnitRound(self.unit)
        self._just_planned = NONE

    def step(self, inbox: Inbox[PaperMessage] | None, round_: int) -> PaperMessage | None:
        """Return the message of a round or None (slot given away): Algorithm 1, lines 8 to 34."""
        self.report = UnitRound(self.unit, doing=self.state.name.lower())
        if inbox is not None:
            self.update_information_trackers(inbox)
        if not any(self.deprecated):
            self.state = _UnitState.RUN_DMPC
        elif self.state is _UnitState.RUN_DMPC:
            self.state = _UnitState.WAIT
        self.report.doing = self.state.name.lower()
        newest = [known[max(known)] if known else None for known in self.candidates]
        own = self.planner.prioritise(newest, self.targets, round_)
        own[[not known for known in self.candidates]] = _UNKNOWN
        message = PaperMessage(PaperKind.EMPTY, round_, self.unit)
        self._just_planned = NONE
        if self.state is _UnitState.RUN_DMPC:
            message = self._run(message, inbox, own, round_)
        elif self.state is _UnitState.WAIT:
            self.state = _UnitState.REQUEST_TRAJECTORY
        elif self.state is _UnitState.REQUEST_TRAJECTORY:
            asked = self.deprecated.index(True)
            message = message._replace(kind=PaperKind.REQUEST, drone=asked)
            self.state = _UnitState.WAIT_FOR_UPDATE
        else:
            self.state = _UnitState.REQUEST_TRAJECTORY
            return None
        if self._just_planned != NONE:
            own[self._just_planned] = JUST_PLANNED
        return message._replace(priorities=tuple(int(level) for level in own))

    def update_information_trackers(self, inbox: Inbox[PaperMessage]) -> None:
        """Update the trackers: Algorithm 2, updateInformationTrackers."""
        states = inbox.states
        self.targets[states.present] = states.target[states.present]
        for drone in np.flatnonzero(states.present).tolist():
            identity = Identity.of(int(states.identity[drone]))
            match = self.candidates[drone].get(identity)
            self.deprecated[drone] = match is None
            if match is not None:
                self.candidates[drone] = {identity: match}
        ambiguous = any(len(known) > 1 for known in self.candidates)
        if ambiguous or len(inbox.slots) != self.planner.options.num_units:
            self.deprecated = [True] * len(self.deprecated)
        for message in inbox.slots.values():
            if message.trajectory is not None:
                known = self.candidates[message.drone]
                known[message.trajectory.identity] = message.trajectory

    def _run(
        self, message: PaperMessage, inbox: Inbox[PaperMessage] | None, own: Levels, round_: int
    ) -> PaperMessage:
        """Return the message of state RUN_DMPC: lines 13 to 20 of Algorithm 1."""
        slots = {} if inbox is None else inbox.slots
        received = [m.priorities for m in slots.values() if m.priorities]
        joint = own
        if received:
            first = np.array(received[0], dtype=np.int64)
            joint = prio_consensus(first, [dict(enumerate(levels)) for levels in received[1:]])
        chosen = rank_by_priority(joint, round_)[: self.planner.options.num_units]
        drone = chosen[(round_ + self.unit) % self.planner.options.num_units]
        if len(self.candidates[drone]) != 1:
            self.report.doing = "several own"
            return message
        (trajectory,) = self.candidates[drone].values()
        others = [
            (other, one)
            for other, known in enumerate(self.candidates)
            for one in known.values()
            if other != drone
        ]
        config = self.planner.options.config
        paths = all_positions_from([one for _, one in others], round_ + 1, config)
        owner = np.array([other for other, _ in others], dtype=np.int64)
        neighbors = Neighbors(np.ascontiguousarray(paths[:, 1:]), owner, np.isin(owner, chosen))
        planned = self.planner.plan(drone, trajectory, neighbors, self.unit, round_)
        self.report.doing, self.report.drone, self.report.planned = "planned", drone, planned
        if not planned.accepted:
            return message
        self._just_planned = drone
        return message._replace(
            kind=PaperKind.TRAJECTORY, drone=drone, trajectory=planned.trajectory
        )


class TrustingUnit(PaperUnit):
    """DMPC that ignores loss (Sec. 5.4): drones are assumed to fly every plan. They collide."""

    def update_information_trackers(self, inbox: Inbox[PaperMessage]) -> None:
        """Update the candidates as if every received plan had arrived at its drone."""
        states = inbox.states
        self.targets[states.present] = states.target[states.present]
        for message in inbox.slots.values():
            if message.trajectory is not None:
                self.candidates[message.drone] = {message.trajectory.identity: message.trajectory}


class PaperNodes(SwarmNodes):
    """Nodes that follow the paper, with the arguments of `RecoveryNodes`.

    Raises:
        ValueError: Drones are to join, for which the paper has no protocol.
    """

    def __init__(
        self,
        hovers: list[Trajectory],
        targets: FloatArray,
        options: PlanningOptions,
        informed: bool,
        joins: Mapping[int, int],
    ) -> None:
        if joins:
            raise ValueError(f"drones {sorted(joins)} join, which only recovery=True supports")
        codec = Codec(len(hovers), options.num_units, options.config)
        nobody = MembershipView(ViewId(0, 0), (), frozenset())
        drones = [PaperDrone(i, one, nobody, options.config) for i, one in enumerate(hovers)]
        self._hovers = hovers if informed else []
        super().__init__(drones, targets, options, codec)

    def make_unit(self, unit: int, targets: FloatArray, since: int) -> PaperUnit:
        """Return a unit with the information given before the first round, or with none."""
        known = [] if since else self._hovers
        candidates = [{one.identity: one} for one in known] or [{} for _ in targets]
        return PaperUnit(unit, candidates, targets.copy(), Planner(self.options))

    def message_bytes(self, message: PaperMessage) -> int:
        """Return the size of a message in a compute unit's slot, bytes."""
        return len(message.pack())


class TrustingNodes(PaperNodes):
    """Nodes that ignore loss, whose units know the drones' trajectories when they start."""

    def make_unit(self, unit: int, targets: FloatArray, since: int) -> TrustingUnit:
        """Return a unit that knows the drones' trajectories."""
        candidates = [{drone.flying.identity: drone.flying} for drone in self.drones]
        return TrustingUnit(unit, candidates, targets.copy(), Planner(self.options))
