"""`swarm-envs fit --residual` finds a process that was planted in rows."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from swarm_envs.cli import main
from swarm_envs.hall import Hall
from swarm_envs.interactions import load
from swarm_envs.training.force_model.compare import flight_folds
from swarm_envs.training.force_model.force_fit_config import ResidualConfig
from swarm_envs.training.force_model.residual_fit import fit_residual, predicted_g
from swarm_envs.training.interaction_rows import InteractionRows, save_rows
from swarm_envs.vehicles import GRAM_FORCE
from tests.helpers.tiny_fits import make_rows

WEIGHT_G = (34.0, 67.0)
QUIET, WAKE, HALF = (0.03, 0.05), (0.12, 0.10), (0.08, 0.05)
ALONE = (0.01, 0.02)
TIME_S, OFFSET, WHITE_G, SIDEWAYS = 0.2, 0.04, 0.6, 0.5


def planted(flights: int = 60, count: int = 600) -> InteractionRows:
    """Flights of S under L and of L under S, whose labels are `wake` and a planted residual.

    In every third pair of flights the other drone is far away.
    """
    rng, parts = np.random.default_rng(1), []
    for flight in range(flights):
        kind = flight % 2
        time = 0.03 * np.arange(count)
        swing = 0.35 * np.sin(0.5 * time + flight)
        neighbor = np.zeros((count, 1, 6))
        lonely = flight // 2 % 3 == 0
        neighbor[:, 0, 0], neighbor[:, 0, 2] = swing + 5.0 * lonely, 0.4
        position = np.tile([0.0, 0.0, 1.0], (count, 1))
        pair = np.stack([position, position + neighbor[:, 0, :3]], axis=1)
        team = ("S", "L")[kind] + ("L", "S")[kind]
        modelled = load("wake").forces(pair, np.zeros_like(pair), team)[:, 0, 2] / GRAM_FORCE
        share = np.abs(modelled) / WEIGHT_G[kind]
        size = QUIET[kind] + (WAKE[kind] - QUIET[kind]) * share / (share + HALF[kind])
        size = ALONE[kind] + 0.0 * size if lonely else size
        kept, x = np.exp(-0.03 / TIME_S), np.zeros((count, 3))
        x[0] = rng.standard_normal(3)
        for k in range(1, count):
            x[k] = kept * x[k - 1] + np.sqrt(1 - kept**2) * rng.standard_normal(3)
        force = size[:, None] * WEIGHT_G[kind] * x * [SIDEWAYS, SIDEWAYS, 1.0]
        force[:, 2] += modelled + OFFSET * WEIGHT_G[kind] * rng.standard_normal()
        force += WHITE_G * rng.standard_normal((count, 3))
        parts.append((kind, position, neighbor, force))
    kinds = np.repeat([part[0] for part in parts], count)
    position, neighbor, force = (np.concatenate([part[k] for part in parts]) for k in (1, 2, 3))
    return make_rows(
        flights * count,
        ego_type=kinds,
        position=position,
        neighbor=neighbor,
        neighbor_type=1 - kinds[:, None],
        force_g=force,
        flight=np.repeat(np.arange(flights), count),
        step=np.tile(3 * np.arange(count), flights),
        vehicle=50 + kinds,
        scenario=kinds,
        validation=np.zeros(flights * count, dtype=np.bool_),
        scenario_names=("L2S", "S2L"),
    )


@pytest.fixture(scope="module")
def table(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("residual") / "rows.npz"
    save_rows(path, planted())
    return path


def options(table: Path, out: Path, **given: object) -> ResidualConfig:
    small = {"bootstrap": 20, "progress": False, "rows": 4000, "force": "wake"}
    return ResidualConfig(**{"data": table, "out": out, **small, **given})  # type: ignore[arg-type]


def test_a_planted_process_is_found_under_the_true_force(table, tmp_path, monkeypatch):
    """With the force known, by the file of a model, nothing else is left over."""
    monkeypatch.setattr(
        "swarm_envs.training.interaction_rows.modelled.load", lambda name: load("wake")
    )
    report = fit_residual(options(table, tmp_path, force="wake.json"))
    found = {name: np.array(values) for name, values in report.residual.items()}
    assert not report.cross_validated
    assert found["residual_quiet"] == pytest.approx(QUIET, rel=0.15)
    assert found["residual_alone"] == pytest.approx(ALONE, rel=0.15)
    modelled = np.array([0.2, 0.12])  # over the weight: the largest there are
    grown = [
        quiet + (wake - quiet) * modelled / (modelled + half)
        for quiet, wake, half in (
            (found["residual_quiet"], found["residual_wake"], found["residual_half"]),
            (np.array(QUIET), np.array(WAKE), np.array(HALF)),
        )
    ]
    assert grown[0] == pytest.approx(grown[1], rel=0.15)
    assert found["residual_time_s"] == pytest.approx(TIME_S, rel=0.1)
    assert found["residual_sideways"] == pytest.approx(SIDEWAYS, rel=0.1)
    assert found["offset"] == pytest.approx([OFFSET, OFFSET], rel=0.35)  # of 30 draws each
    assert report.white_noise_g == pytest.approx([WHITE_G, WHITE_G], rel=0.3)
    low, high = report.intervals["residual_time_s"][0]
    assert low < found["residual_time_s"][0] < high
    kept = json.loads((tmp_path / "residual.json").read_text())
    assert kept["residual"] == report.residual and len(kept["data_sha256"]) == 64


def test_a_flight_is_predicted_by_a_wake_that_has_not_seen_it(table, tmp_path):
    """Labels of the flights of one fold are spoiled: what is predicted for them stays."""
    rows = planted(20, 150)
    config = options(table, tmp_path, folds=2, rows=1000)
    honest = predicted_g(rows, config)
    own = flight_folds(rows, config.folds, config.seed) == 0
    assert 0 < own.sum() < len(rows)
    spoiled = rows.with_vertical_force(np.where(own, rows.force_g[:, 2] + 5.0, rows.force_g[:, 2]))
    again = predicted_g(spoiled, config)
    assert np.array_equal(honest[own], again[own])
    assert not np.array_equal(honest[~own], again[~own])


def test_the_command_line_and_what_it_refuses(table, tmp_path, capsys):
    arguments = ["fit", "--residual", "--data", str(table), "--out", str(tmp_path / "out")]
    quick = ["--bootstrap", "5", "--rows", "2000", "--no-progress", "--force", "wake"]
    assert main([*arguments, *quick]) == 0
    said = capsys.readouterr().out
    assert "residual_time_s" in said and "white noise of the labels" in said
    assert main([*arguments, *quick, "--folds", "61"]) == 1
    assert "there are 60 flights for 61 folds" in capsys.readouterr().err


@pytest.mark.slow
def test_the_hall_has_the_numbers_of_the_measured_flights(shared_data, tmp_path):
    """The numbers that ship, within half of their last digit, and the command that made them."""
    data = shared_data / "data" / "neural_swarm_flights_33hz.npz"
    report = fit_residual(ResidualConfig(data=data, out=tmp_path, bootstrap=2, progress=False))
    assert report.types == ("S", "L") and report.cross_validated
    for name, values in report.residual.items():
        shipped = np.atleast_1d(getattr(Hall(), name))
        digit = 0.005 if name in ("residual_time_s", "residual_sideways") else 0.0005
        assert np.array(values) == pytest.approx(shipped, abs=1.02 * digit), name
