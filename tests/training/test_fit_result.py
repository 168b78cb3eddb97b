"""Results of a fit, residuals that are found, and comparison on flights held out whole."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.signal import lfilter

from swarm_envs.cli import main
from swarm_envs.hall import Hall
from swarm_envs.interactions import load
from swarm_envs.training.flight_logs.log_options import LogOptions
from swarm_envs.training.force_model.compare import (
    CompareConfig,
    compare,
    flight_folds,
    paired_difference,
)
from swarm_envs.training.force_model.force_fit_config import WEIGHTS, FitConfig
from swarm_envs.training.force_model.pipeline import fit
from swarm_envs.training.force_model.residual_fit import fit_residual, predicted_g
from swarm_envs.training.interaction_rows import InteractionRows, save_rows
from swarm_envs.training.provenance import differing
from swarm_envs.vehicles import GRAM_FORCE, LARGE, SMALL, SMALL_STRONG
from tests.helpers.tiny_fits import make_rows


def rows_of_types(types=("S", "L"), count=1500, seed=0):
    """Rows in which a neighbour pushes down by 2 g times one plus its type's index, if above."""
    rng = np.random.default_rng(seed)
    ego, kind = rng.integers(len(types), size=(2, count))
    neighbor = rng.uniform(-1.0, 1.0, (count, 1, 6)) * [0.1, 0.1, 0.6, 0.3, 0.3, 0.3]
    force = np.zeros((count, 3))
    force[:, 2] = np.where(neighbor[:, 0, 2] > 0.0, -2.0 * (1 + kind), 0.0)
    return make_rows(
        count,
        types=types,
        ego_type=ego,
        position=rng.uniform(0.4, 1.2, (count, 3)),
        velocity=rng.uniform(-0.2, 0.2, (count, 3)),
        neighbor=neighbor,
        neighbor_type=kind[:, None],
        force_g=force,
        vehicle=50 + ego,
    )


def config_of(rows, folder, **options):
    save_rows(folder / "rows.npz", rows)
    usual = {"steps": 5, "offsets": "none", "progress": False}
    return FitConfig(data=folder / "rows.npz", out=folder / "out", **{**usual, **options})


def lower_force(model, team, beside=0.0):
    """Vertical force, N, on the lower of two drones at rest."""
    position = [[[0.0, 0.0, 0.8], [beside, 0.0, 1.1]]]
    return model.forces(position, np.zeros((1, 2, 3)), team)[0, 0, 2]


def test_a_finished_fit_of_other_options_or_data_is_not_overwritten(tmp_path):
    config = config_of(rows_of_types(count=800), tmp_path)
    fit(config)
    path = config.out / "deep-set.safetensors"
    made = path.read_bytes()
    fit(replace(config, json=tmp_path / "said.json"))
    assert path.read_bytes() == made
    said = r"seed is 0 there, 1 here; logs.split_seed is 0 there, 1 here; choose another folder"
    with pytest.raises(ValueError, match=said):
        fit(replace(config, seed=1, logs=LogOptions(split_seed=1)))
    save_rows(tmp_path / "rows.npz", rows_of_types(count=800, seed=1))
    with pytest.raises(ValueError, match=r"options: data_sha256 is \w{64} there, \w{64} here; c"):
        fit(config)
    (config.out / "deep-set.json").write_text("[]")
    with pytest.raises(ValueError, match="not the report of a fit"):
        fit(config)
    assert path.read_bytes() == made


def test_configurations_differ_in_what_is_said():
    there = {"seed": 0, "noise": {"velocity": 0.1, "bias": 0}, "new": None, "long": "x" * 200}
    here = {"seed": 1, "noise": {"velocity": 0.2, "bias": 0}, "long": "y"}
    first, second, third = differing(there, here).split("; ")
    assert (first, second) == ("seed is 0 there, 1 here", "noise.velocity is 0.1 there, 0.2 here")
    assert third == f"long is {'x' * 77}... there, y here"
    assert differing(there, there) == ""


