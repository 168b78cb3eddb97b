"""Fits of planted truths: network, wake, offsets and drag; resuming; files of rows."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest
import torch

from swarm_envs.training.force_model import pipeline
from swarm_envs.training.force_model.export import load_network
from swarm_envs.training.force_model.force_fit_config import FitConfig
from swarm_envs.training.force_model.labels import fit_drag, measured_range
from swarm_envs.training.force_model.network import OUTER_FADE, DeepSetSpec
from swarm_envs.training.force_model.pipeline import fit
from swarm_envs.training.force_model.train import TrainConfig, predict, to_batch, train
from swarm_envs.training.force_model.wake_fit import (
    WakeFitConfig,
    WakeParameters,
    fit_wake,
    wake_force_g,
    wake_rows,
    write_wake,
)
from swarm_envs.training.interaction_rows import save_rows
from swarm_envs.training.interaction_rows.calibration import (
    estimate_offsets,
    quiet_rows,
    subtract_offsets,
)
from swarm_envs.vehicles import GRAM_FORCE
from tests.helpers.tiny_fits import make_rows

TRUTH = WakeParameters(
    amplitude_g=np.array([[15.0, 12.0], [20.0, 25.0]]),
    width_m=np.array([[0.06, 0.08], [0.05, 0.07]]),
    spread=np.array([[0.05, 0.04], [0.03, 0.06]]),
    decay=np.array([[1.5, 1.0], [2.0, 1.2]]),
    advection_speed=np.array([4.0, 6.0]),
    ground_g=np.array([3.0, 8.0]),
    ground_height_m=np.array([0.03, 0.05]),
    combine_q=1.4,
    mitigation=0.5,
    mitigation_height_m=0.2,
)
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
    position[:, 2] = np.where(
        rng.random(count) < 0.4, rng.uniform(0.07, 0.3, count), rng.uniform(0.3, 1.5, count)
    )
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
    return rows.with_vertical_force(wake_force_g(TRUTH, wake_rows(rows, "neighbor")))


def with_calibration_and_drag(rows, rng):
    offset = np.array([OFFSETS[v] for v in rows.vehicle]) + np.array(FLIGHT_DRIFT)[rows.flight]
    force = rows.force_g - DRAG[rows.ego_type] * rows.velocity / GRAM_FORCE
    force[:, :2] += [1.3, -0.4]  # attitude calibration
    force[:, 2] += offset + rng.normal(0, 0.3, len(rows))
    return dataclasses.replace(rows, force_g=force)


SMALL = TrainConfig(steps=60, batch_size=64, slope_inputs=16, checkpoint_every=20)
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


def test_vehicle_without_quiet_rows_is_refused():
    rows = planted_rows(300)
    low = dataclasses.replace(rows, position=rows.position * [1, 1, 0.1])
    with pytest.raises(ValueError, match="vehicle 50 has no training row aloft"):
        estimate_offsets(low)


def test_planted_drag_is_recovered_and_never_negative():
    rows = with_calibration_and_drag(planted_rows(30_000), np.random.default_rng(1))
    assert fit_drag(rows) == pytest.approx(DRAG, rel=0.1, abs=1e-3)
    pushed = dataclasses.replace(rows, velocity=-rows.velocity)
    assert not fit_drag(pushed).any()


def test_planted_wake_is_recovered():
    rows = planted_rows(12_000)
    found = fit_wake(rows, "neighbor")
    for name, truth in TRUTH._asdict().items():
        assert getattr(found, name) == pytest.approx(truth, rel=0.05), name
    other = fit_wake(rows.select(np.arange(0, 12_000, 4)), "relative")
    residual = wake_force_g(other, wake_rows(rows, "relative")) - rows.force_g[:, 2]
    assert np.mean(residual**2) > 0.01  # the wrong velocity does not explain the rows


def test_network_learns_the_planted_wake_and_keeps_its_clip():
    rows = planted_rows(12_000)
    config = TrainConfig(steps=700, batch_size=512, slope_limit=None, position_jitter_m=0.0)
    trained = train(rows, SPEC, config, progress=False)
    held_out = rows.select(rows.validation)
    error = predict(trained.network, to_batch(held_out)).numpy() - held_out.force_g[:, 2]
    assert np.mean(error**2) < 0.12 * np.mean(held_out.force_g[:, 2] ** 2)
    assert trained.history[-1]["validation"] == pytest.approx(np.mean(error**2), rel=1e-3)
    matrices = [p for p in trained.network.parameters() if p.ndim == 2]
    norms = [np.linalg.norm(m.detach().numpy(), 2) for m in matrices]
    assert max(norms) == pytest.approx(3.0, rel=1e-4)  # some matrix wanted to grow further


def test_slope_penalty_lowers_the_steepest_slope():
    rows = planted_rows(3000)
    free = dataclasses.replace(SMALL, steps=150, learning_rate=1e-2, slope_limit=None)
    held = dataclasses.replace(free, slope_limit=5.0, slope_weight=10.0, slope_inputs=64)
    spec = dataclasses.replace(SPEC, input_range=measured_range(rows))
    from swarm_envs.training.force_model.lipschitz import measure_lipschitz

    def steepest(config):
        network = train(rows, spec, config, progress=False).network.double()
        return measure_lipschitz(network, 2000, 1, np.random.default_rng(0))

    free_found, held_found = steepest(free), steepest(held)
    assert held_found["input_gradient_g_per_unit"] < 0.7 * free_found["input_gradient_g_per_unit"]


def test_measured_fit_is_the_papers_form(tmp_path):
    rows = with_calibration_and_drag(planted_rows(2000), np.random.default_rng(1))
    save_rows(tmp_path / "rows.npz", rows)
    out = tmp_path / "out"
    config = FitConfig(data=tmp_path / "rows.npz", out=out, mode="measured", steps=20,
                       lipschitz_samples=0, progress=False)  # fmt: skip
    report = fit(config)
    network = load_network(out / "learned.safetensors")
    assert network.spec.anchor_height_m is None
    assert network.spec.input_range is None
    assert not network.drag[:, 2].any()
    assert report.findings.errors == report.findings.errors_raw
    far = torch.tensor([[[0.0, 0.0, 1.0], [5.0, 0.0, 1.0]]], dtype=torch.float64)
    near = far * torch.tensor([0.01, 1.0, 1.0])
    still = torch.zeros_like(far)
    assert network.force_g(far, still, "SS")[0, 0] != network.force_g(near, still, "SS")[0, 0]


def test_command_line_makes_the_same_configuration():
    import shlex

    import tyro

    config = FitConfig(data=Path("rows.npz"), out=Path("DIR"), seed=5, steps=70)
    words = shlex.split(pipeline.fit_command(config))
    assert words[:3] == ["python", "-m", "swarm_envs.training.force_model"]
    assert tyro.cli(FitConfig, args=words[3:]) == config


def test_wake_fit_writes_its_file(tmp_path):
    rows = with_calibration_and_drag(planted_rows(4000), np.random.default_rng(1))
    save_rows(tmp_path / "rows.npz", rows)
    write_wake(WakeFitConfig(data=tmp_path / "rows.npz", out=tmp_path, rows=2000))
    written = json.loads((tmp_path / "wake.json").read_text())
    assert written["advection_velocity"] == "neighbor"
    assert set(written["pair"]) == {"S>S", "S>L", "L>S", "L>L"}
    assert written["pair"]["L>S"]["A_g"] == pytest.approx(20.0, rel=0.2)
