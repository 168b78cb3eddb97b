"""Messages to the byte, what the radio loses; deadlocks: forces push, and who makes room."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from swarm_envs.baselines.mlr_dmpc.messages import (
    NONE,
    REQUEST_BYTES,
    SLOT_BYTES,
    UNSURE,
    Codec,
    DroneStates,
    MembershipView,
    MessageKind,
    Missing,
    UnitMessage,
    ViewId,
)
from swarm_envs.baselines.mlr_dmpc.mlr_dmpc_config import MlrDmpcConfig
from swarm_envs.baselines.mlr_dmpc.paper_protocol import PaperKind, PaperMessage
from swarm_envs.baselines.mlr_dmpc.radio import GilbertElliott, Jam, LossModel, LossProcess
from swarm_envs.baselines.mlr_dmpc.trajectory import NOBODY as NO_OWNER
from swarm_envs.baselines.mlr_dmpc.trajectory import Identity, Trajectory, hover
from swarm_envs.baselines.mlr_dmpc.unit_planner import (
    NOBODY,
    Planner,
    PlanningOptions,
    SwarmSnapshot,
    deadlocked,
    next_detours,
    no_detours,
    rank_by_priority,
    unbalanced,
)

CONFIG = MlrDmpcConfig()
FLAGS = ("resting", "joining", "gone", "reinitialised")
SIZES = [(4, 1), (16, 3), (64, 8), (256, 8), (256, 16)]


def trajectory(rng: np.random.Generator, identity: Identity) -> Trajectory:
    jerk = rng.normal(size=(15, 3))
    jerk[-1] = 0.0
    return Trajectory(identity, rng.normal(size=(3, 3)), jerk, 0.2)


def content(message: UnitMessage | PaperMessage) -> tuple[object, ...]:
    """All that a message says, to be compared."""
    one = message.trajectory
    said = None if one is None else (one.identity, one.state.tolist(), one.jerk.tolist())
    return (*message._replace(trajectory=None), said)


def random_message(
    rng: np.random.Generator, kind: MessageKind, round_: int, unit: int, drones: int, units: int
) -> UnitMessage:
    identity = Identity(round_ + 1, unit)
    if kind is not MessageKind.PLAN:
        identity = Identity(max(round_ - int(rng.integers(50)), 0), NO_OWNER)
    ids = rng.integers(drones, size=3)
    missing = tuple(Missing(int(i), Identity(max(round_ - 3, 0), 0)) for i in ids)
    view = ViewId(int(rng.integers(9)), unit)
    everyone = frozenset(range(0, drones, 2))
    carries = kind is not MessageKind.EMPTY
    pick = tuple(int(i) for i in rng.integers(drones, size=units))
    plain = UnitMessage(kind, round_, unit, view)
    if carries:
        plain = plain._replace(drone=int(ids[0]), trajectory=trajectory(rng, identity))
    if kind is MessageKind.ANSWER:
        return plain
    return plain._replace(
        selection=pick if rng.random() < 0.5 else None,
        current=(*pick[1:], NONE) if rng.random() < 0.5 else None,
        recent=(int(ids[1]), NONE, UNSURE, int(ids[2])),
        donations=tuple(int(i) for i in ids)[: int(rng.integers(4))] if not carries else (),
        missing=missing[: int(rng.integers(4))],
        complete=bool(rng.random() < 0.5),
        members=MembershipView(view, tuple(range(units)), everyone, everyone),
    )


@pytest.mark.parametrize(("drones", "units"), SIZES)
@settings(max_examples=60, deadline=None)
@given(seed=st.integers(0, 2**32))
def test_messages_fit_into_slots_and_no_two_have_the_same_bytes(drones, units, seed):
    """A receiver knows slot, sender and round: all else must follow from the bytes."""
    rng, codec = np.random.default_rng(seed), Codec(drones, units, CONFIG)
    slot = MessageKind(int(rng.integers(4))), int(rng.integers(70_000)), int(rng.integers(units))
    order = [(int(i), int(rng.integers(2, 256))) for i in rng.permutation(drones)]
    one, other = (
        codec.filled(random_message(rng, *slot, drones, units), order[k:]) for k in (0, 1)
    )
    data = codec.pack(one)
    assert len(data) <= (REQUEST_BYTES if one.kind is MessageKind.EMPTY else SLOT_BYTES)
    for field in UnitMessage._fields:
        mixed = one._replace(**{field: getattr(other, field)})
        if mixed.members is not None:
            mixed = mixed._replace(members=mixed.members._replace(id=mixed.view))
        assert (codec.pack(mixed) == data) == (content(mixed) == content(one)), field


def test_a_leaders_plan_still_carries_priorities_in_every_swarm():
    rng = np.random.default_rng(0)
    for drones, units in SIZES:
        codec = Codec(drones, units, CONFIG)
        picks = tuple(range(min(units, drones)))
        plan = trajectory(rng, Identity(6, 0))
        message = UnitMessage(MessageKind.PLAN, 5, 0, ViewId(0, 0), 1, plan, picks, picks)
        filled = codec.filled(message, [(i, 9) for i in range(drones)])
        assert len(filled.priorities) >= 2, (drones, units)


@settings(max_examples=60, deadline=None)
@given(seed=st.integers(0, 2**32), flags=st.tuples(*[st.booleans()] * 4))
def test_drones_states_take_32_bytes_and_no_two_have_the_same(seed, flags):
    rng, codec = np.random.default_rng(seed), Codec(16, 3, CONFIG)
    lower, upper = np.array(CONFIG.box)
    round_ = int(rng.integers(60_000))

    def drawn(*said_so: bool) -> DroneStates:
        place = rng.uniform(lower, upper)
        still = np.stack([place.astype(np.float32).astype(float), np.zeros(3), np.zeros(3)])
        moving = codec.carried(np.stack([place, rng.uniform(-2, 2, 3), rng.uniform(-5, 5, 3)]))
        identity = np.array([Identity(int(rng.integers(round_ + 1)), 2).number])
        lock = np.array([ViewId(int(rng.integers(9)), 1).number])
        target = codec.carried(rng.uniform(lower, upper, (1, 1, 3)))[:, 0]
        kinematics, heard = (still if said_so[0] else moving)[None], np.array([True])
        resting, joining, gone, lost = (np.array([flag]) for flag in said_so)
        return DroneStates(
            round_, heard, identity, lock, target, kinematics, resting, joining, gone, lost
        )

    one, other = drawn(*flags), drawn(flags[0], *(not flag for flag in flags[1:]))
    (data,) = codec.pack_states(one)
    assert len(data) <= 32  # a drone's slot
    for name in ("identity", "lock", "target", "kinematics", *FLAGS):
        mixed = replace(one, **{name: getattr(other, name)})
        same = np.array_equal(getattr(mixed, name), getattr(one, name))
        assert (codec.pack_states(mixed) == [data]) == same, name
    assert codec.pack_states(one.heard(np.array([False]))) == []


def test_what_16_bit_carry_is_finer_than_a_tenth_of_a_millimetre():
    codec, rng = Codec(16, 3, CONFIG), np.random.default_rng(0)
    points = rng.uniform(CONFIG.box[0], CONFIG.box[1], (1000, 3))
    assert np.abs(codec.carried(points[:, None])[:, 0] - points).max() < 1e-4


@pytest.mark.parametrize("kind", list(PaperKind))
def test_the_papers_messages_fit_into_its_slots_and_no_two_have_the_same_bytes(kind):
    rng = np.random.default_rng(1)

    def drawn(drone: int) -> PaperMessage:
        message = PaperMessage(kind, 20, 2, NONE if kind is PaperKind.EMPTY else drone)
        if kind is PaperKind.TRAJECTORY:
            message = message._replace(trajectory=trajectory(rng, Identity(21, 2)))
        if kind is PaperKind.ANSWER:
            return message._replace(trajectory=trajectory(rng, Identity(12 + drone, 1)))
        return message._replace(priorities=tuple(int(p) for p in rng.integers(256, size=16)))

    one, other = drawn(7), drawn(3)
    assert len(one.pack()) <= (132 if kind in (PaperKind.EMPTY, PaperKind.REQUEST) else 242)
    for field in PaperMessage._fields:
        mixed = one._replace(**{field: getattr(other, field)})
        assert (mixed.pack() == one.pack()) == (content(mixed) == content(one)), field


UNIT_2_JAMMED = LossModel(jams=(Jam(first_round=0, last_round=1, senders="unit 2"),))
BURSTS = GilbertElliott(turns_bad=0.02, turns_good=0.2)  # five rounds on average


def test_draws_do_not_depend_on_order_or_on_other_traffic():
    model = LossModel(unit_loss=0.3, drone_loss=0.2, bursts=BURSTS, outage=0.1)
    one, other = LossProcess(model, 5, 2, seed=3), LossProcess(model, 5, 2, seed=3)
    forward = [one.arrivals(k) for k in range(40)]
    backward = [other.arrivals(k) for k in reversed(range(40))][::-1]
    assert np.array_equal(forward, backward)


def test_rates_are_those_of_the_receiver_and_own_messages_always_arrive():
    process = LossProcess(LossModel(unit_loss=0.5, drone_loss=0.1), 6, 3, seed=0)
    arrived = np.array([process.arrivals(k) for k in range(4000)])
    share = arrived.mean(axis=0)
    assert (np.diag(share) == 1.0).all()
    others = ~np.eye(9, dtype=bool)
    assert share[:, :6][others[:, :6]] == pytest.approx(0.9, abs=0.02)
    assert share[:, 6:][others[:, 6:]] == pytest.approx(0.5, abs=0.04)


def test_draws_of_different_keys_are_independent():
    process = LossProcess(LossModel.of(0.5), 4, 2, seed=1)
    arrived = np.array([process.arrivals(k) for k in range(3000)])
    pairs = arrived.reshape(3000, -1)[:, ~np.eye(6, dtype=bool).ravel()].astype(float)
    assert np.abs(np.corrcoef(pairs.T) - np.eye(pairs.shape[1])).max() < 0.09
    later = np.array([np.corrcoef(pairs[:-1, i], pairs[1:, i])[0, 1] for i in range(30)])
    assert np.abs(later).max() < 0.08


def test_an_outage_takes_the_whole_round_of_a_receiver():
    arrived = LossProcess(LossModel(outage=0.5), 5, 1, seed=0).arrivals(7)
    for receiver, heard in enumerate(arrived.T):
        assert len(set(np.delete(heard, receiver))) == 1
    assert 0 < arrived.sum() < 36


def test_a_jam_covers_its_rounds_senders_receivers_and_direction():
    jam = Jam(first_round=2, last_round=3, senders="units", receivers="drone 1")
    process = LossProcess(LossModel(jams=(jam,)), 3, 2, seed=0)
    assert process.arrivals(1).all() and process.arrivals(4).all()
    lost = np.argwhere(~process.arrivals(3)).tolist()
    assert lost == [[3, 1], [4, 1]]


def test_bursts_last_as_long_as_their_model_says():
    process = LossProcess(LossModel(bursts=BURSTS), 1, 1, seed=0)
    bad = np.array([not process.arrivals(k)[0, 1] for k in range(5_000)])
    starts = np.flatnonzero(np.diff(bad.astype(int)) == 1)
    assert bad.mean() == pytest.approx(0.02 / 0.22, rel=0.2)
    assert bad.sum() / len(starts) == pytest.approx(5.0, rel=0.2)


@pytest.mark.parametrize(
    ("make", "reason"),
    [
        (lambda: LossModel.of(1.2), r"loss is 1\.2, but must be a share in \[0, 1\]"),
        (lambda: LossModel.of(float("nan")), "must be a share"),
        (lambda: Jam(first_round=5, last_round=4), "rounds must be in order"),
        (lambda: Jam(first_round=0, last_round=4, senders="uav"), "names no drone"),
        (lambda: LossProcess(UNIT_2_JAMMED, 3, 2, 0), "there are 3 drones and 2 units"),
    ],
)
def test_bad_models_are_refused_with_the_reason(make, reason):
    with pytest.raises(ValueError, match=reason):
        make()


def snapshot(positions: list[list[float]], targets: list[list[float]]) -> SwarmSnapshot:
    at = np.array(positions)
    return SwarmSnapshot(at, np.zeros_like(at), at, np.array(targets))


def test_contacts_push_but_do_not_pull():
    pull = np.array([1.0, 0.0, 0.0])
    assert unbalanced(pull, np.array([[-2.0, 0.0, 0.0]])) == pytest.approx(0.0)
    assert unbalanced(pull, np.array([[1.0, 0.0, 0.0]])) == pytest.approx(1.0)
    assert unbalanced(pull, np.array([[-1.0, 1.0, 0.0]])) == pytest.approx(np.sqrt(0.5))
    assert unbalanced(pull, np.array([[-1.0, 1.0, 0.0], [-1.0, -1.0, 0.0]])) == pytest.approx(0.0)
    assert unbalanced(pull, np.zeros((0, 3))) == 1.0


HEAD_ON = ([[0.0, 0.0, 1.0], [0.25, 0.0, 1.0]], [[1.0, 0.0, 1.0], [-1.0, 0.0, 1.0]])


def test_two_head_on_are_in_a_deadlock_and_two_back_to_back_are_not():
    ends, targets = np.array(HEAD_ON[0]), np.array(HEAD_ON[1])
    still = np.zeros(2)
    assert deadlocked(ends, still, targets, CONFIG).all()
    assert not deadlocked(ends, still, targets[::-1], CONFIG).any(), "unsigned it would be"
    assert not deadlocked(ends, still + 0.2, targets, CONFIG).any(), "they move"
    assert not deadlocked(ends * 2.0, still, targets, CONFIG).any(), "they do not touch"
    near = ends + np.array([[0.05, 0.0, 0.0], [-0.05, 0.0, 0.0]])
    assert not deadlocked(ends, still, near, CONFIG).any(), "they have all but arrived"


@pytest.mark.parametrize(
    ("ends", "targets"),
    [
        ([[0.0, 0.0, 0.6], [0.0, 0.0, 2.1]], [[0.0, 0.0, 2.1], [0.0, 0.0, 0.6]]),
        ([[2.0, 0.0, 1.0]], [[3.0, 0.0, 1.0]]),
    ],
)
def test_drones_under_others_touch_as_far_as_theta_says_and_walls_push_too(ends, targets):
    assert deadlocked(np.array(ends), np.zeros(len(ends)), np.array(targets), CONFIG).all()


def begun(targets: list[list[float]]) -> tuple[SwarmSnapshot, Any, np.random.Generator]:
    """Two drones head-on after round 20, when detours have begun."""
    swarm, rng = snapshot(HEAD_ON[0], targets), np.random.default_rng(0)
    return swarm, next_detours(no_detours(2), swarm, 20, CONFIG, rng), rng


def test_the_nearer_to_its_target_makes_room_sideways():
    swarm, detours, _ = begun([[1.0, 0.0, 1.0], [-0.5, 0.0, 1.0]])
    assert detours.for_whom.tolist() == [1, NOBODY] or detours.for_whom.tolist() == [NOBODY, 0]
    left = np.linalg.norm(swarm.targets - swarm.positions, axis=1)
    who = int(np.flatnonzero(detours.for_whom != NOBODY)[0])
    assert left[who] == left.min()
    assert np.linalg.norm((detours.targets[who] - swarm.positions[who])[1:]) > 0.1
    current = detours.current(swarm.targets)
    assert np.array_equal(current[1 - who], swarm.targets[1 - who])
    assert np.array_equal(current[who], detours.targets[who])


def test_whoever_rests_at_its_target_stays_and_the_other_steps_aside():
    _, detours, _ = begun([[1.0, 0.0, 1.0], [0.25, 0.0, 1.0]])
    assert detours.for_whom.tolist() == [0, NOBODY]


def test_detours_last_their_rounds_then_pause():
    swarm, detours, rng = begun(HEAD_ON[1])
    began = detours.since.max()
    busy = []
    for k in range(21, 40):
        detours = next_detours(detours, swarm, k, CONFIG, rng)
        busy.append(bool((detours.for_whom != NOBODY).any()) and detours.since.max() == began)
    assert sum(busy) == CONFIG.detour_rounds - 1 and busy[0]


def test_a_detour_ends_when_the_plan_that_it_was_for_ends_at_its_target():
    swarm, detours, rng = begun(HEAD_ON[1])
    stuck = int(detours.for_whom.max())
    ends = swarm.ends.copy()
    ends[stuck] = swarm.targets[stuck]
    assert (next_detours(detours, swarm, 21, CONFIG, rng).for_whom == stuck).any()
    free = next_detours(detours, swarm._replace(ends=ends), 21, CONFIG, rng)
    assert (free.for_whom == NOBODY).all()


@pytest.mark.parametrize(
    ("trigger", "ages", "first"),
    [
        ("DT", (1, 20), 0),
        ("HT", (1, 4), 1),
        ("WT", (1, 4), 0),
        ("WT", (1, 20), 1),
        ("RR", (1, 4), 1),
    ],
)
def test_who_is_planned_first_by_distance_and_rounds_since_the_last_plan(trigger, ages, first):
    """Distances are 2 m and 0.7 m: 2 x 1 < 0.7 x 4, but 2 x 5 > 0.7 x 8 and 2 x 5 < 0.7 x 24."""
    places, targets = np.array([[-1.5, 0.0, 1.0], [1.5, 0.0, 1.0]]), np.zeros((2, 3))
    targets[:] = [[0.5, 0.0, 1.0], [1.5, 0.7, 1.0]]
    flown = [
        replace(hover(place, 15, 0.2), identity=Identity(21 - age, 0))
        for place, age in zip(places, ages, strict=True)
    ]
    options = PlanningOptions(config=replace(CONFIG, trigger=trigger), num_drones=2, num_units=1)
    assert rank_by_priority(Planner(options).prioritise(flown, targets, 20), 20)[0] == first


def test_places_are_in_the_box_and_depend_on_the_seed_alone():
    box = ((-0.3, -0.3, 0.8), (0.6, 0.3, 1.2))
    config = replace(CONFIG, box=box, detour_noise_m=1.0)
    swarm = snapshot(*HEAD_ON)
    places = [
        next_detours(no_detours(2), swarm, 9, config, np.random.default_rng(s)).targets
        for s in (0, 0, 1)
    ]
    assert np.array_equal(places[0], places[1]) and not np.array_equal(places[0], places[2])
    used = places[0][np.any(places[0] != 0.0, axis=1)]
    assert (used >= np.array(box[0])).all() and (used <= np.array(box[1])).all()
