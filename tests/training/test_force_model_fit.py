"""Fits of planted truths; the weights that ship, against measured flights and by themselves."""

from __future__ import annotations

import csv
import dataclasses
import json
import re
import shlex
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
import tyro

from docs.model_card import REPORTS, CardConfig, write_card
from swarm_envs.interactions import load
from swarm_envs.training.force_model import pipeline
from swarm_envs.training.force_model.evaluate import mean_squared_errors, scan_swarms
from swarm_envs.training.force_model.export import load_network, save_network
from swarm_envs.training.force_model.force_fit_config import FitConfig
from swarm_envs.training.force_model.labels import fit_drag
from swarm_envs.training.force_model.lipschitz import steepest
from swarm_envs.training.force_model.network import OUTER_FADE, DeepSetSpec, InputRange
from swarm_envs.training.force_model.pipeline import fit
from swarm_envs.training.force_model.train import predict, to_batch, train
from swarm_envs.training.force_model.wake import LIMITS, Wake
from swarm_envs.training.interaction_rows import read_rows, save_rows
from swarm_envs.training.interaction_rows.calibration import (
    estimate_offsets,
    quiet_rows,
    subtract_offsets,
)
from swarm_envs.training.interaction_rows.modelled import modelled_force_g
from swarm_envs.vehicles import GRAM_FORCE
from tests.helpers.tiny_fits import make_rows
from tests.helpers.torch_swarms import swarm_force_g

TRUTH: dict[str, Any] = {
    "amplitude_g": np.array([[15.0, 12.0], [20.0, 25.0]]),
    "width_m": np.array([[0.06, 0.08], [0.05, 0.07]]),
    "spread": np.array([[0.05, 0.04], [0.03, 0.06]]),
    "decay": np.array([[1.5, 1.0], [2.0, 1.2]]),
    "advection_speed": np.array([4.0, 6.0]),
    "ground_g": np.array([3.0, 8.0]),
    "ground_height_m": np.array([0.03, 0.05]),
    "combine_q": 1.4,
    "mitigation": 0.5,
    "mitigation_height_m": 0.2,
}
OFFSETS = {50: -1.0, 51: -0.4, 101: 2.1}
FLIGHT_DRIFT = (0.0, 0.6, -0.5)
DRAG = np.array([[0.015, 0.015, 0.008], [0.04, 0.04, 0.02]])


