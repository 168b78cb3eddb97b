"""What a fit leaves behind: it is not overwritten by another, and says what it cannot know."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from swarm_envs.interactions import load
from swarm_envs.training.flight_logs.log_options import LogOptions
from swarm_envs.training.flight_logs.log_report import Calibration
from swarm_envs.training.force_model.evaluate import Errors, worth
from swarm_envs.training.force_model.force_fit_config import FitConfig
from swarm_envs.training.force_model.pipeline import WEIGHTS, fit
from swarm_envs.training.interaction_rows import InteractionRows, save_rows
from swarm_envs.training.provenance import differing


def planted_rows(count, seed=0):
    """A neighbour above pushes down by at most 6 g; types are drawn."""
    rng = np.random.default_rng(seed)
    neighbor = rng.uniform(-1, 1, (count, 1, 6)) * [0.2, 0.2, 0.9, 0.5, 0.5, 0.5]
    lateral = np.sum(neighbor[:, 0, :2] ** 2, axis=1)
    force = np.zeros((count, 3))
    force[:, 2] = -6.0 * np.exp(-lateral / 0.01) * (neighbor[:, 0, 2] > 0)
    return InteractionRows(
        types=("S", "L"),
        ego_type=rng.integers(0, 2, count),
        position=rng.uniform(0.5, 1.5, (count, 3)),
        velocity=rng.uniform(-0.3, 0.3, (count, 3)),
        neighbor=neighbor,
        neighbor_type=rng.integers(0, 2, (count, 1)),
        force_g=force,
        flight=np.zeros(count, dtype=np.int64),
        step=np.arange(count) * 3,
        vehicle=np.full(count, 50),
        scenario=np.zeros(count, dtype=np.int64),
        validation=np.arange(count) // 50 % 5 == 0,
        scenario_names=("pair",),
    )


def config_of(rows, folder, **options):
    save_rows(folder / "rows.npz", rows)
    usual = {"steps": 5, "offsets": "none", "lipschitz_samples": 0, "progress": False}
    return FitConfig(data=folder / "rows.npz", out=folder / "out", **{**usual, **options})


def test_a_finished_fit_of_other_options_or_data_is_not_overwritten(tmp_path):
    config = config_of(planted_rows(800), tmp_path)
    fit(config)
    path = config.out / "learned.safetensors"
    made = path.read_bytes()
    fit(replace(config, json=tmp_path / "said.json"))
    assert path.read_bytes() == made
    said = r"seed is 0 there, 1 here; logs.guard_s is 0.5 there, 0.6 here; choose another folder"
    with pytest.raises(ValueError, match=said):
        fit(replace(config, seed=1, logs=LogOptions(guard_s=0.6)))
    save_rows(tmp_path / "rows.npz", planted_rows(800, seed=1))
    with pytest.raises(ValueError, match=r"options: data_sha256 is \w{64} there, \w{64} here; c"):
        fit(config)
    (config.out / "learned.json").write_text("[]")
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


@pytest.mark.parametrize("model", ["deep-set", "pairwise", "wake"])
def test_of_a_pair_of_types_that_never_met_nothing_is_invented(model, tmp_path):
    rows = planted_rows(1500)
    met = (rows.neighbor_type[:, 0] == 0) | (rows.ego_type == 1)  # L is never over S
    report = fit(config_of(rows.select(met), tmp_path, model=model, steps=20))
    (note,) = [n for n in report.notes if "in no training row" in n]
    assert note.startswith("type 'L' is a neighbour of type 'S' in no training row: ")
    found = load(str(tmp_path / "out" / WEIGHTS[model]))
    stack, still = [[[0.0, 0.0, 0.8], [0.0, 0.0, 1.2]]], np.zeros((1, 2, 3))
    assert found.forces(stack, still, "SS")[0, 0, 2] != 0.0
    pushed = found.forces(stack, still, "SL")[0, 0, 2]
    if model == "deep-set":
        assert pushed != 0.0 and "guessed" in note
    else:
        assert abs(pushed) < 1e-12 and "does not push" in note


def test_the_ground_under_a_type_that_never_flew_is_not_invented(tmp_path):
    rows = planted_rows(1000)
    fit(config_of(rows.select(rows.ego_type == 0), tmp_path, model="wake"))
    found = load(str(tmp_path / "out" / "wake.json"))
    assert found.forces([[[0.0, 0.0, 0.08]]], np.zeros((1, 1, 3)), "L")[0, 0, 2] == 0.0


def test_a_model_that_is_no_better_than_nothing_says_so(tmp_path):
    rows = planted_rows(1500)
    noise = rows.with_vertical_force(np.random.default_rng(1).normal(0, 1, 1500))
    report = fit(config_of(noise, tmp_path, model="wake"))
    (note,) = report.notes
    assert note.startswith("the model explains nothing: its validation MSE ")
    assert f"note: {note}" in report.lines()
    good = Errors(1.0, 3.0, 2.0, {}, {}, {})
    assert worth(good) == []
    assert "that of the scenario mean (2.00); fly more" in worth(replace(good, overall=2.0))[0]
    assert "nothing (3.00) nor that of" in worth(replace(good, overall=4.0))[0]


def test_a_measured_fit_says_that_offsets_stay_in(tmp_path):
    report = fit(config_of(planted_rows(800), tmp_path, mode="measured", offsets="estimated"))
    calibration = Calibration(50, "S", 9, 9, 0.1, 0.1)
    logs = replace(report.logs, vehicles={"S1": calibration})
    said = "calibration offsets are not subtracted: labels are fitted as measured"
    assert said in replace(report, logs=logs).lines()
    assert said not in replace(report, logs=logs, offset_rule="median").lines()
