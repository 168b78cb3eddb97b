"""What a fit leaves behind: not overwritten by another, honest about types it does not know."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from swarm_envs.interactions import load
from swarm_envs.training.flight_logs.log_options import LogOptions
from swarm_envs.training.flight_logs.log_report import Calibration
from swarm_envs.training.force_model.evaluate import Errors, worth
from swarm_envs.training.force_model.force_fit_config import FitConfig
from swarm_envs.training.force_model.pipeline import WEIGHTS, fit
from swarm_envs.training.interaction_rows import save_rows
from swarm_envs.training.provenance import differing
from swarm_envs.vehicles import LARGE, SMALL, SMALL_STRONG
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
    usual = {"steps": 5, "offsets": "none", "lipschitz_samples": 0, "progress": False}
    return FitConfig(data=folder / "rows.npz", out=folder / "out", **{**usual, **options})


def test_a_finished_fit_of_other_options_or_data_is_not_overwritten(tmp_path):
    config = config_of(rows_of_types(count=800), tmp_path)
    fit(config)
    path = config.out / "learned.safetensors"
    made = path.read_bytes()
    fit(replace(config, json=tmp_path / "said.json"))
    assert path.read_bytes() == made
    said = r"seed is 0 there, 1 here; logs.guard_s is 0.5 there, 0.6 here; choose another folder"
    with pytest.raises(ValueError, match=said):
        fit(replace(config, seed=1, logs=LogOptions(guard_s=0.6)))
    save_rows(tmp_path / "rows.npz", rows_of_types(count=800, seed=1))
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


@pytest.mark.parametrize("model", ["deep-set", "pairwise", "composed", "wake"])
def test_of_a_pair_of_types_that_never_met_nothing_is_invented(model, tmp_path):
    rows = rows_of_types()
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
    rows = rows_of_types(count=1000)
    fit(config_of(rows.select(rows.ego_type == 0), tmp_path, model="wake"))
    found = load(str(tmp_path / "out" / "wake.json"))
    assert found.forces([[[0.0, 0.0, 0.08]]], np.zeros((1, 1, 3)), "L")[0, 0, 2] == 0.0


def test_a_model_that_is_no_better_than_nothing_says_so(tmp_path):
    rows = rows_of_types()
    noise = rows.with_vertical_force(np.random.default_rng(4).normal(0, 1, 1500))
    report = fit(config_of(noise, tmp_path, model="wake"))
    (note,) = report.notes
    assert note.startswith("the model explains nothing: its validation MSE ")
    assert f"note: {note}" in report.lines()
    good = Errors(1.0, 3.0, 2.0, {}, {}, {})
    assert worth(good) == []
    assert "that of the scenario mean (2.00); fly more" in worth(replace(good, overall=2.0))[0]
    assert "nothing (3.00) nor that of" in worth(replace(good, overall=4.0))[0]


def test_a_measured_fit_says_that_offsets_stay_in(tmp_path):
    report = fit(
        config_of(rows_of_types(count=800), tmp_path, mode="measured", offsets="estimated")
    )
    calibration = Calibration(50, "S", 9, 9, 0.1)
    logs = replace(report.logs, vehicles={"S1": calibration})
    said = "calibration offsets are not subtracted: labels are fitted as measured"
    assert said in replace(report, logs=logs).lines()
    assert said not in replace(report, logs=logs, offset_rule="median").lines()


STRONG = replace(SMALL_STRONG, interaction_type="S*")
HUGE = replace(LARGE, interaction_type="XL")
QUICK = {"steps": 20, "learning_rate": 1e-2, "batch_size": 128}


@pytest.mark.parametrize("model", ["deep-set", "pairwise", "composed"])
def test_three_types_one_of_them_invented_are_fitted_and_fly(model, tmp_path):
    rows = rows_of_types(("S", "S*", "XL"))
    steps = 500 if model == "composed" else 250  # it begins with a wake of 20 g, narrow and steep
    report = fit(config_of(rows, tmp_path, model=model, **QUICK | {"steps": steps}))
    assert report.notes == []
    assert report.findings.errors.overall < 0.6 * report.findings.errors.zero
    found = load(str(tmp_path / "out" / WEIGHTS[model]))
    assert found.types == ("S", "S*", "XL")
    position = [[[0.0, 0.0, 0.8], [0.0, 0.0, 1.1]]]
    force = [
        found.forces(position, np.zeros((1, 2, 3)), (STRONG, upper))[0, 0, 2]
        for upper in (SMALL, HUGE)
    ]
    assert force[1] < force[0] < 0.0
    with pytest.raises(ValueError, match="unknown interaction type 'L'"):
        found.forces(position, np.zeros((1, 2, 3)), "SL")


@pytest.mark.parametrize("model", ["deep-set", "pairwise", "composed"])
@pytest.mark.parametrize(
    ("shown", "said", "felt"),
    [("neighbor_type", "'L' is a neighbour", "LS"), ("ego_type", "'L' is the drone of no", "SL")],
)
def test_a_type_that_never_pushed_or_never_felt_goes_on_so(model, shown, said, felt, tmp_path):
    rows = rows_of_types()
    small = getattr(rows, shown).reshape(len(rows), -1)[:, 0] == 0
    report = fit(config_of(rows.select(small), tmp_path, model=model, **QUICK))
    notes = [note for note in report.notes if "explains nothing" not in note]
    assert notes and all(said in note for note in notes)
    assert report.notes[0] in "\n".join(report.lines())
    found = load(str(tmp_path / "out" / WEIGHTS[model]))
    assert found.notes["notes"] == notes
    position, still = np.array([[[0.0, 0.0, 0.8], [0.0, 0.0, 1.1]]]), np.zeros((1, 2, 3))
    assert found.forces(position, still, "LL")[0, 0, 2] == 0.0
    assert found.forces(position, still, felt)[0, 0, 2] != 0.0


def test_a_fitted_wake_is_read_back_and_a_damaged_one_is_refused(tmp_path):
    report = fit(config_of(rows_of_types(), tmp_path, model="wake", **QUICK))
    path = tmp_path / "out" / "wake.json"
    found = load(path)
    assert found.types == ("S", "L")
    errors = report.findings.errors
    assert errors.overall < 0.5 * errors.zero
    position = [[[0.0, 0.0, 0.8], [0.02, 0.0, 1.1]]]
    force = found.forces(position, np.zeros((1, 2, 3)), "SL")[0, 0, 2]
    assert force / 0.00980665 == pytest.approx(-4.0, abs=0.8)
    content = json.loads(path.read_text())
    for change, reason in (
        ({"format": "wake-0"}, "its format is another"),
        ({"advection_velocity": "relative"}, "only 'neighbor'"),
        ({"pair": {}}, "'S>S'"),
        ({"combine_q": "two"}, "could not convert"),
    ):
        path.write_text(json.dumps(content | change))
        with pytest.raises(ValueError, match=f"damaged or not a 'wake-1' file .*{reason}"):
            load(path)
    path.write_text("{")
    with pytest.raises(ValueError, match="fit it again by `swarm-envs fit --model wake`"):
        load(path)
    with pytest.raises(FileNotFoundError, match="does not exist"):
        load(tmp_path / "no.json")
