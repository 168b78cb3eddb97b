"""Table III: what its cells change in a fit, and a table that is kept, resumed and compared."""

from __future__ import annotations

import csv
import dataclasses
import json
from types import SimpleNamespace

import numpy as np
import pytest

from swarm_envs.training.force_model import pipeline
from swarm_envs.training.force_model.network import DeepSet, DeepSetSpec, layers
from swarm_envs.training.interaction_rows import read_rows, save_rows
from swarm_envs.training.reproduce import ablation
from swarm_envs.training.reproduce.ablation import ABLATIONS, TABLE_3, ablation_fit
from swarm_envs.training.reproduce.study import run_study
from tests.helpers.interrupts import calls_of
from tests.helpers.tiny_fits import rows_of

SOME = ("H=10", "no-spectral-norm")


@pytest.fixture(autouse=True)
def small_batches(monkeypatch):
    monkeypatch.setattr(ablation, "_RECIPE", {**ablation._RECIPE, "batch_size": 64})


def asked(rows, out, cells=tuple(ABLATIONS), seed=0, seeds=1, steps=8):
    """Options of the command."""
    return SimpleNamespace(
        out=out, json=None, data=rows, cells=cells, seed=seed, seeds=seeds, steps=steps
    )


def run_table(options):
    """Fit what is not there yet, write the table, and give it."""
    return run_study(TABLE_3, options, progress=False)[0]


@pytest.fixture(scope="module")
def rows(tmp_path_factory):
    """Rows in which the force is -20 g m/s times the neighbour's speed in x."""
    rows = rows_of(600, flights=1)
    rows = rows.with_vertical_force(-20.0 * np.abs(rows.neighbor[:, 0, 3]))
    path = tmp_path_factory.mktemp("rows") / "rows.npz"
    save_rows(path, rows)
    return path


@pytest.mark.parametrize(
    ("name", "phi", "rho"),
    [
        ("H=10", [25, 40, 40, 10], [40, 40, 40, 1]),
        ("L=5", [25, 40, 40, 40, 20], [40, 40, 40, 40, 1]),
    ],
)
def test_sizes_are_those_of_the_paper(name, phi, rho):
    network = DeepSet(DeepSetSpec(("S", "L"), **ABLATIONS[name].changes))
    for module in (*network.phi.values(), network.phi_environment):
        assert [layer.out_features for layer in layers(module)] == phi
    for module in network.rho.values():
        assert [layer.out_features for layer in layers(module)] == rho
        assert layers(module)[0].in_features == phi[-1]
    with pytest.raises(ValueError, match="must be an integer of at least 2"):
        DeepSetSpec(("S",), layers=1)


def test_velocity_counts_where_the_force_depends_on_it(rows, tmp_path, monkeypatch):
    monkeypatch.setitem(ablation._RECIPE, "learning_rate", 1e-2)
    cells = ("H=20,L=4", "no-relative-velocity")
    table = run_table(asked(rows, tmp_path, cells, steps=400))
    seen, blind = (row["ours_g2"] / table["scenario_mean_g2"] for row in table["rows"])
    assert seen < 0.7  # of the labels' variance, which the blind one cannot explain
    assert blind > 0.95


def test_an_interrupted_table_goes_on(rows, tmp_path, monkeypatch):
    options = asked(rows, tmp_path, SOME, seed=4, seeds=2)
    with calls_of(pipeline, "fit", killed_at=4), pytest.raises(KeyboardInterrupt):
        run_table(options)
    partial = json.loads((tmp_path / "table_3.json").read_text())
    assert (partial["runs_done"], partial["runs_wanted"]) == (3, 4)
    table = run_table(options)
    assert json.loads((tmp_path / "table_3.json").read_text()) == table
    monkeypatch.setattr(pipeline, "fit", None)  # nothing is left to be fitted
    assert run_table(options) == table
    for cell, row in zip(SOME, table["rows"], strict=True):
        runs = [ablation_fit(options, cell, seed).out / "learned.json" for seed in (4, 5)]
        errors = [json.loads(p.read_text())["findings"]["errors"]["overall"] for p in runs]
        assert row["ours_g2"] == pytest.approx(sum(errors) / 2, abs=1e-4)
        assert row["ours_deviation_g2"] == pytest.approx(
            abs(errors[0] - errors[1]) / 2**0.5, abs=1e-4
        )
    with (tmp_path / "table_3.csv").open(newline="") as file:
        lines = list(csv.DictReader(file))
    assert [line["paper_g2"] for line in lines] == ["6.7", ""]
    assert [float(line["ours_g2"]) for line in lines] == [row["ours_g2"] for row in table["rows"]]


def test_runs_of_other_settings_are_refused(rows, tmp_path):
    run_table(asked(rows, tmp_path, SOME[:1]))
    with pytest.raises(ValueError, match="steps is 8 there, 9 here; choose another folder"):
        run_table(asked(rows, tmp_path, SOME[:1], steps=9))
    with pytest.raises(FileNotFoundError, match="give its path by --data"):
        run_table(asked(tmp_path / "no.npz", tmp_path))


def test_a_sum_over_pairs_stands_beside_the_deep_set_by_scenario(rows, tmp_path):
    one = read_rows(rows)
    second = np.concatenate([one.neighbor, one.neighbor[::-1]], axis=1)
    force = one.force_g.copy()
    force[:, 2] = -20.0 * np.abs(second[..., 3]).max(axis=1)  # the stronger of two, no sum
    joint = dataclasses.replace(
        one, neighbor=second, neighbor_type=np.repeat(one.neighbor_type, 2, axis=1),
        force_g=force, scenario_names=("SS2S", "LL2L"), flight=one.flight + 1,
    )  # fmt: skip
    folder = tmp_path / "rows"
    save_rows(folder / "three.npz", joint)
    save_rows(folder / "two.npz", dataclasses.replace(one, scenario_names=("S2S", "L2L")))
    options = asked(folder, tmp_path, ("H=20,L=4", "pairwise"))
    table = run_table(options)
    deep, pairs = table["rows"]
    for row in (deep, pairs):
        errors = row["scenarios_g2"]
        assert set(errors) == {"S2S", "L2L", "SS2S", "LL2L"}
        mean = (errors["SS2S"] + errors["LL2L"]) / 2
        assert row["three_drones_g2"] == pytest.approx(mean, abs=1e-3)
    assert (ablation_fit(options, "pairwise", 0).out / "pairwise.safetensors").is_file()
