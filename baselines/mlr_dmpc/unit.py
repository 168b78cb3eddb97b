"""A compute unit that keeps planning whatever the radio loses."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import reduce

import numpy as np

from swarm_envs.baselines.mlr_dmpc.codec import Codec
from swarm_envs.baselines.mlr_dmpc.config import MlrDmpcConfig
from swarm_envs.baselines.mlr_dmpc.knowledge import Knowledge
from swarm_envs.baselines.mlr_dmpc.membership import LISTENING_ROUNDS
from swarm_envs.baselines.mlr_dmpc.messages import (
    NONE,
    RECENT,
    UNSURE,
    Kind,
    Missing,
    UnitMessage,
)
from swarm_envs.baselines.mlr_dmpc.neighbors import HalfSpaces
from swarm_envs.baselines.mlr_dmpc.network import Inbox
from swarm_envs.baselines.mlr_dmpc.plan import Planned
from swarm_envs.baselines.mlr_dmpc.planning import Planner, Rival, joined
from swarm_envs.baselines.mlr_dmpc.promises import promised_planes
from swarm_envs.baselines.mlr_dmpc.samples import least_distances, sampled
from swarm_envs.baselines.mlr_dmpc.sharing import placed, relayed
from swarm_envs.baselines.mlr_dmpc.trajectory import NOBODY, Trajectory
from swarm_envs.baselines.mlr_dmpc.triggers import (
    JUST_PLANNED,
    REINITIALISED,
    Levels,
    consensus,
    ranked,
)

_CONTRADICTION = 1e-6


@dataclass
class UnitRound:
    """What a unit did in a round, for the statistics."""

    unit: int
    """Who."""
    doing: str = "idle"
    """`planned`, or why not: `donated`, `unknown selection`, `not assigned`, ..."""
    drone: int = NONE
    """Whom it planned for."""
    planned: Planned | None = None
    """The plan, accepted or not."""
    voided: bool = False
    """Whether a drone gave up its reference lately, so that nothing is promised."""


@dataclass
class ComputeUnit:
    """Our recovery: plans whenever what it knows is enough for the plan at hand.

    Args:
        knowledge: what it starts with.
        planner: of the trajectories.
        codec: says what fits into a slot.
        since: round at which it starts or comes back.
    """

    knowledge: Knowledge
    planner: Planner
    codec: Codec
    since: int = 0
    report: UnitRound = field(init=False)
    """What the unit did in the last round."""
    _recent: tuple[int, ...] = (UNSURE,) * RECENT
    _sent: UnitMessage | None = None
    _gifts: dict[int, int] = field(default_factory=dict)
    _trusted: bool = False
    _in_the_way: list[int] = field(default_factory=list)

    def __post_init__(self) -> None:
        """Nothing done yet."""
        self.report = UnitRound(self.knowledge.unit)
        if self.since == 0:
            self._recent = (NONE,) * RECENT

    def step(self, inbox: Inbox[UnitMessage] | None, round_: int) -> UnitMessage | None:
        """The message of a round, if the slot is not given away.

        Args:
            inbox: what was heard in the last round.
            round_: k.
        """
        know = self.knowledge
        self.report = UnitRound(know.unit)
        if inbox is not None:
            know.update(inbox, self._sent)
        know.propose(round_)
        lacking = know.missing()
        complete = know.ready()
        self._trusted |= complete and not lacking
        own = self._priorities(round_)
        selection = self._lead(own, round_)
        given = round_ in self._gifts or self._listening(round_)
        message = self._carry(round_, selection, lacking)
        if round_ in self._gifts:
            self.report.doing = "donated"
        planned = message.kind is Kind.PLAN and not given
        self._recent = (message.drone if planned else NONE, *self._recent[: RECENT - 1])
        self._sent = None
        if not given:
            self._sent = self._completed(message, own, round_, lacking, complete)
        return self._sent

    def _completed(
        self,
        message: UnitMessage,
        own: Levels,
        round_: int,
        lacking: list[Missing],
        complete: bool,
    ) -> UnitMessage:
        wanted = sorted(lacking, key=self._wish)[:3]
        message = message._replace(
            recent=self._recent,
            current=self.knowledge.selection(round_),
            missing=tuple(wanted),
            complete=complete and len(lacking) <= len(wanted),
            members=self.knowledge.membership.announced(round_),
        )
        order = [(i, int(own[i])) for i in ranked(own, round_) if own[i] > JUST_PLANNED]
        return self.codec.filled(message, order)

    def _wish(self, missing: Missing) -> tuple[bool, bool, int]:
        """Order of wishes: what stood in the way, what is surely flown, then by turns."""
        turn = (missing.drone + 5 * self.knowledge.unit) % len(self.knowledge.trackers)
        return missing.drone not in self._in_the_way, not self._sure(missing), turn

    def _sure(self, missing: Missing) -> bool:
        """Whether the drone has said that it flies what is missing."""
        confirmed = self.knowledge.trackers[missing.drone].confirmed
        return missing.identity.start_round <= confirmed

    def _priorities(self, round_: int) -> Levels:
        """Own priorities of all drones for the next round."""
        know = self.knowledge
        known = [tracker.newest() for tracker in know.trackers]
        own = self.planner.look(known, know.targets, round_)
        current = know.selection(round_) or ()
        view = know.view.drones
        for drone, tracker in enumerate(know.trackers):
            here = drone in view and drone not in know.gone
            newest = tracker.settled(round_) if here and drone not in current else None
            if newest is None:
                own[drone] = JUST_PLANNED
            elif newest.identity.compute_unit == NOBODY and know.void(drone, round_):
                own[drone] = REINITIALISED
        return own

    def _lead(self, own: Levels, round_: int) -> tuple[int, ...] | None:
        """The drones of the next round, where this unit says which they are."""
        know = self.knowledge
        view = know.view
        if not know.membership.member or view.leader(round_) != know.unit:
            return None
        others = [dict(message.priorities) for message in know.reported.values()]
        current = know.selection(round_) or ()
        others = [
            {i: one for i, one in theirs.items() if i not in current and i not in know.gone}
            for theirs in others
        ]
        joint = consensus(own, others)
        order = [i for i in ranked(joint, round_) if joint[i] > JUST_PLANNED and i in view.drones]
        chosen = placed(know, order[: len(view.units)], round_ + 1)
        know.select(round_ + 1, chosen)
        return chosen

    def _carry(
        self, round_: int, selection: tuple[int, ...] | None, lacking: list[Missing]
    ) -> UnitMessage:
        """A plan if possible, else what another asks for, else nothing; asks if need be."""
        know = self.knowledge
        message = UnitMessage(Kind.EMPTY, round_, know.unit, know.view.id, selection=selection)
        self._gifts = {r: drone for r, drone in self._gifts.items() if r >= round_}
        if round_ in self._gifts:
            return message
        planned = self._plan(round_)
        if planned is not None and planned.accepted:
            return message._replace(
                kind=Kind.PLAN, drone=self.report.drone, trajectory=planned.trajectory
            )
        if lacking and planned is None and not self._listening(round_):
            self._give(lacking, round_)
            gifts = tuple(self._gifts.get(round_ + ahead, NONE) for ahead in (1, 2, 3))
            while gifts and gifts[-1] == NONE:
                gifts = gifts[:-1]
            message = message._replace(donations=gifts)
        return relayed(know, message)

    def _give(self, lacking: list[Missing], round_: int) -> None:
        """Give the next slots to drones, if so much is lacking that others cannot pass it on."""
        know = self.knowledge
        asked = {drone for (_, r), drone in know.donated.items() if r > round_}
        wanted = [m.drone for m in lacking if self._sure(m)]
        plans = any(message.kind is Kind.PLAN for message in know.reported.values())
        if len(wanted) <= len(know.view.units) and (plans or self._recent[0] != NONE):
            return
        wanted = [drone for drone in wanted if drone not in asked]
        turn = know.unit * len(wanted) // max(len(know.view.units), 1)
        for ahead, drone in enumerate([*wanted[turn:], *wanted[:turn]][:3], start=1):
            self._gifts[round_ + ahead] = drone

    def _plan(self, round_: int) -> Planned | None:
        """Plan for the assigned drone, if what is known is enough."""
        know, report = self.knowledge, self.report
        self._in_the_way = []
        report.doing = self._obstacle_to_planning(round_)
        if report.doing:
            return None
        chosen = know.selection(round_)
        assert chosen is not None
        drone = chosen[know.view.rank(know.unit, round_)]
        own = know.trackers[drone].sole
        if own is None:
            report.doing = "lacks own" if know.trackers[drone].missing else "several own"
            self._in_the_way = [drone]
            return None
        rivals: list[Rival] = []
        planes: list[HalfSpaces | None] = []
        for other in know.flying():
            if other == drone:
                continue
            concurrent = other in chosen
            if know.trackers[other].missing:
                found = None
                if self._trusted and not concurrent:
                    found = promised_planes(know, drone, own, other, round_, self._config)
                if found is None:
                    report.doing = "lacks another"
                    self._in_the_way = [other]
                    return None
                planes.append(found)
            candidates = know.trackers[other].candidates
            rivals += [Rival(other, one, concurrent) for one in candidates]
        kept = self._possible(drone, own, rivals, round_)
        if kept is None:
            report.doing = "no room to join"
            return None
        report.doing, report.drone = "planned", drone
        report.voided = any(know.void(i, round_) for i in range(len(know.trackers)))
        joint = reduce(joined, planes, None)
        report.planned = self.planner.plan(drone, own, kept, know.unit, round_, joint)
        return report.planned

    def _listening(self, round_: int) -> bool:
        """Whether the slot may still be given away from before the unit crashed."""
        return self.since > 0 and round_ < self.since + LISTENING_ROUNDS

    def _obstacle_to_planning(self, round_: int) -> str:
        know = self.knowledge
        if self._listening(round_):
            return "listening"
        if not know.membership.member:
            return "not a member"
        if not know.ready():
            return "lacks locations"
        chosen = know.selection(round_)
        if chosen is None:
            return "unknown selection"
        rank = know.view.rank(know.unit, round_)
        if rank >= len(chosen) or chosen[rank] == NONE:
            return "not assigned"
        return ""

    def _possible(
        self, drone: int, own: Trajectory, rivals: list[Rival], round_: int
    ) -> list[Rival] | None:
        """Rivals that can be true; None if a joining drone must wait.

        What is flown keeps its distance, so whatever does not keep it from what this drone surely
        flies is not flown. A drone that is not in the air yet proves nothing.
        """
        know, start = self.knowledge, round_ + 1
        least = self._config.distance_m - _CONTRADICTION
        mine = sampled(own, start, self._config)
        kept: list[Rival] = []
        if not rivals:
            return kept
        theirs = np.stack([sampled(rival.trajectory, start, self._config) for rival in rivals])
        gaps = least_distances(mine, theirs, self._config)
        for rival, near in zip(rivals, gaps < least, strict=True):
            if near and drone in know.joining:
                return None
            if not near or know.void(drone, round_) or know.void(rival.drone, round_):
                kept.append(rival)
        return kept

    @property
    def _config(self) -> MlrDmpcConfig:
        return self.planner.options.config
