"""Comparison of force models on flights that are held out whole."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from swarm_envs.training.force_model.compare import (
    CompareConfig,
    compare,
    flight_folds,
    paired_difference,
)
from swarm_envs.training.interaction_rows import InteractionRows, save_rows
from tests.helpers.tiny_fits import make_rows


def flights(count: int = 1200, number: int = 6) -> InteractionRows:
    """Flights in which a small drone is pushed down under another one, by up to 8 g."""
    rng = np.random.default_rng(0)
    neighbor = rng.uniform(-1.0, 1.0, (count, 1, 6)) * [0.2, 0.2, 0.8, 0.3, 0.3, 0.3]
    beside = np.hypot(neighbor[:, 0, 0], neighbor[:, 0, 1])
    force = np.zeros((count, 3))
    force[:, 2] = -8.0 * np.exp(-((beside / 0.08) ** 2)) * (neighbor[:, 0, 2] > 0.0)
    return make_rows(
        count,
        position=rng.uniform(0.4, 1.2, (count, 3)),
        velocity=rng.uniform(-0.2, 0.2, (count, 3)),
        neighbor=neighbor,
        neighbor_type=np.zeros((count, 1), dtype=np.int64),
        force_g=force,
        flight=np.arange(count) * number // count,
        step=np.arange(count) % (count // number) * 3,
    )


def config_of(tmp_path: Path, **options: Any) -> CompareConfig:
    data = tmp_path / "rows.npz"
    if not data.is_file():
        save_rows(data, flights())
    given: dict[str, Any] = {"models": ("composed", "wake"), "folds": 2, "progress": False}
    return CompareConfig(data=data, out=tmp_path / "out", **given | options)


def test_a_comparison_goes_on_where_it_was_stopped(tmp_path: Path) -> None:
    found = compare(config_of(tmp_path, json=tmp_path / "said.json"))
    assert found.rows == 1200 and found.flights == 6
    assert 0.0 < found.errors["wake"]["all"] < 4.0
    difference = found.differences[0]
    assert [difference[k] for k in ("model", "other", "rows")] == ["composed", "wake", "all"]
    expected = found.errors["composed"]["all"] - found.errors["wake"]["all"]
    assert difference["mean"] == pytest.approx(expected)
    assert difference["low"] <= difference["mean"] <= difference["high"]
    assert json.loads((tmp_path / "said.json").read_text())["errors"] == found.errors
    assert any("composed less wake, all rows" in line for line in found.lines())
    kept = tmp_path / "out" / "wake-0.npy"
    before = kept.stat().st_mtime_ns
    (tmp_path / "out" / "composed-1.npy").unlink()
    again = compare(config_of(tmp_path))
    assert again.errors == found.errors
    assert kept.stat().st_mtime_ns == before
    with pytest.raises(ValueError, match="of another comparison: seed is 0 there, 1 here"):
        compare(config_of(tmp_path, seed=1))


def test_models_are_tested_on_two_neighbors_after_a_fit_to_one(tmp_path: Path) -> None:
    one, second = flights(), np.zeros((1200, 1, 6))
    second[:, 0, :3] = [0.05, 0.0, 0.3]
    two = np.arange(1200) % 3 == 0
    rows = replace(
        one,
        neighbor=np.concatenate([one.neighbor, second], axis=1),
        neighbor_type=np.stack([np.zeros(1200, np.int64), np.where(two, 0, -1)], axis=1),
        force_g=one.force_g - 4.0 * two[:, None] * [0.0, 0.0, 1.0],
    )
    save_rows(tmp_path / "rows.npz", rows)
    found = compare(config_of(tmp_path, hold_out="two-neighbors", models=("wake",)))
    assert found.rows == two.sum()
    assert len(list((tmp_path / "out").glob("wake-*.npy"))) == 1


def test_flights_of_every_scenario_are_spread_over_the_folds() -> None:
    count = 60
    rows = make_rows(
        count,
        neighbor=np.zeros((count, 1, 6)),
        neighbor_type=np.full((count, 1), -1),
        flight=np.arange(count) // 3,
        scenario=np.arange(count) // 30,
        scenario_names=("one", "two"),
    )
    fold = flight_folds(rows, 5, 0)
    for flight in range(20):
        assert len(set(fold[rows.flight == flight].tolist())) == 1
    for scenario in (0, 1):
        assert np.bincount(fold[rows.scenario == scenario]).tolist() == [6] * 5
    assert (flight_folds(rows, 5, 1) != fold).any()
    few = replace(rows, flight=np.zeros(count, dtype=np.int64))
    with pytest.raises(ValueError, match="1 flights for 5 folds"):
        flight_folds(few, 5, 0)


def test_the_interval_is_one_of_flights_not_of_rows() -> None:
    """A thousand equal rows of a flight say no more than one."""
    rng = np.random.default_rng(1)
    by_flight = rng.normal(0.0, 1.0, 30)
    widths = []
    for copies in (1, 1000):
        flight = np.repeat(np.arange(30), copies)
        mean, low, high = paired_difference(
            by_flight[flight], np.zeros(len(flight)), flight, seed=0
        )
        assert mean == pytest.approx(by_flight.mean())
        assert low < mean < high
        widths.append(high - low)
    assert widths[0] == pytest.approx(widths[1])
    assert widths[0] == pytest.approx(4 * by_flight.std() / np.sqrt(30), rel=0.2)
