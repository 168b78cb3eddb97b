"""Beliefs of a unit about a drone, message by message, against hand-worked cases of Sec. 4."""

from __future__ import annotations

from collections.abc import Set

import numpy as np
import pytest

from swarm_envs.baselines.mlr_dmpc.information_tracker import (
    InformationTrackers,
    SeparationGuarantee,
)
from swarm_envs.baselines.mlr_dmpc.messages import (
    DroneStates,
    MembershipView,
    MessageKind,
    UnitMessage,
    ViewId,
)
from swarm_envs.baselines.mlr_dmpc.mlr_dmpc_config import MlrDmpcConfig
from swarm_envs.baselines.mlr_dmpc.nodes import Drone
from swarm_envs.baselines.mlr_dmpc.radio import Inbox
from swarm_envs.baselines.mlr_dmpc.swarm_information import Membership
from swarm_envs.baselines.mlr_dmpc.trajectory import Identity, Trajectory, hover

REST = hover(np.array([0.0, 0.0, 1.0]), 3, 0.2)


def planned(start_round: int, unit: int = 0) -> Trajectory:
    return Trajectory(Identity(start_round, unit), np.zeros((3, 3)), np.zeros((3, 3)), 0.2)


class Tracker:
    """Knowledge of drone 1 of three; of drone 0 the same is reported, of drone 2 nothing."""

    def __init__(self) -> None:
        self.all = InformationTrackers(3)

    def add(self, identity: Identity, contents: Trajectory | None) -> None:
        if contents is not None:
            self.all.learn(0, contents)
            self.all.learn(1, contents)
        self.all.add(np.array([0, 1]), identity, contents is None)

    def locate(self, identity: Identity, round_: int, at_rest: Trajectory | None) -> None:
        numbers = np.full(2, identity.number)
        self.all.locate(np.array([0, 1]), numbers, round_, lambda _: at_rest)

    @property
    def candidates(self) -> list[Trajectory]:
        return self.all.candidates(np.array([False, True, False]))[1]

    @property
    def missing(self) -> list[Identity]:
        found = self.all.missing(np.array([True, True, False]))
        assert [one for i, one in found if i == 0] == [one for i, one in found if i == 1]
        return [one for i, one in found if i == 1]

    @property
    def sole(self) -> Trajectory | None:
        return self.all.sole(1)

    @property
    def covering(self) -> bool:
        assert not self.all.covering[2] and self.all.covering[0] == self.all.covering[1]
        return bool(self.all.covering[1])

    def up_to_date(self, round_: int) -> bool:
        return bool(self.all.confirmed[1] == round_ - 1 and self.all.covering[1])

    def newest(self) -> Trajectory | None:
        assert self.all.newest()[2] is None
        return self.all.newest()[1]

    def settled(self, round_: int) -> bool:
        return bool(self.all.settled(round_)[1])

    def contents(self, identity: Identity) -> Trajectory | None:
        assert self.all.contents(2, identity) is None
        return self.all.contents(1, identity)

    def guarantee(self, identity: Identity) -> SeparationGuarantee | None:
        return self.all.guarantee(1, identity)


@pytest.fixture
def heard() -> Tracker:
    """A drone that said in round 4 that it rests where it started."""
    tracker = Tracker()
    tracker.locate(REST.identity, 4, REST)
    return tracker


def test_of_a_drone_never_heard_nothing_is_known() -> None:
    tracker = Tracker()
    tracker.add(planned(1).identity, planned(1))
    assert not tracker.covering
    assert not tracker.up_to_date(0)
    assert tracker.sole is None and not tracker.settled(5)
    tracker.add(planned(2).identity, None)
    assert tracker.guarantee(planned(2).identity) is None


def test_what_it_says_it_flies_is_all_it_flies(heard: Tracker) -> None:
    assert heard.covering
    assert heard.sole is REST
    assert heard.candidates == [REST] and heard.missing == []
    assert heard.newest() is REST
    assert [heard.up_to_date(round_) for round_ in (4, 5, 6)] == [False, True, False]


def test_a_plan_sent_to_it_is_a_second_candidate_that_unsettles_when_it_begins(
    heard: Tracker,
) -> None:
    plan = planned(6)
    heard.add(plan.identity, plan)
    assert heard.covering and heard.sole is None
    assert heard.candidates == [REST, plan]
    assert heard.newest() is plan
    assert heard.settled(6)  # only the first began before round 6
    assert not heard.settled(7)  # now it may fly either


def test_a_plan_of_unknown_contents_leaves_a_promise(heard: Tracker) -> None:
    earlier, late, unknown = planned(5), planned(6), planned(6, 1).identity
    for known in (earlier, late):
        heard.add(known.identity, known)
    heard.add(unknown, None)
    assert heard.missing == [unknown]
    assert not heard.covering and not heard.settled(0) and not heard.up_to_date(5)
    assert heard.newest() is late
    # `late` begins after round 5.
    assert heard.guarantee(unknown) == SeparationGuarantee(5, (REST, earlier))


def test_what_follows_an_unknown_plan_promises_nothing(heard: Tracker) -> None:
    first, beside, after = planned(6).identity, planned(6, 1).identity, planned(7).identity
    for unknown in (first, beside, after):
        heard.add(unknown, None)
    assert heard.guarantee(first) == heard.guarantee(beside) == SeparationGuarantee(5, (REST,))
    assert heard.guarantee(after) is None  # it may avoid what `first` would have flown