@pytest.mark.parametrize("model", ["deep-set", "composed", "wake"])
def test_of_a_pair_of_types_that_never_met_nothing_is_invented(model, tmp_path):
    rows = rows_of_types()
    met = (rows.neighbor_type[:, 0] == 0) | (rows.ego_type == 1)  # L is never over S
    report = fit(config_of(rows.select(met), tmp_path, model=model, steps=20))
    (note,) = [n for n in report.notes if "in no training row" in n]
    assert note.startswith("type 'L' is a neighbor of type 'S' in no training row: ")
    found = load(str(tmp_path / "out" / WEIGHTS[model]))
    assert lower_force(found, "SS") != 0.0
    pushed = lower_force(found, "SL")
    if model == "deep-set":
        assert pushed != 0.0 and "extrapolated" in note
    else:
        assert abs(pushed) < 1e-6 and "its force on it is zero" in note


def test_the_ground_under_a_type_that_never_flew_is_not_invented(tmp_path):
    rows = rows_of_types(count=1000)
    fit(config_of(rows.select(rows.ego_type == 0), tmp_path, model="wake"))
    found = load(str(tmp_path / "out" / "wake.json"))
    assert found.forces([[[0.0, 0.0, 0.08]]], np.zeros((1, 1, 3)), "L")[0, 0, 2] == 0.0


STRONG = replace(SMALL_STRONG, interaction_type="S*")
HUGE = replace(LARGE, interaction_type="XL")
QUICK = {"steps": 20, "learning_rate": 1e-2, "batch_size": 128}


@pytest.mark.parametrize("model", ["deep-set", "composed"])
def test_three_types_one_of_them_invented_are_fitted_and_fly(model, tmp_path):
    rows = rows_of_types(("S", "S*", "XL"))
    length: dict[str, Any] = {"steps": 150}
    if model == "composed":  # it begins with a wake of 20 g, narrow and steep
        length = {"steps": 300, "learning_rate": 6e-3}
    report = fit(config_of(rows, tmp_path, model=model, **QUICK | length))
    assert report.notes == []
    assert report.findings.errors.overall < 0.6 * report.findings.errors.zero
    found = load(str(tmp_path / "out" / WEIGHTS[model]))
    assert found.types == ("S", "S*", "XL")
    for upper, planted in ((SMALL, -2.0), (HUGE, -6.0)):
        # Beside the axis: neighbors are seldom exactly on it, so a short fit knows little there.
        force = lower_force(found, (STRONG, upper), 0.05)
        assert force / GRAM_FORCE == pytest.approx(planted, abs=1.0)
    with pytest.raises(ValueError, match="unknown interaction type 'L'"):
        lower_force(found, "SL")


@pytest.mark.parametrize("model", ["deep-set", "composed"])
@pytest.mark.parametrize(
    ("shown", "said", "felt"),
    [("neighbor_type", "'L' is a neighbor", "LS"), ("ego_type", "'L' is the drone of no", "SL")],
)
def test_a_type_that_never_pushed_or_never_felt_goes_on_so(model, shown, said, felt, tmp_path):
    rows = rows_of_types()
    small = getattr(rows, shown).reshape(len(rows), -1)[:, 0] == 0
    report = fit(config_of(rows.select(small), tmp_path, model=model, **QUICK))
    assert report.notes and all(said in note for note in report.notes)
    assert report.notes[0] in "\n".join(report.lines())
    found = load(str(tmp_path / "out" / WEIGHTS[model]))
    assert found.notes["notes"] == report.notes
    assert lower_force(found, "LL") == 0.0
    assert lower_force(found, felt) != 0.0


