"""What the radio loses."""

from __future__ import annotations

import numpy as np
import pytest

from swarm_envs.baselines.mlr_dmpc.loss import (
    PRESETS,
    GilbertElliott,
    Jam,
    LossModel,
    LossProcess,
)


def test_draws_do_not_depend_on_order_or_on_other_traffic():
    model = LossModel(unit_loss=0.3, drone_loss=0.2, bursts=PRESETS["bursts"].bursts, outage=0.1)
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
    both = Jam(first_round=5, last_round=5, senders="units", receivers="drone 1", both_ways=True)
    process = LossProcess(LossModel(jams=(jam, both)), 3, 2, seed=0)
    assert process.arrivals(1).all() and process.arrivals(4).all()
    lost = np.argwhere(~process.arrivals(3)).tolist()
    assert lost == [[3, 1], [4, 1]]
    assert np.argwhere(~process.arrivals(5)).tolist() == [[1, 3], [1, 4], [3, 1], [4, 1]]


def test_bursts_last_as_long_as_their_model_says():
    process = LossProcess(PRESETS["bursts"], 1, 1, seed=0)
    bad = np.array([not process.arrivals(k)[0, 1] for k in range(5_000)])
    starts = np.flatnonzero(np.diff(bad.astype(int)) == 1)
    assert bad.mean() == pytest.approx(0.02 / 0.22, rel=0.2)
    assert bad.sum() / len(starts) == pytest.approx(5.0, rel=0.2)


def test_the_blackout_preset_makes_units_deaf_for_ten_rounds():
    process = LossProcess(PRESETS["blackout"], 2, 2, seed=0)
    assert not process.arrivals(9)[:2, 2:].any() and process.arrivals(9)[:, :2].all()
    assert process.arrivals(10).all()


@pytest.mark.parametrize(
    ("make", "reason"),
    [
        (lambda: LossModel.of(1.2), r"loss is 1\.2, but must be a share in \[0, 1\]"),
        (lambda: LossModel.of(float("nan")), "must be a share"),
        (lambda: LossModel.of("2%"), "the presets are"),
        (lambda: LossModel(outage=-0.1), "outage is -0.1"),
        (lambda: GilbertElliott(turns_bad=2.0, turns_good=0.1), "turns_bad is 2.0"),
        (lambda: Jam(first_round=5, last_round=4), "rounds must be in order"),
        (lambda: Jam(first_round=0, last_round=4, senders="uav"), "names nobody"),
        (
            lambda: LossProcess(
                LossModel(jams=(Jam(first_round=0, last_round=1, senders="unit 2"),)), 3, 2, 0
            ),
            "there are 2 units",
        ),
    ],
)
def test_bad_models_are_refused_with_the_reason(make, reason):
    with pytest.raises(ValueError, match=reason):
        make()