def test_locating_strikes_what_it_does_not_fly_but_no_later_plan(heard: Tracker) -> None:
    old, new, later = planned(5), planned(6), planned(7)
    for plan in (old, new, later):
        heard.add(plan.identity, plan)
    heard.add(planned(6, 1).identity, None)
    heard.locate(new.identity, 6, None)
    assert heard.candidates == [new, later]
    assert heard.all.confirmed.tolist() == [6, 6, -1] and heard.up_to_date(7)
    assert heard.guarantee(planned(6, 1).identity) is None


def test_a_lost_drone_is_located_anew_from_nothing(heard: Tracker) -> None:
    plan = planned(9)
    heard.add(plan.identity, plan)
    heard.all.lose()
    assert not heard.covering and not heard.up_to_date(5) and not heard.up_to_date(0)
    assert not heard.settled(9) and (heard.all.confirmed == -1).all()
    heard.locate(REST.identity, 7, None)
    assert heard.candidates == [REST] and heard.missing == []
    assert heard.sole is REST  # its contents were remembered


def test_contents_of_the_last_three_are_kept_for_others(heard: Tracker) -> None:
    plans = [planned(k) for k in range(5, 9)]
    for plan in plans:
        heard.all.learn(1, plan)
        assert heard.contents(plan.identity) is plan
    assert heard.candidates == [REST] and heard.missing == []
    heard.locate(plans[0].identity, 9, None)
    assert [heard.contents(p.identity) is p for p in plans] == [True] * 4
    assert heard.contents(REST.identity) is None


@pytest.mark.parametrize("order", [range(5, 14), range(13, 4, -1), (9, 5, 13, 7, 11, 6, 12, 8, 10)])
def test_the_three_newest_contents_are_kept_in_whatever_order_they_came(heard, order) -> None:
    for k in order:
        heard.all.learn(1, planned(k))
    heard.locate(REST.identity, 14, None)
    kept = [k for k in range(5, 14) if heard.contents(planned(k).identity) is not None]
    assert kept == [11, 12, 13] and heard.sole is REST


def test_rows_do_not_grow_with_the_time_that_a_drone_flies(heard: Tracker) -> None:
    width = heard.all.numbers.shape[1]
    for k in range(5, 50):
        heard.add(planned(k).identity, planned(k))
        heard.locate(planned(k).identity, k, None)
    assert heard.all.numbers.shape[1] == width


def test_what_it_says_at_rest_does_not_overwrite(heard: Tracker) -> None:
    again = hover(np.array([0.0, 0.0, 1.0]), 3, 0.2)
    heard.locate(REST.identity, 5, again)
    assert heard.sole is REST


def test_a_struck_plan_is_none(heard: Tracker) -> None:
    plan = planned(6)
    heard.add(plan.identity, plan)
    heard.all.strike({plan.identity.number: 0})
    heard.all.strike({plan.identity.number: 0})
    assert heard.sole is REST
    assert heard.all.sole(0) is None, "it was sent to this one"


def test_rows_grow_with_what_may_be_flown(heard: Tracker) -> None:
    plans = [planned(6, unit) for unit in range(20)]
    for plan in plans:
        heard.add(plan.identity, plan)
    assert heard.candidates == [REST, *plans]
    heard.locate(plans[7].identity, 6, None)
    assert heard.sole is plans[7]


A, B = ViewId(1, 0), ViewId(1, 1)


def announced(id_: ViewId, drones: set[int], gone: Set[int] = frozenset()) -> UnitMessage:
    view = MembershipView(id_, (0, 1), frozenset(drones), frozenset(gone))
    return UnitMessage(MessageKind.EMPTY, 3, id_.proposer, id_, members=view)


def heard_states(*joining: int) -> DroneStates:
    """Messages of three drones in round 9; some of them are about to join."""
    said, no = np.isin(np.arange(3), joining), np.zeros(3, dtype=bool)
    numbers = np.full(3, REST.identity.number), np.full(3, ViewId(0, 0).number)
    places = np.zeros((3, 3)), np.zeros((3, 3, 3))
    return DroneStates(9, said, *numbers, *places, ~no, said, no, no)


def locked(*messages: UnitMessage) -> ViewId:
    """The view of a drone after these messages, one a round; deployed were drones 0 and 1."""
    view = MembershipView(ViewId(0, 0), (0, 1), frozenset({0, 1}))
    drone = Drone(0, REST, view, MlrDmpcConfig())
    for round_, message in enumerate(messages):
        drone.receive(Inbox(round_, heard_states(), {message.unit: message}))
    return drone.view.id


def test_a_drone_follows_no_view_that_forgets_a_drone() -> None:
    """Else units of the new view plan, not knowing drone 2, while those of the old plan for it."""
    assert locked(announced(A, {0, 1, 2})) == A
    assert locked(announced(A, {0, 1, 2}), announced(B, {0, 1})) == A
    assert locked(announced(A, {0, 1, 2}), announced(B, {0, 1}, gone={2})) == B
    assert locked(announced(B, {0, 1}), announced(A, {0, 1, 2})) == B
    assert locked(announced(A, {0, 1, 2})._replace(members=None)) == ViewId(0, 0)


def test_a_unit_that_comes_back_proposes_no_view_of_a_name_that_it_has_used() -> None:
    """Before it died it may have proposed another one of which it no longer knows."""
    start = MembershipView(ViewId(0, 0), (0, 1), frozenset({0, 1}))
    states = heard_states(2)
    proposed = []
    for since in (0, 5):
        membership = Membership(0, start, 2, 3, since)
        membership.update(Inbox(9, states, {}), frozenset({0, 1}))
        assert membership.propose(10)
        assert membership.view.drones == {0, 1, 2}
        proposed.append(membership.view.id)
    assert len(set(proposed)) == 2