def planted_rows(count, seed=0):
    """Rows of the planted wake, free of offset and drag, with up to two neighbours."""
    rng = np.random.default_rng(seed)
    vehicle = rng.choice([50, 51, 101], count)
    neighbor = rng.uniform(-1, 1, (count, 2, 6)) * [0.3, 0.3, 1.0, 0.5, 0.5, 0.5]
    neighbor[: count // 2, :, :2] = rng.normal(0, 0.06, (count // 2, 2, 2))
    kind = rng.integers(-1, 2, (count, 2))
    neighbor[kind < 0] = 0.0
    position = rng.uniform(0, 1, (count, 3))
    low, high = (rng.uniform(*span, count) for span in ((0.07, 0.3), (0.3, 1.5)))
    position[:, 2] = np.where(rng.random(count) < 0.4, low, high)
    rows = make_rows(
        count,
        ego_type=(vehicle > 100).astype(np.int64),
        position=position,
        velocity=rng.uniform(-0.4, 0.4, (count, 3)),
        neighbor=neighbor,
        neighbor_type=kind,
        flight=rng.integers(0, 3, count),
        vehicle=vehicle,
        scenario=(kind >= 0).sum(axis=1),
        validation=np.arange(count) // 50 % 5 == 0,
        scenario_names=("alone", "pair", "three"),
    )
    return rows.with_vertical_force(predict(planted_wake(), to_batch(rows, torch.float64)).numpy())


def planted_wake():
    """The closed form with the parameters `TRUTH`."""
    wake = Wake(dataclasses.replace(SPEC, anchor_height_m=None, kind="wake"), torch.float64)
    for name, (_, _, low, high) in LIMITS.items():
        place = (np.ravel(TRUTH[name]) - low) / (high - low)
        wake.raw[name].data = torch.logit(torch.from_numpy(place))
    return wake


def with_calibration_and_drag(rows, rng):
    offset = np.array([OFFSETS[v] for v in rows.vehicle]) + np.array(FLIGHT_DRIFT)[rows.flight]
    force = rows.force_g - DRAG[rows.ego_type] * rows.velocity / GRAM_FORCE
    force[:, :2] += [1.3, -0.4]  # attitude calibration
    force[:, 2] += offset + rng.normal(0, 0.3, len(rows))
    return dataclasses.replace(rows, force_g=force)


SPEC = DeepSetSpec(("S", "L"), OUTER_FADE, None, 0.6)


def test_planted_offsets_are_recovered():
    rows = with_calibration_and_drag(planted_rows(30_000), np.random.default_rng(1))
    found = estimate_offsets(rows)
    for vehicle, planted in OFFSETS.items():
        assert found.vehicle[vehicle] == pytest.approx(planted, abs=0.25)
        for flight, drift in enumerate(FLIGHT_DRIFT):
            assert found.flight[vehicle, flight] == pytest.approx(planted + drift, abs=0.25)
    quiet = quiet_rows(rows)
    assert np.abs(np.median(subtract_offsets(rows, found).force_g[quiet, 2])) < 0.05


def test_planted_drag_is_recovered_and_never_negative():
    rows = with_calibration_and_drag(planted_rows(30_000), np.random.default_rng(1))
    assert fit_drag(rows) == pytest.approx(DRAG, rel=0.1, abs=1e-3)
    pushed = dataclasses.replace(rows, velocity=-rows.velocity)
    assert not fit_drag(pushed).any()


def fit_options(**given):
    return FitConfig(**{"data": Path(), "out": Path(), "progress": False, **given})


def test_planted_wake_is_recovered():
    spec, config = planted_wake().spec, fit_options(steps=700, learning_rate=4e-2, batch_size=384)
    found = train(planted_rows(6_000), spec, config).network
    assert isinstance(found, Wake)
    for name, truth in TRUTH.items():
        assert found.value(name).detach().numpy() == pytest.approx(truth, rel=0.05), name


def test_the_wake_in_torch_is_the_compiled_one(tmp_path):
    rows = planted_rows(2000)
    wake, far = planted_wake(), 10.0
    limits = InputRange(((-far,) * 6, (far,) * 6), ((-far,) * 4, (far,) * 4))
    wake.spec = dataclasses.replace(wake.spec, input_range=limits)
    save_network(tmp_path / "wake.json", wake)
    model = load(tmp_path / "wake.json")
    np.testing.assert_allclose(modelled_force_g(rows, model)[:, 2], rows.force_g[:, 2], atol=1e-7)


def test_network_learns_the_planted_wake_and_keeps_its_clip():
    rows = planted_rows(12_000)
    config = fit_options(steps=300, learning_rate=1e-2, batch_size=256)
    trained = train(rows, SPEC, config)
    held_out = rows.select(rows.validation)
    error = predict(trained.network, to_batch(held_out)).numpy() - held_out.force_g[:, 2]
    assert np.mean(error**2) < 0.12 * np.mean(held_out.force_g[:, 2] ** 2)
    assert trained.history[-1]["validation"] == pytest.approx(np.mean(error**2), rel=1e-3)
    matrices = [p for p in trained.network.parameters() if p.ndim == 2]
    norms = [np.linalg.norm(m.detach().numpy(), 2) for m in matrices]
    assert max(norms) == pytest.approx(3.0, rel=1e-4)  # some matrix wanted to grow further


def test_measured_fit_is_the_papers_form(tmp_path):
    rows = with_calibration_and_drag(planted_rows(2000), np.random.default_rng(1))
    save_rows(tmp_path / "rows.npz", rows)
    report = fit(fit_options(data=tmp_path / "rows.npz", out=tmp_path, mode="measured", steps=20))
    network = load_network(tmp_path / "deep-set.safetensors")
    assert network.spec.anchor_height_m is None and network.spec.input_range is None
    assert not network.drag[:, 2].any() and not report.vehicle_offsets_g
    assert "calibration offsets are not subtracted from the labels" in report.lines()
    far = torch.tensor([[[0.0, 0.0, 1.0], [5.0, 0.0, 1.0]]], dtype=torch.float64)
    near = far * torch.tensor([0.01, 1.0, 1.0])
    still = torch.zeros_like(far)
    forces = [swarm_force_g(network, place, still, "SS")[0, 0] for place in (far, near)]
    assert forces[0] != forces[1]


def test_command_line_makes_the_same_configuration():
    config = FitConfig(data=Path("rows.npz"), out=Path("DIR"), seed=5, steps=70, torque=True)
    config = dataclasses.replace(config, logs=dataclasses.replace(config.logs, keep_every=2))
    words = shlex.split(pipeline.fit_command(config))
    assert words[:2] == ["swarm-envs", "fit"]
    assert tyro.cli(FitConfig, args=words[2:]) == config


WEIGHTS = Path(__file__).parents[2] / "swarm_envs" / "interactions" / "weights"


@pytest.fixture(scope="module", params=["learned", "deep-set"])
def name(request):
    return request.param


@pytest.fixture(scope="module")
def shipped(name):
    return load_network(WEIGHTS / f"{name}.safetensors")


@pytest.fixture(scope="module")
def report(name):
    return json.loads((WEIGHTS / f"{name}.json").read_text())


@pytest.fixture(scope="module")
def flights(shared_data):
    return read_rows(shared_data / "data" / "neural_swarm_flights_33hz.npz")


def test_validation_error_of_the_shipped_weights(name, report, flights):
    free = subtract_offsets(flights, estimate_offsets(flights))
    errors = mean_squared_errors(modelled_force_g(flights, name)[:, 2], free)
    assert errors.overall <= 7.5
    assert errors.overall == pytest.approx(report["findings"]["errors"]["overall"], abs=1e-6)
    for kind in errors.scenario:
        assert errors.scenario[kind] < 1.05 * errors.scenario_scenario_mean[kind], kind


def test_reader_gives_the_documented_rows(flights):
    assert len(flights) == 437_501
    assert np.unique(flights.flight).size == 192
    zero = np.mean(flights.force_g[flights.validation, 2] ** 2)
    assert zero == pytest.approx(22.76, abs=0.01)
    row = np.flatnonzero(flights.scenario == flights.scenario_names.index("SL2S"))[0]
    assert flights.neighbor_type[row].tolist() == [0, 1]
    assert flights.ego_type[row] == 0
    assert flights.position[:, 2].min() >= 0.07
    assert flights.has_neighbor.sum(axis=1).tolist().count(0) == 40_550 + 36_722


@pytest.mark.parametrize("distance", [0.25, 0.35])
def test_small_above_small_is_near_the_measured_bins(shipped, shared_data, distance):
    with (shared_data / "reference" / "measured_force_bins.csv").open() as file:
        bins = [row for row in csv.DictReader(file) if row["scenario"] == "S2S"]
    on_axis = [b for b in bins if b["extra"] == "lat[0,0.05)" and float(b["bin_lo"]) < distance]
    measured = float(max(on_axis, key=lambda b: float(b["bin_lo"]))["fa_delay_mean"])
    baseline = -1.0
    position = torch.zeros(5, 2, 3, dtype=torch.float64)  # across the bin: a wake falls off in it
    position[:, 1, 0] = torch.linspace(0.005, 0.045, 5)
    position[:, :, 2] = torch.tensor([1.0, 1.0 + distance])
    force = swarm_force_g(shipped, position, torch.zeros_like(position), ("S", "S"))[:, 0].detach()
    assert float(force.mean()) == pytest.approx(measured - baseline, abs=1.5)


STEEPEST = {"learned": 450, "deep-set": 1500}
"""g per m, or per unit of input. `deep-set` is trained as the paper does, without a penalty."""


def test_gradients_of_the_shipped_weights(name, shipped, report):
    for neighbors in (1, 2):
        found = steepest(shipped, neighbors, np.random.default_rng(7))
        stated = report["findings"]["lipschitz_measured"][str(neighbors)]
        for kind in ("position_gradient_g_per_m", "input_gradient_g_per_unit"):
            assert max(found[kind], stated[kind]) <= STEEPEST[name]


@pytest.mark.parametrize("drones", [2, 3, 16])
def test_random_swarms_give_no_absurd_force(name, drones):
    found = scan_swarms(load(name), drones, 500, np.random.default_rng(8))
    lowest, highest = found["small_only"]
    assert lowest > (-25 if drones <= 3 else -40) and highest < 15


def test_reports_state_no_path_of_the_machine_that_made_them():
    for name in (*(f"{report}.json" for report in REPORTS), "MODEL_CARD.md"):
        text = (WEIGHTS / name).read_text()
        assert not re.search(r'["\s]/[a-z]', text), name


def test_model_card_is_what_the_reports_say(tmp_path):
    for name in REPORTS:
        shutil.copy(WEIGHTS / f"{name}.json", tmp_path)
    written = write_card(CardConfig(weights=tmp_path)).read_text()
    assert written == (WEIGHTS / "MODEL_CARD.md").read_text() and "have no license" in written


@pytest.mark.slow
def test_measured_fit_reaches_the_reference(shared_data, tmp_path):
    data = shared_data / "data" / "neural_swarm_flights_33hz.npz"
    report = fit(fit_options(data=data, out=tmp_path, mode="measured"))
    assert report.findings.errors.overall <= 6.5
