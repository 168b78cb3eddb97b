"""Early validation: pieces or flights of the training rows choose the weights, `val` never."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import torch

from swarm_envs.training.force_model.early import GUARD_ENTRIES, PIECE_ENTRIES, inner_split
from swarm_envs.training.force_model.train import predict, to_batch, train
from tests.helpers.tiny_fits import PLAIN, SPEC, rows_of


def test_pieces_of_early_validation_are_apart_in_time():
    rows = rows_of(4000)
    training, held_out = inner_split(rows, 0.2, 0)
    assert not (rows.validation & (training | held_out)).any()
    assert 0.05 < held_out.sum() / (~rows.validation).sum() < 0.4
    for flight in range(2):
        own = rows.flight == flight
        entry = rows.step // 3
        apart = np.abs(entry[own & training][:, None] - entry[own & held_out])
        assert apart.min() == GUARD_ENTRIES + 1
        pieces = np.unique(entry[own & held_out] // PIECE_ENTRIES)
        assert not np.isin(entry[own & training] // PIECE_ENTRIES, pieces).any()
    other = inner_split(rows, 0.2, 1)[1]
    assert (other != held_out).any()


def test_whole_flights_of_every_scenario_can_be_held_out():
    rows = rows_of(2000, flights=10)
    rows = dataclasses.replace(rows, scenario=rows.flight % 2)  # five flights of each
    training, held_out = inner_split(rows, 0.2, 0, "flights")
    flights = np.unique(rows.flight[held_out])
    assert len(flights) == 2 and set(flights % 2) == {0, 1}
    assert not np.isin(rows.flight[training], flights).any()
    assert ((training | held_out) == ~rows.validation).all()


def test_early_validation_needs_enough_rows():
    with pytest.raises(ValueError, match="no pieces can be held out for early validation"):
        inner_split(rows_of(100, flights=1), 0.2, 0)
    with pytest.raises(ValueError, match=r"share is 0\.7"):
        inner_split(rows_of(), 0.7, 0)


def test_early_validation_gives_its_best_weights_and_never_looks_at_validation():
    """Labels of pure noise: the longer the run, the worse, so the best is not the last."""
    rows = rows_of(noise=3.0)
    config = dataclasses.replace(
        PLAIN, steps=300, learning_rate=2e-2, early_validation=0.4, checkpoint_every=30
    )
    run = train(rows, SPEC, config, progress=False)
    errors = [entry["early_validation"] for entry in run.history]
    held_out = rows.select(inner_split(rows, 0.4, config.seed)[1])
    error = predict(run.network, to_batch(held_out)).numpy() - held_out.force_g[:, 2]
    assert np.mean(error**2) == pytest.approx(min(errors), rel=1e-4)
    assert run.best_step == run.history[int(np.argmin(errors))]["step"] < 300
    assert f"step {run.best_step}" in run.chosen
    spoiled = rows.with_vertical_force(np.where(rows.validation, 100.0, rows.force_g[:, 2]))
    same = train(spoiled, SPEC, config, progress=False)
    for a, b in zip(run.network.parameters(), same.network.parameters(), strict=True):
        assert torch.equal(a, b)


@pytest.mark.parametrize("name", ["validation", "neighbor", "flight"])
def test_checkpoint_of_other_rows_is_refused(name, tmp_path):
    """The same labels split otherwise would train on rows whose error is then called validation."""
    rows, path = rows_of(), tmp_path / "checkpoint.safetensors"
    short = dataclasses.replace(PLAIN, steps=2)
    train(rows, SPEC, short, path, progress=False)
    train(rows, SPEC, short, path, progress=False)
    other = dataclasses.replace(rows, **{name: getattr(rows, name)[::-1].copy()})
    with pytest.raises(ValueError, match="was written with other options: rows is"):
        train(other, SPEC, short, path, progress=False)
