"""A compute unit that keeps planning despite message loss."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from swarm_envs.baselines.mlr_dmpc.avoidance_planes import HalfSpaces, Neighbors
from swarm_envs.baselines.mlr_dmpc.messages import (
    NONE,
    RECENT,
    UNSURE,
    Codec,
    MessageKind,
    Missing,
    UnitMessage,
)
from swarm_envs.baselines.mlr_dmpc.mlr_dmpc_config import MlrDmpcConfig
from swarm_envs.baselines.mlr_dmpc.radio import Inbox
from swarm_envs.baselines.mlr_dmpc.swarm_information import (
    LISTENING_ROUNDS,
    SwarmInformation,
    assign_to_units,
    guaranteed_planes,
    with_relay,
)
from swarm_envs.baselines.mlr_dmpc.trajectory import (
    NOBODY,
    Trajectory,
    all_positions_from,
    least_distances,
)
from swarm_envs.baselines.mlr_dmpc.trajectory_qp import Planned
from swarm_envs.baselines.mlr_dmpc.unit_planner import (
    JUST_PLANNED,
    REINITIALISED,
    Levels,
    Planner,
    prio_consensus,
    rank_by_priority,
)
from swarm_envs.state import BoolArray

_CONTRADICTION = 1e-6


@dataclass
class UnitRound:
    """The activity of a unit in a round, for the statistics."""

    unit: int
    doing: str = "idle"  # `planned`, or the reason against it, such as `donated` or `not assigned`
    drone: int = NONE  # The drone it planned for
    planned: Planned | None = None  # The plan, accepted or not
    given_up: bool = False
    """True if a drone gave up its reference lately, so that nothing is guaranteed."""


@dataclass
class ComputeUnit:
    """A unit with this package's recovery, which plans as soon as its information suffices."""

    information: SwarmInformation
    planner: Planner
    codec: Codec
    since: int = 0  # The round in which it starts, or comes back
    report: UnitRound = field(init=False)  # The unit's activity in the last round
    _recent: tuple[int, ...] = (UNSURE,) * RECENT
    _sent: UnitMessage | None = None
    _granted: dict[int, int] = field(default_factory=dict)
    _trusted: bool = False
    _in_the_way: list[int] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.report = UnitRound(self.information.unit)
        if self.since == 0:
            self._recent = (NONE,) * RECENT

    def step(self, inbox: Inbox[UnitMessage] | None, round_: int) -> UnitMessage | None:
        """Return the message of round k, or None (slot given away), from the messages of k - 1."""
        info = self.information
        self.report = UnitRound(info.unit)
        if inbox is not None:
            info.update(inbox, self._sent)
        info.propose(round_)
        lacking = info.missing()
        complete = info.ready()
        self._trusted |= complete and not lacking
        own = self._priorities(round_)
        selection = self._lead(own, round_)
        given = round_ in self._granted or self._listening(round_)
        message = self._carry(round_, selection, lacking)
        if round_ in self._granted:
            self.report.doing = "donated"
        planned = message.kind is MessageKind.PLAN and not given
        self._recent = (message.drone if planned else NONE, *self._recent[: RECENT - 1])
        self._sent = None
        if not given:
            self._sent = self._completed(message, own, round_, lacking, complete)
        return self._sent

    def _completed(
        self, message: UnitMessage, own: Levels, round_: int, lacking: list[Missing], complete: bool
    ) -> UnitMessage:
        requested = sorted(lacking, key=self._request_order)[:3]
        message = message._replace(
            recent=self._recent,
            current=self.information.selection(round_),
            missing=tuple(requested),
            complete=complete and len(lacking) <= len(requested),
            members=self.information.membership.announced(round_),
        )
        order = [(i, int(own[i])) for i in rank_by_priority(own, round_) if own[i] > JUST_PLANNED]
        return self.codec.filled(message, order)

    def _request_order(self, missing: Missing) -> tuple[bool, bool, int]:
        """Return a request's sort key: first if it prevented a plan, then if confirmed."""
        turn = (missing.drone + 5 * self.information.unit) % len(self.information.targets)
        return missing.drone not in self._in_the_way, not self._confirmed_missing(missing), turn

    def _confirmed_missing(self, missing: Missing) -> bool:
        """Return True if a message of the drone has named the missing trajectory as flown."""
        confirmed = self.information.trackers.confirmed[missing.drone]
        return bool(missing.identity.start_round <= confirmed)

    def _priorities(self, round_: int) -> Levels:
        info = self.information
        newest = info.trackers.newest()
        own = self.planner.prioritise(newest, info.targets, round_)
        for drone in np.flatnonzero(info.has_given_up(round_)):
            one = newest[drone]
            if one is not None and one.identity.compute_unit == NOBODY:
                own[drone] = REINITIALISED
        ready = info.flying & info.trackers.settled(round_)
        ready[[i for i in info.selection(round_) or () if i != NONE]] = False
        own[~ready] = JUST_PLANNED
        return own

    def _lead(self, own: Levels, round_: int) -> tuple[int, ...] | None:
        """Return the selected drones of the next round if this unit is the leader."""
        info = self.information
        view = info.view
        if not info.membership.member or view.leader(round_) != info.unit:
            return None
        barred = {*(info.selection(round_) or ()), *np.flatnonzero(info.membership.gone).tolist()}
        others = [
            {drone: level for drone, level in message.priorities if drone not in barred}
            for message in info.reported.values()
        ]
        joint = prio_consensus(own, others)
        ranked = rank_by_priority(joint, round_)
        order = [i for i in ranked if joint[i] > JUST_PLANNED and i in view.drones]
        chosen = assign_to_units(info, order[: len(view.units)], round_ + 1)
        info.select(round_ + 1, chosen)
        return chosen

    def _carry(
        self, round_: int, selection: tuple[int, ...] | None, lacking: list[Missing]
    ) -> UnitMessage:
        """Return a plan if possible, else a requested trajectory, else an empty message."""
        info = self.information
        message = UnitMessage(
            MessageKind.EMPTY, round_, info.unit, info.view.id, selection=selection
        )
        self._granted = {r: drone for r, drone in self._granted.items() if r >= round_}
        if round_ in self._granted:
            return message
        planned = self._plan(round_)
        if planned is not None and planned.accepted:
            return message._replace(
                kind=MessageKind.PLAN, drone=self.report.drone, trajectory=planned.trajectory
            )
        if lacking and planned is None and not self._listening(round_):
            self._grant(lacking, round_)
            slots = tuple(self._granted.get(round_ + ahead, NONE) for ahead in (1, 2, 3))
            while slots and slots[-1] == NONE:
                slots = slots[:-1]
            message = message._replace(donations=slots)
        return with_relay(info, message)

    def _grant(self, lacking: list[Missing], round_: int) -> None:
        """Give the next slots to drones if more is lacking than units can relay."""
        info = self.information
        granted = {drone for (_, r), drone in info.donated.items() if r > round_}
        needed = [m.drone for m in lacking if self._confirmed_missing(m)]
        plans = any(message.kind is MessageKind.PLAN for message in info.reported.values())
        if len(needed) <= len(info.view.units) and (plans or self._recent[0] != NONE):
            return
        needed = [drone for drone in needed if drone not in granted]
        turn = info.unit * len(needed) // max(len(info.view.units), 1)
        for ahead, drone in enumerate([*needed[turn:], *needed[:turn]][:3], start=1):
            self._granted[round_ + ahead] = drone

    def _plan(self, round_: int) -> Planned | None:
        """Plan for the assigned drone if the information suffices."""
        info, report = self.information, self.report
        self._in_the_way = []
        report.doing = self._obstacle_to_planning(round_)
        if report.doing:
            return None
        chosen = info.selection(round_)
        assert chosen is not None
        drone = chosen[info.view.rank(info.unit, round_)]
        own, lacking = info.trackers.sole(drone), ~info.trackers.covering
        if own is None:
            report.doing = "lacks own" if lacking[drone] else "several own"
            self._in_the_way = [drone]
            return None
        flying = info.flying
        flying[drone] = False
        planes: list[HalfSpaces] = []
        for other in np.flatnonzero(flying & lacking).tolist():
            found = None
            if self._trusted and other not in chosen and self._config.planes == "fixed":
                found = guaranteed_planes(info, drone, own, other, round_, self._config)
            if found is None:
                report.doing = "lacks another"
                self._in_the_way = [other]
                return None
            planes.append(found)
        neighbors = self._possible(drone, own, flying, chosen, round_)
        if neighbors is None:
            report.doing = "no room to join"
            return None
        report.doing, report.drone = "planned", drone
        report.given_up = bool(info.has_given_up(round_).any())
        report.planned = self.planner.plan(drone, own, neighbors, info.unit, round_, planes)
        return report.planned

    def _listening(self, round_: int) -> bool:
        """Return True if the unit may have given this slot away before it crashed."""
        return self.since > 0 and round_ < self.since + LISTENING_ROUNDS

    def _obstacle_to_planning(self, round_: int) -> str:
        info = self.information
        if self._listening(round_):
            return "listening"
        if not info.membership.member:
            return "not a member"
        if not info.ready():
            return "lacks locations"
        chosen = info.selection(round_)
        if chosen is None:
            return "unknown selection"
        rank = info.view.rank(info.unit, round_)
        if rank >= len(chosen) or chosen[rank] == NONE:
            return "not assigned"
        return ""

    def _possible(
        self, drone: int, own: Trajectory, others: BoolArray, chosen: tuple[int, ...], round_: int
    ) -> Neighbors | None:
        """Return possible trajectories of others (N,); None if a joining drone must wait.

        Flown trajectories keep their distance, so candidates that come too close to this drone's
        certain trajectory are not flown. A drone that is not airborne yet excludes none. It is
        airborne from t(k+1) on, a sample before those of its plan.
        """
        info, start, config = self.information, round_ + 1, self._config
        least = config.sampled_distance_m - _CONTRADICTION
        owner, paths = info.trackers.candidates(others)
        theirs = all_positions_from(paths, start, config)
        path = all_positions_from([own], start, config)[0]
        near = least_distances(path, theirs, config.inverse_scaling) < least
        if near.any() and info.membership.joining[drone]:
            return None
        given_up = info.has_given_up(round_)
        kept = ~near | given_up[owner] | given_up[drone]
        return Neighbors(
            np.ascontiguousarray(theirs[kept, 1:]), owner[kept], np.isin(owner[kept], chosen)
        )

    @property
    def _config(self) -> MlrDmpcConfig:
        return self.planner.options.config
