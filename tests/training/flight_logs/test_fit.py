"""Logs through the whole chain, and the folders that `fit` reads."""

from __future__ import annotations

import json

import numpy as np
import pytest

from swarm_envs.cli import main
from swarm_envs.interactions import load
from swarm_envs.training.collection import CollectionConfig, collect, interaction_rows
from swarm_envs.training.flight_logs.read import data_sha256, read_data
from swarm_envs.training.force_model.force_fit_config import REPORTS, WEIGHTS
from swarm_envs.training.interaction_rows import save_rows
from tests.helpers.real_logs import write_table

QUICK = ("--steps", "30", "--batch-size", "64")


@pytest.fixture(scope="module")
def logs(flown, as_table, tmp_path_factory):
    """A folder of three flights; one small drone weighs 2 g less than its type."""
    folder = tmp_path_factory.mktemp("logs")
    for team, mass_g in (("S", -2.0), ("L", 1.5), ("SL", 0.0)):
        names = [f"cf-{letter}{mass_g:g}" for letter in team]
        table = as_table(flown(team, "walk", 25.0, mass_g), team, names)
        write_table(folder / f"{team}.csv", table)
    return folder


def test_flights_of_lone_drones_give_their_offsets_and_no_pairs_to_report(logs, tmp_path, capsys):
    alone = tmp_path / "alone"
    alone.mkdir()
    for name in ("S.csv", "L.csv"):
        (alone / name).write_bytes((logs / name).read_bytes())
    assert main(["fit", "--data", str(alone), "--out", str(tmp_path / "fit"), *QUICK]) == 0
    report = json.loads((tmp_path / "fit" / "deep-set.json").read_text())
    assert report["findings"]["rows"] > 100 and report["findings"]["axis_bins"] == []
    # m a / g - T: of a drone lighter than its type, the offset is positive.
    offsets = report["vehicle_offsets_g"]
    assert offsets == pytest.approx({"cf-S-2": 2.0, "cf-L1.5": -1.5}, abs=0.1)
    assert "vehicle cf-S-2: offset +" in capsys.readouterr().out


def test_logs_that_cannot_be_fitted_are_explained_without_traceback(logs, tmp_path, capsys):
    text = (logs / "S.csv").read_text()
    (tmp_path / "bad.csv").write_text(text.replace("voltage", "volts"))
    out = tmp_path / "out"
    assert main(["fit", "--data", str(tmp_path / "bad.csv"), "--out", str(out), *QUICK]) == 1
    said = capsys.readouterr().err
    assert "swarm-envs fit: error: bad.csv: column 'voltage' is missing; there are " in said
    assert not (out / "deep-set.json").exists()


def test_a_folder_that_collect_wrote_is_read(tmp_path):
    config = CollectionConfig(teams=("S", "SL"), walks=2, low_walks=0, swaps=0, duration_s=3.0)
    flights = collect(config, tmp_path, progress=False)
    said = r"no rows\.npz, because the collection is incomplete"
    with pytest.raises(FileNotFoundError, match=said):
        read_data(tmp_path)
    table = interaction_rows(flights)
    save_rows(tmp_path / "rows.npz", table)
    rows, report = read_data(tmp_path)
    assert np.array_equal(rows.force_g, table.force_g)
    assert [file.file for file in report] == ["rows.npz"]


def test_the_fingerprint_of_a_folder_depends_on_every_file(tmp_path):
    (tmp_path / "a.csv").write_text("1")
    before = data_sha256(tmp_path)
    assert data_sha256(tmp_path) == before
    (tmp_path / "b.csv").write_text("2")
    after = data_sha256(tmp_path)
    (tmp_path / "b.csv").rename(tmp_path / "c.csv")
    assert len({before, after, data_sha256(tmp_path)}) == 3


@pytest.mark.parametrize("model", ["deep-set", "composed", "wake"])
def test_the_command_fits_every_model_to_a_folder_of_logs(model, logs, tmp_path, capsys):
    out, copy = tmp_path / "out", tmp_path / "copy.json"
    command = ["fit", "--data", str(logs), "--out", str(out), "--json", str(copy), *QUICK]
    options = ["--offsets", "none", "--model", model, "--logs.keep-every", "2"]
    assert main([*command, *options]) == 0
    said = capsys.readouterr().out
    assert "S.csv: " in said and f"{model}: validation MSE" in said
    assert f"fly it: swarm-envs fly --interactions {out / WEIGHTS[model]}" in said
    report = json.loads(copy.read_text())
    assert [file["file"] for file in report["logs"]] == ["L.csv", "S.csv", "SL.csv"]
    assert report["findings"]["rows"] > 1000
    assert report["command"].endswith("--logs.keep-every 2")
    assert report["data_sha256"] == data_sha256(logs)
    assert report == json.loads((out / REPORTS[model]).read_text())
    assert report["model"] == model
    assert set(report["findings"]) >= {"errors", "axis_bins"}
    assert (report["findings"]["lipschitz_measured"] == {}) == (model == "wake")
    found = load(str(out / WEIGHTS[model]))
    force = found.forces([[[0.0, 0.0, 0.8], [0.0, 0.0, 1.1]]], np.zeros((1, 2, 3)), "SL")
    assert np.isfinite(force).all() and force[0, 0, 2] != 0.0