def test_a_fitted_wake_is_read_back_and_a_damaged_one_is_refused(tmp_path):
    length: dict[str, Any] = {"steps": 1000, "learning_rate": 3e-2}
    report = fit(config_of(rows_of_types(), tmp_path, model="wake", **QUICK | length))
    path = tmp_path / "out" / "wake.json"
    found = load(path)
    assert found.types == ("S", "L")
    assert report.findings.errors.overall < 0.5 * report.findings.errors.zero
    assert lower_force(found, "SL", 0.02) / GRAM_FORCE == pytest.approx(-4.0, abs=0.8)
    content = json.loads(path.read_text())
    for change, reason in (
        ({"format": "wake-0"}, "it has another format"),
        ({"advection_velocity": "relative"}, "must be 'neighbor'"),
        ({"pair": {}}, "'S>S'"),
        ({"combine_q": "two"}, "could not convert"),
        ({"combine_q": 0.0}, "combine_q is 0, .* must be at least 1"),
        ({"advection_speed": {"S": -1.0, "L": 1.0}}, "advection_speed .* negative"),
    ):
        path.write_text(json.dumps(content | change))
        with pytest.raises(ValueError, match=f"damaged or not a 'wake-1' file .*{reason}"):
            load(path)
    path.write_text("{")
    with pytest.raises(ValueError, match="fit it again by `swarm-envs fit --model wake`"):
        load(path)
    with pytest.raises(FileNotFoundError, match="does not exist"):
        load(tmp_path / "no.json")


WEIGHT_G = (34.0, 67.0)
QUIET, WAKE, HALF = (0.03, 0.05), (0.12, 0.10), (0.08, 0.05)
ALONE = (0.01, 0.02)
TIME_S, OFFSET, WHITE_G, SIDEWAYS = 0.2, 0.04, 0.6, 0.5


def residual_size(share: Any, quiet: Any, wake: Any, half: Any) -> Any:
    """Size of the residual over the weight, where the modelled force is a share of the weight."""
    return quiet + (wake - quiet) * share / (share + half)


