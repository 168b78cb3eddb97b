"""What a unit may believe of a drone, message by message, against hand-worked cases of Sec. 4."""

from __future__ import annotations

from collections.abc import Set

import numpy as np
import pytest

from swarm_envs.baselines.mlr_dmpc.information_tracker import (
    InformationTracker,
    SeparationGuarantee,
)
from swarm_envs.baselines.mlr_dmpc.messages import (
    Codec,
    DroneState,
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


@pytest.fixture
def heard() -> InformationTracker:
    """A drone that said in round 4 that it rests where it started."""
    tracker = InformationTracker()
    tracker.locate(REST.identity, 4, REST)
    return tracker


def test_of_a_drone_never_heard_nothing_is_known() -> None:
    tracker = InformationTracker()
    tracker.add(planned(1).identity, planned(1))
    assert not tracker.covering
    assert not tracker.up_to_date(0)
    assert tracker.sole is None and tracker.settled(5) is None
    tracker.add(planned(2).identity, None)
    assert tracker.guarantee(planned(2).identity) is None


def test_what_it_says_it_flies_is_all_it_flies(heard: InformationTracker) -> None:
    assert heard.covering
    assert heard.sole is REST
    assert heard.candidates == [REST] and heard.missing == []
    assert heard.newest() is REST
    assert [heard.up_to_date(round_) for round_ in (4, 5, 6)] == [False, True, False]


def test_a_plan_sent_to_it_is_a_second_candidate(heard: InformationTracker) -> None:
    plan = planned(6)
    heard.add(plan.identity, plan)
    assert heard.covering and heard.sole is None
    assert heard.candidates == [REST, plan]
    assert heard.newest() is plan


def test_settled_is_the_newest_while_one_alone_can_have_begun(heard: InformationTracker) -> None:
    plan = planned(6)
    heard.add(plan.identity, plan)
    assert heard.settled(6) is plan  # only the first began before round 6
    assert heard.settled(7) is None  # now it may fly either


def test_a_plan_of_unknown_contents_leaves_a_promise(heard: InformationTracker) -> None:
    earlier, late, unknown = planned(5), planned(6), planned(6, 1).identity
    for known in (earlier, late):
        heard.add(known.identity, known)
    heard.add(unknown, None)
    assert heard.missing == [unknown]
    assert not heard.covering and heard.settled(0) is None and not heard.up_to_date(5)
    assert heard.newest() is late
    assert heard.guarantee(unknown) == SeparationGuarantee(
        5, (REST, earlier)
    )  # `late` begins after round 5


def test_what_follows_an_unknown_plan_promises_nothing(heard: InformationTracker) -> None:
    first, beside, after = planned(6).identity, planned(6, 1).identity, planned(7).identity
    for unknown in (first, beside, after):
        heard.add(unknown, None)
    assert heard.guarantee(first) == heard.guarantee(beside) == SeparationGuarantee(5, (REST,))
    assert heard.guarantee(after) is None  # it may avoid what `first` would have flown


def test_locating_strikes_what_it_does_not_fly_but_no_later_plan(heard: InformationTracker) -> None:
    old, new, later = planned(5), planned(6), planned(7)
    for plan in (old, new, later):
        heard.add(plan.identity, plan)
    heard.add(planned(6, 1).identity, None)
    heard.locate(new.identity, 6, None)
    assert heard.candidates == [new, later]
    assert heard.confirmed == 6 and heard.up_to_date(7)
    assert heard.guarantee(planned(6, 1).identity) is None


def test_a_lost_drone_is_located_anew_from_nothing(heard: InformationTracker) -> None:
    plan = planned(9)
    heard.add(plan.identity, plan)
    heard.lose()
    assert not heard.covering and not heard.up_to_date(5) and not heard.up_to_date(0)
    assert heard.settled(9) is None
    heard.locate(REST.identity, 7, None)
    assert heard.possible == {REST.identity}
    assert heard.sole is REST  # its contents were remembered


def test_contents_of_the_last_three_are_kept_for_others(heard: InformationTracker) -> None:
    plans = [planned(k) for k in range(5, 9)]
    for plan in plans:
        heard.learn(plan)
        assert heard.contents(plan.identity) is plan
    assert heard.possible == {REST.identity}
    heard.locate(plans[0].identity, 9, None)
    assert [heard.contents(p.identity) is p for p in plans] == [True] * 4
    assert heard.contents(REST.identity) is None


def test_what_it_says_at_rest_does_not_overwrite(heard: InformationTracker) -> None:
    again = hover(np.array([0.0, 0.0, 1.0]), 3, 0.2)
    heard.locate(REST.identity, 5, again)
    assert heard.sole is REST


def test_a_struck_plan_is_none(heard: InformationTracker) -> None:
    plan = planned(6)
    heard.add(plan.identity, plan)
    heard.strike(plan.identity)
    heard.strike(plan.identity)
    assert heard.sole is REST


A, B = ViewId(1, 0), ViewId(1, 1)


def announced(id_: ViewId, drones: set[int], gone: Set[int] = frozenset()) -> UnitMessage:
    view = MembershipView(id_, (0, 1), frozenset(drones), frozenset(gone))
    return UnitMessage(MessageKind.EMPTY, 3, id_.proposer, id_, members=view)


def locked(*messages: UnitMessage) -> ViewId:
    """What a drone is locked to that hears these, one a round; deployed were drones 0 and 1."""
    view = MembershipView(ViewId(0, 0), (0, 1), frozenset({0, 1}))
    config = MlrDmpcConfig()
    drone = Drone(0, REST, view, config, Codec(4, 2, config))
    for round_, message in enumerate(messages):
        drone.receive(Inbox(round_, [], {message.unit: message}))
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
    states = [DroneState(2, 9, REST.identity, start.id, np.zeros(3), np.zeros((1, 3)), True)]
    proposed = []
    for since in (0, 5):
        membership = Membership(0, start, 2, since)
        membership.update(Inbox(9, states, {}), frozenset({0, 1}))
        assert membership.propose(10)
        assert membership.view.drones == {0, 1, 2}
        proposed.append(membership.view.id)
    assert len(set(proposed)) == 2
