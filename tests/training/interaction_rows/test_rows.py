"""The table of rows, its file, what it refuses, and the errors reported on it."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from swarm_envs.training.force_model.evaluate import mean_squared_errors
from swarm_envs.training.interaction_rows import InteractionRows, read_rows, save_rows


def some_rows(count):
    """Rows of arbitrary numbers, with up to two neighbours, a fifth of them held out."""
    rng = np.random.default_rng(0)
    kind = rng.integers(-1, 2, (count, 2))
    return InteractionRows(
        types=("S", "L"),
        ego_type=rng.integers(0, 2, count),
        position=rng.uniform(0, 1, (count, 3)),
        velocity=rng.normal(size=(count, 3)),
        neighbor=rng.normal(size=(count, 2, 6)),
        neighbor_type=kind,
        force_g=rng.normal(size=(count, 3)) - 3.0 * (kind >= 0).sum(axis=1)[:, None],
        flight=rng.integers(0, 3, count),
        step=np.arange(count),
        vehicle=rng.integers(50, 53, count),
        scenario=(kind >= 0).sum(axis=1),
        validation=np.arange(count) // 10 % 5 == 0,
        scenario_names=("alone", "pair", "three"),
    )


def test_rows_survive_their_file(tmp_path):
    rows = some_rows(100)
    save_rows(tmp_path / "rows.npz", rows)
    again = read_rows(tmp_path / "rows.npz")
    for entry in dataclasses.fields(rows):
        assert np.array_equal(getattr(again, entry.name), getattr(rows, entry.name)), entry.name
    assert again.types == rows.types


def test_bad_rows_are_refused(tmp_path):
    rows = some_rows(10)
    with pytest.raises(ValueError, match=r"velocity has shape \(9, 3\), but must have shape"):
        dataclasses.replace(rows, velocity=rows.velocity[:9])
    with pytest.raises(ValueError, match=r"neighbor_type lies in \[.*, 2\]"):
        dataclasses.replace(rows, neighbor_type=np.full((10, 2), 2))
    force = rows.force_g.copy()
    force[4, 1] = np.nan
    with pytest.raises(ValueError, match=r"force_g is nan at index \(4, 1\)"):
        dataclasses.replace(rows, force_g=force)
    np.savez(tmp_path / "other.npz", a=np.zeros(3))
    with pytest.raises(ValueError, match="neither 'interaction-rows-1'"):
        read_rows(tmp_path / "other.npz")
    with pytest.raises(FileNotFoundError, match="no file of interaction rows"):
        read_rows(tmp_path / "none.npz")


def test_errors_stand_beside_trivial_predictors():
    rows = some_rows(1000)
    label, held_out = rows.force_g[:, 2], rows.validation
    perfect = mean_squared_errors(label, rows)
    assert perfect.overall == 0
    assert perfect.zero == pytest.approx(np.mean(label[held_out] ** 2))
    none = mean_squared_errors(np.zeros(1000), rows)
    assert none.overall == none.zero
    assert none.scenario == none.scenario_zero
    assert 0 < none.scenario_mean < none.zero