def planted(flights: int = 60, count: int = 600) -> InteractionRows:
    """Flights of S under L and of L under S, whose labels are `wake` and a planted residual.

    In every third pair of flights the other drone is far away.
    """
    rng, parts, zeros = np.random.default_rng(1), [], np.zeros((count, 3))
    for flight in range(flights):
        kind = flight % 2
        time = 0.03 * np.arange(count)
        swing = 0.35 * np.sin(0.5 * time + flight)
        neighbor = np.zeros((count, 1, 6))
        lonely = flight // 2 % 3 == 0
        neighbor[:, 0, 0], neighbor[:, 0, 2] = swing + 5.0 * lonely, 0.4
        pair = np.array([0.0, 0.0, 1.0]) + np.stack([zeros, neighbor[:, 0, :3]], axis=1)
        team = ("S", "L")[kind] + ("L", "S")[kind]
        modelled = load("wake").forces(pair, np.zeros_like(pair), team)[:, 0, 2] / GRAM_FORCE
        share = np.abs(modelled) / WEIGHT_G[kind]
        size = residual_size(share, QUIET[kind], WAKE[kind], HALF[kind])
        size = ALONE[kind] + 0.0 * size if lonely else size
        kept, x = np.exp(-0.03 / TIME_S), rng.standard_normal((count, 3))
        x[1:] *= np.sqrt(1 - kept**2)
        x = lfilter([1.0], [1.0, -kept], x, axis=0)
        force = size[:, None] * WEIGHT_G[kind] * x * [SIDEWAYS, SIDEWAYS, 1.0]
        force[:, 2] += modelled + OFFSET * WEIGHT_G[kind] * rng.standard_normal()
        force += WHITE_G * rng.standard_normal((count, 3))
        parts.append((neighbor, force))
    neighbor, force = map(np.concatenate, zip(*parts))
    kinds = np.repeat(np.arange(flights) % 2, count)
    return make_rows(
        flights * count,
        ego_type=kinds,
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


def options(table: Path, out: Path, **given: object) -> FitConfig:
    small = {"bootstrap": 20, "progress": False, "steps": 100, "force": "wake"}
    return FitConfig(**{"data": table, "out": out, **small, **given})  # type: ignore[arg-type]


def test_a_planted_process_is_found_under_the_true_force(table, tmp_path, monkeypatch):
    """With the force known, by the file of a model, nothing else is left over."""
    monkeypatch.setattr(
        "swarm_envs.training.interaction_rows.modelled.load", lambda name: load("wake")
    )
    report = fit_residual(options(table, tmp_path, residual=True, force="wake.json"))
    found = {name: np.array(values) for name, values in report.residual.items()}
    assert not report.cross_validated
    assert found["residual_quiet"] == pytest.approx(QUIET, rel=0.15)
    assert found["residual_alone"] == pytest.approx(ALONE, rel=0.15)
    modelled = np.array([0.2, 0.12])  # over the weight: the largest there are
    fitted = (found[f"residual_{name}"] for name in ("quiet", "wake", "half"))
    grown = residual_size(modelled, *map(np.array, (QUIET, WAKE, HALF)))
    assert residual_size(modelled, *fitted) == pytest.approx(grown, rel=0.15)
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
    config = options(table, tmp_path, residual=True, folds=2, steps=20)
    honest = predicted_g(rows, config)
    own = flight_folds(rows, config.folds, config.seed) == 0
    assert 0 < own.sum() < len(rows)
    spoiled = rows.with_vertical_force(np.where(own, 2.0, 1.0) * rows.force_g[:, 2])
    again = predicted_g(spoiled, config)
    assert np.array_equal(honest[own], again[own])
    assert not np.array_equal(honest[~own], again[~own])


def test_the_command_line_and_what_it_refuses(table, tmp_path, capsys):
    arguments = ["fit", "--residual", "--data", str(table), "--out", str(tmp_path / "out")]
    quick = ["--bootstrap", "5", "--steps", "50", "--no-progress", "--force", "wake"]
    assert main([*arguments, *quick]) == 0
    said = capsys.readouterr().out
    assert "residual_time_s" in said and "white noise of the labels" in said
    assert main([*arguments, *quick, "--folds", "61"]) == 1
    assert "there are 60 flights for 61 folds" in capsys.readouterr().err


@pytest.mark.slow
def test_the_hall_has_the_numbers_of_the_measured_flights(shared_data, tmp_path):
    """The numbers that ship lie in the intervals of an identification made anew."""
    data = shared_data / "data" / "neural_swarm_flights_33hz.npz"
    report = fit_residual(
        FitConfig(data=data, out=tmp_path, residual=True, bootstrap=200, progress=False)
    )
    assert report.types == ("S", "L") and report.cross_validated
    for name, intervals in report.intervals.items():
        for shipped, (low, high) in zip(np.atleast_1d(getattr(Hall(), name)), intervals):
            assert low - 0.0005 <= shipped <= high + 0.0005, name


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


def comparison_of(tmp_path: Path, **options: Any) -> CompareConfig:
    data = tmp_path / "rows.npz"
    if not data.is_file():
        save_rows(data, flights())
    usual: dict[str, Any] = {"models": ("composed", "wake"), "folds": 2, "steps": 60}
    return CompareConfig(data=data, out=tmp_path / "out", progress=False, **usual | options)


def test_a_comparison_goes_on_where_it_was_stopped(tmp_path: Path) -> None:
    found = compare(comparison_of(tmp_path, json=tmp_path / "said.json"))
    assert found.rows == 1200 and found.flights == 6
    assert 0.0 < found.errors["wake"]["all"] < 4.0
    difference = found.differences[0]
    assert [difference[k] for k in ("model", "other", "rows")] == ["composed", "wake", "all"]
    expected = found.errors["composed"]["all"] - found.errors["wake"]["all"]
    assert difference["mean"] == pytest.approx(expected)
    assert difference["low"] <= difference["mean"] <= difference["high"]
    assert json.loads((tmp_path / "said.json").read_text())["errors"] == found.errors
    assert any("composed minus wake, all rows" in line for line in found.lines())
    kept = tmp_path / "out" / "wake-0.npy"
    before = kept.stat().st_mtime_ns
    (tmp_path / "out" / "composed-1.npy").unlink()
    again = compare(comparison_of(tmp_path))
    assert again.errors == found.errors
    assert kept.stat().st_mtime_ns == before
    with pytest.raises(ValueError, match="other options: seed is 0 there, 1 here"):
        compare(comparison_of(tmp_path, seed=1))


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
        zeros = np.zeros(len(flight))
        mean, low, high = paired_difference(by_flight[flight], zeros, flight, seed=0)
        assert mean == pytest.approx(by_flight.mean())
        assert low < mean < high
        widths.append(high - low)
    assert widths[0] == pytest.approx(widths[1])
    assert widths[0] == pytest.approx(4 * by_flight.std() / np.sqrt(30), rel=0.2)
