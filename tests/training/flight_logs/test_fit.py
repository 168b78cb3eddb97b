"""Logs through the whole chain: the command that fits them."""

from __future__ import annotations

import json

import numpy as np
import pytest

from swarm_envs.cli import main
from swarm_envs.training.collection import CollectionConfig, collect, interaction_rows
from swarm_envs.training.flight_logs import read_logs, write_table
from swarm_envs.training.flight_logs.__main__ import check_logs as look
from swarm_envs.training.flight_logs.fit_data import data_sha256
from swarm_envs.training.interaction_rows import read_rows

QUICK = ("--steps", "40", "--batch-size", "64", "--slope-inputs", "16", "--lipschitz-samples", "0")


@pytest.fixture(scope="module")
def logs(flown, as_table, tmp_path_factory):
    """A folder of three sound flights and a bad one; the small drone weighs 2 g less."""
    folder = tmp_path_factory.mktemp("logs")
    for team, mass_g in (("S", -2.0), ("L", 0.0), ("SL", 0.0)):
        names = [f"cf-{letter}{mass_g:g}" for letter in team]
        write_table(
            folder / f"{team}.csv", as_table(flown(team, "walk", 25.0, mass_g), team, names)
        )
    text = (folder / "S.csv").read_text()
    (folder / "bad.csv").write_text(text.replace("voltage", "volts"))
    return folder


def test_fit_reads_a_folder_of_logs_and_says_what_became_of_it(logs, tmp_path, capsys):
    out = tmp_path / "fit"
    code = main(["fit", "--data", str(logs), "--out", str(out), *QUICK, "--logs.guard-s", "0.25"])
    assert code == 0
    said = capsys.readouterr().out
    assert "3 of 4 flights are sound" in said
    assert "refused bad.csv: column 'voltage' is missing; the nearest there is 'volts'" in said
    assert "validation MSE" in said
    report = json.loads((out / "learned.json").read_text())
    vehicle = report["logs"]["vehicles"]["cf-S-2"]
    assert vehicle["offset_g"] == pytest.approx(2.0, abs=0.1)
    assert report["vehicle_offsets_g"][str(vehicle["id"])] == pytest.approx(2.0, abs=0.1)
    assert report["findings"]["rows"] == report["logs"]["rows"] > 1000
    assert report["command"].endswith("--logs.guard-s 0.25")
    assert report["data_sha256"] == data_sha256(logs)
    assert (out / "learned.safetensors").is_file()


def test_flights_of_lone_drones_are_fitted_without_pairs_to_report(logs, tmp_path):
    alone = tmp_path / "alone"
    alone.mkdir()
    for name in ("S.csv", "L.csv"):
        (alone / name).write_bytes((logs / name).read_bytes())
    assert main(["fit", "--data", str(alone), "--out", str(tmp_path / "fit"), *QUICK]) == 0
    report = json.loads((tmp_path / "fit" / "learned.json").read_text())
    assert report["findings"]["rows"] > 100 and report["findings"]["axis_bins"] == []


def test_logs_that_cannot_be_fitted_are_explained_without_traceback(logs, tmp_path, capsys):
    code = main(["fit", "--data", str(logs / "bad.csv"), "--out", str(tmp_path), *QUICK])
    assert code == 1
    assert "swarm-envs fit: error: no flight of" in capsys.readouterr().err
    assert not (tmp_path / "learned.json").exists()


def test_the_look_at_logs_writes_the_rows_that_a_fit_reads(logs, tmp_path, capsys, monkeypatch):
    file = tmp_path / "rows.npz"
    monkeypatch.setattr("sys.argv", ["flight_logs", str(logs), "--rows", str(file)])
    assert look() == 0
    assert "cf-S-2: calibration offset" in capsys.readouterr().out
    rows, _ = read_logs(logs)
    assert np.array_equal(read_rows(file).force_g, rows.force_g)
    monkeypatch.setattr("sys.argv", ["flight_logs", str(logs / "bad.csv")])
    assert look() == 1
    assert "column 'voltage' is missing" in capsys.readouterr().err


def test_a_folder_that_collect_wrote_is_read(tmp_path):
    config = CollectionConfig(teams=("S", "SL"), walks=2, low_walks=0, swaps=0, duration_s=3.0)
    flights = collect(config, tmp_path, progress=False)
    rows, report = read_logs(tmp_path)
    assert np.array_equal(rows.force_g, interaction_rows(flights).force_g)
    assert sum(file.rows for file in report.files) == report.rows == len(rows)
    first, pair = report.files[0], report.files[-1]
    assert (first.drones, pair.drones) == ({"S1": "S"}, {"S1": "S", "L1": "L"})
    for file in report.files:
        assert file.entries == round(file.seconds * 120) * len(file.drones)
        assert file.entries == file.rows + sum(file.dropped.values())
    (tmp_path / "manifest.json").write_text("{}")
    with pytest.raises(ValueError, match="collection was not finished"):
        read_logs(tmp_path)


def test_the_fingerprint_of_a_folder_depends_on_every_file(tmp_path):
    (tmp_path / "a.csv").write_text("1")
    before = data_sha256(tmp_path)
    assert data_sha256(tmp_path) == before
    (tmp_path / "b.csv").write_text("2")
    after = data_sha256(tmp_path)
    (tmp_path / "b.csv").rename(tmp_path / "c.csv")
    assert len({before, after, data_sha256(tmp_path)}) == 3
