"""Messages to the byte."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from swarm_envs.baselines.mlr_dmpc.codec import REQUEST_BYTES, SLOT_BYTES, STATE_BYTES, Codec
from swarm_envs.baselines.mlr_dmpc.config import MlrDmpcConfig
from swarm_envs.baselines.mlr_dmpc.messages import (
    NONE,
    UNSURE,
    DroneState,
    Kind,
    Missing,
    UnitMessage,
)
from swarm_envs.baselines.mlr_dmpc.paper import PaperKind, PaperMessage
from swarm_envs.baselines.mlr_dmpc.trajectory import NOBODY, Identity, Trajectory
from swarm_envs.baselines.mlr_dmpc.views import View, ViewId

CONFIG = MlrDmpcConfig()
SIZES = [(4, 1), (16, 3), (64, 8), (256, 8)]


def trajectory(rng: np.random.Generator, identity: Identity) -> Trajectory:
    jerk = rng.normal(size=(15, 3))
    jerk[-1] = 0.0
    return Trajectory(identity, rng.normal(size=(3, 3)), jerk, 0.2)


def same(one: UnitMessage | PaperMessage, other: UnitMessage | PaperMessage) -> bool:
    mine, theirs = one.trajectory, other.trajectory
    if one._replace(trajectory=None) != other._replace(trajectory=None):
        return False
    if mine is None or theirs is None:
        return mine is theirs
    return (
        mine.identity == theirs.identity
        and np.array_equal(mine.state, theirs.state)
        and np.array_equal(mine.jerk, theirs.jerk)
    )


def random_message(rng: np.random.Generator, drones: int, units: int) -> UnitMessage:
    round_ = int(rng.integers(70_000))
    unit = int(rng.integers(units))
    kind = Kind(int(rng.integers(4)))
    identity = Identity(round_ + 1, unit)
    if kind is not Kind.PLAN:
        identity = Identity(max(round_ - int(rng.integers(50)), 0), NOBODY)
    ids = rng.integers(drones, size=3)
    missing = tuple(Missing(int(i), Identity(max(round_ - 3, 0), 0)) for i in ids)
    view = ViewId(int(rng.integers(9)), unit)
    everyone = frozenset(range(0, drones, 2))
    carries = kind is not Kind.EMPTY
    pick = tuple(int(i) for i in rng.integers(drones, size=units))
    answer = kind is Kind.ANSWER
    return UnitMessage(
        kind,
        round_,
        unit,
        view,
        int(ids[0]) if carries else NONE,
        trajectory(rng, identity) if carries else None,
        selection=pick if rng.random() < 0.5 and not answer else None,
        current=(*pick[1:], NONE) if rng.random() < 0.5 and not answer else None,
        recent=(UNSURE,) * 4 if answer else (int(ids[1]), NONE, UNSURE, int(ids[2])),
        donations=tuple(int(i) for i in ids)[: int(rng.integers(4))] if not carries else (),
        missing=missing[: int(rng.integers(4))] if not answer else (),
        complete=bool(rng.random() < 0.5) and not answer,
        members=View(view, tuple(range(units)), everyone) if not answer else None,
    )


@pytest.mark.parametrize(("drones", "units"), SIZES)
@settings(max_examples=60, deadline=None)
@given(seed=st.integers(0, 2**32))
def test_messages_in_slots_survive_packing_and_fit(drones, units, seed):
    rng, codec = np.random.default_rng(seed), Codec(drones, units, CONFIG)
    ranked = [(int(i), int(rng.integers(2, 256))) for i in rng.permutation(drones)]
    message = codec.filled(random_message(rng, drones, units), ranked)
    data = codec.pack(message)
    assert len(data) == codec.size(message)
    assert len(data) <= (REQUEST_BYTES if message.kind is Kind.EMPTY else SLOT_BYTES)
    assert same(codec.unpack(data, message.unit, message.round), message)


def test_a_leaders_plan_still_carries_priorities_in_every_swarm():
    rng = np.random.default_rng(0)
    for drones, units in SIZES:
        codec = Codec(drones, units, CONFIG)
        picks = tuple(range(min(units, drones)))
        message = UnitMessage(
            *(Kind.PLAN, 5, 0, ViewId(0, 0), 1, trajectory(rng, Identity(6, 0)), picks, picks)
        )
        filled = codec.filled(message, [(i, 9) for i in range(drones)])
        assert len(filled.priorities) >= 2, (drones, units)


@settings(max_examples=60, deadline=None)
@given(seed=st.integers(0, 2**32), flags=st.tuples(*[st.booleans()] * 4))
def test_drones_states_survive_packing_in_32_bytes(seed, flags):
    rng, codec = np.random.default_rng(seed), Codec(16, 3, CONFIG)
    lower, upper = np.array(CONFIG.box)
    target = codec.carried_targets(rng.uniform(lower, upper, (1, 3)))[0]
    place = rng.uniform(lower, upper)
    rest, *marks = flags
    moving = codec.carried(np.stack([place, rng.uniform(-2, 2, 3), rng.uniform(-5, 5, 3)]))
    kinematics = place[None].astype(np.float32).astype(float) if rest else moving
    round_ = int(rng.integers(100_000))
    identity = Identity(max(round_ - int(rng.integers(60_000)), 0), 2)
    state = DroneState(3, round_, identity, ViewId(7, 1), target, kinematics, *marks)
    data = codec.pack_state(state)
    back = codec.unpack_state(data, 3, round_)
    assert len(data) == codec.state_size(state) <= STATE_BYTES
    assert back[:4] == state[:4] and back[6:] == state[6:]
    assert back.target == pytest.approx(state.target, abs=1e-12)
    assert back.kinematics == pytest.approx(state.kinematics, abs=1e-12)


def test_what_16_bit_carry_is_finer_than_a_tenth_of_a_millimetre():
    codec, rng = Codec(16, 3, CONFIG), np.random.default_rng(0)
    points = rng.uniform(CONFIG.box[0], CONFIG.box[1], (1000, 3))
    assert np.abs(codec.carried_targets(points) - points).max() < 1e-4


@pytest.mark.parametrize("kind", list(PaperKind))
def test_the_papers_messages_survive_packing_within_its_slots(kind):
    rng = np.random.default_rng(1)
    priorities = tuple(int(p) for p in rng.integers(256, size=16))
    message = PaperMessage(kind, 20, 2, NONE if kind is PaperKind.EMPTY else 7)
    if kind is PaperKind.TRAJECTORY:
        message = message._replace(trajectory=trajectory(rng, Identity(21, 2)))
    if kind is PaperKind.ANSWER:
        message = message._replace(trajectory=trajectory(rng, Identity(12, 1)))
    else:
        message = message._replace(priorities=priorities)
    data = message.pack()
    assert len(data) <= (132 if kind in (PaperKind.EMPTY, PaperKind.REQUEST) else 242)
    assert same(PaperMessage.unpack(data, 2, 20, CONFIG), message)
