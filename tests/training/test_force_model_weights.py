"""The weights that ship, against the measured flights (skipped without them) and by themselves."""

from __future__ import annotations

import csv
import json
import re
import shutil
from pathlib import Path

import numpy as np
import pytest
import torch

from docs.model_card import REPORTS, CardConfig, write_card
from swarm_envs.training.force_model.evaluate import mean_squared_errors, predict_rows, scan_swarms
from swarm_envs.training.force_model.export import load_network
from swarm_envs.training.force_model.force_fit_config import FitConfig
from swarm_envs.training.force_model.lipschitz import lipschitz_bound, measure_lipschitz
from swarm_envs.training.force_model.pipeline import fit
from swarm_envs.training.interaction_rows import read_rows
from swarm_envs.training.interaction_rows.calibration import estimate_offsets, subtract_offsets

WEIGHTS = Path(__file__).parents[2] / "swarm_envs" / "interactions" / "weights"


@pytest.fixture(scope="module", params=["learned", "deep-set", "learned-v0"])
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


def test_validation_error_of_the_shipped_weights(shipped, report, flights):
    free = subtract_offsets(flights, estimate_offsets(flights))
    errors = mean_squared_errors(predict_rows(shipped, flights), free)
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
    force = shipped.force_g(position, torch.zeros_like(position), ("S", "S"))[:, 0].detach()
    assert float(force.mean()) == pytest.approx(measured - baseline, abs=1.5)


STEEPEST = {"learned": 450, "deep-set": 1500, "learned-v0": 400}
"""g per m, or per unit of input. `deep-set` is trained as the paper does, without a penalty."""


def test_lipschitz_constant_of_the_shipped_weights(name, shipped, report):
    bound, most = lipschitz_bound(shipped), STEEPEST[name]
    for neighbors in (1, 2):
        found = measure_lipschitz(shipped, 20_000, neighbors, np.random.default_rng(7))
        assert found["position_gradient_g_per_m"] <= most
        assert found["input_gradient_g_per_unit"] <= most
        stated = report["findings"]["lipschitz_measured"][str(neighbors)]
        assert stated["position_gradient_g_per_m"] <= most
        assert stated["input_gradient_g_per_unit"] <= most
    stated_bound = report["findings"]["lipschitz_bound"]["position_g_per_m"]
    assert stated_bound == pytest.approx(bound["position_g_per_m"])


@pytest.mark.parametrize("drones", [2, 3, 16])
def test_random_swarms_give_no_absurd_force(shipped, drones):
    found = scan_swarms(shipped, drones, 500, np.random.default_rng(8))
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
    assert written == (WEIGHTS / "MODEL_CARD.md").read_text()
    assert "have no license" in written


@pytest.mark.slow
def test_measured_fit_reaches_the_reference(shared_data, tmp_path):
    config = FitConfig(
        data=shared_data / "data" / "neural_swarm_flights_33hz.npz",
        out=tmp_path,
        mode="measured",
        lipschitz_samples=0,
        progress=False,
    )
    assert fit(config).findings.errors.overall <= 6.2
