"""Logs through the whole chain; folders as people have them: copies, doubles, odd logs, tables."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from swarm_envs.cli import main
from swarm_envs.interactions import load
from swarm_envs.training.collection import CollectionConfig, collect, interaction_rows
from swarm_envs.training.flight_logs import (
    FlightTable,
    LogOptions,
    LogReport,
    write_table,
)
from swarm_envs.training.flight_logs.__main__ import check_logs as look
from swarm_envs.training.flight_logs.log_report import Calibration
from swarm_envs.training.flight_logs.read import data_sha256, read_data
from swarm_envs.training.force_model.force_fit_config import REPORTS, WEIGHTS
from swarm_envs.training.interaction_rows import InteractionRows, read_rows, save_rows
from swarm_envs.vehicles import SMALL

QUICK = ("--steps", "30", "--batch-size", "64")


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
    assert "3 of 4 files are sound" in said
    assert "refused bad.csv: column 'voltage' is missing; there are " in said
    assert f"fly it: swarm-envs fly --interactions {out / 'learned.safetensors'}" in said
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
    assert "swarm-envs fit: error: bad.csv: column" in capsys.readouterr().err
    assert not (tmp_path / "learned.json").exists()


def test_the_look_at_logs_writes_the_rows_that_a_fit_reads(logs, tmp_path, capsys, monkeypatch):
    file = tmp_path / "rows.npz"
    monkeypatch.setattr("sys.argv", ["flight_logs", str(logs), "--rows", str(file)])
    assert look() == 0
    assert "cf-S-2: calibration offset" in capsys.readouterr().out
    rows, _ = read_data(logs)
    assert np.array_equal(read_rows(file).force_g, rows.force_g)
    monkeypatch.setattr("sys.argv", ["flight_logs", str(logs / "bad.csv")])
    assert look() == 1
    assert "column 'voltage' is missing" in capsys.readouterr().err


def test_a_folder_that_collect_wrote_is_read(tmp_path):
    config = CollectionConfig(teams=("S", "SL"), walks=2, low_walks=0, swaps=0, duration_s=3.0)
    flights = collect(config, tmp_path, progress=False)
    with pytest.raises(FileNotFoundError, match=r"no rows\.npz: the collection was not finished"):
        read_data(tmp_path, OPTIONS)
    table = interaction_rows(flights)
    save_rows(tmp_path / "rows.npz", table)
    rows, report = read_data(tmp_path, OPTIONS)
    assert np.array_equal(rows.force_g, table.force_g)
    assert [file.file for file in report.files] == ["rows.npz"]


def test_the_fingerprint_of_a_folder_depends_on_every_file(tmp_path):
    (tmp_path / "a.csv").write_text("1")
    before = data_sha256(tmp_path)
    assert data_sha256(tmp_path) == before
    (tmp_path / "b.csv").write_text("2")
    after = data_sha256(tmp_path)
    (tmp_path / "b.csv").rename(tmp_path / "c.csv")
    assert len({before, after, data_sha256(tmp_path)}) == 3


OPTIONS = LogOptions(min_scenario_rows=1, min_quiet_rows=0, block_s=1.0, guard_s=0.1)


@pytest.fixture(scope="module")
def table(flown: Any, as_table: Any) -> FlightTable:
    """Two drones, 8 s."""
    made: FlightTable = as_table(flown("SL", "walk", 8.0), "SL", ["50", "big"])
    return made


@pytest.fixture(scope="module")
def rows(table: FlightTable, tmp_path_factory: pytest.TempPathFactory) -> InteractionRows:
    """The rows of that flight."""
    path = tmp_path_factory.mktemp("log") / "flight.csv"
    write_table(path, table)
    return read_data(path, OPTIONS)[0]


def test_a_copy_of_a_flight_is_refused(table, tmp_path):
    write_table(tmp_path / "a.csv", table)
    alone = len(read_data(tmp_path, OPTIONS)[0])
    renamed = np.char.add(table.drone, "x")
    copy = dataclasses.replace(table, drone=renamed, time=table.time + 5.0)
    write_table(tmp_path / "b.csv", copy)
    found, report = read_data(tmp_path, OPTIONS)
    assert len(found) == alone
    assert [file.refused is None for file in report.files] == [True, False]
    assert "b.csv is a copy of a.csv" in str(report.files[1].refused)


def test_a_copy_of_a_table_is_refused_whatever_its_labels(rows, tmp_path):
    save_rows(tmp_path / "a.npz", rows)
    copy = dataclasses.replace(
        rows, force_g=rows.force_g + 1.0, validation=~rows.validation
    ).select(np.arange(len(rows))[::-1])
    save_rows(tmp_path / "b.npz", copy)
    save_rows(tmp_path / "c.npz", rows.select(np.arange(len(rows) // 2)))
    found, report = read_data(tmp_path, OPTIONS)
    assert "b.npz is a copy of a.npz" in str(report.files[1].refused)
    assert [file.refused is None for file in report.files] == [True, False, True]
    assert len(found) == len(rows) + len(rows) // 2


def test_what_is_not_read_is_said(table, rows, tmp_path):
    write_table(tmp_path / "a.csv", table)
    (tmp_path / "a.csv").rename(tmp_path / "UP.CSV")
    (tmp_path / "sub").mkdir()
    for name in ("b.tsv", "c.csv.gz", "notes.txt", ".hidden"):
        (tmp_path / name).write_text("1")
    others = ("b.tsv", "c.csv.gz", "notes.txt", "sub/")
    _, report = read_data(tmp_path, OPTIONS)
    assert [file.file for file in report.files] == ["UP.CSV"]
    assert report.not_read == others
    said = "not read: b.tsv, c.csv.gz, notes.txt, sub/; data is .csv, .parquet and .npz right in"
    assert f"{said} the folder" in report.lines()
    save_rows(tmp_path / "d.npz", rows)
    _, report = read_data(tmp_path, OPTIONS)
    assert {file.file for file in report.files} == {"UP.CSV", "d.npz"}
    assert report.not_read == others


def test_sound_files_without_rows_are_counted(table, flown, as_table, tmp_path):
    write_table(tmp_path / "a.csv", table)
    low = as_table(flown("S"), "S", ["cf0"])
    level = np.array([1.0, 1.0, 0.0])
    low = dataclasses.replace(
        low, position=low.position * level, velocity=low.velocity * level, acceleration=None
    )
    write_table(tmp_path / "b.csv", low)
    said = read_data(tmp_path, OPTIONS)[1].lines()
    assert said[0].startswith("2 of 2 files are sound, 1 of them gives no row: ")


def test_damaged_files_are_refused_alone(table, rows, tmp_path):
    pytest.importorskip("pyarrow")
    write_table(tmp_path / "a.csv", table)
    (tmp_path / "broken.parquet").write_bytes(b"PAR1 and no more")
    (tmp_path / "empty.csv").touch()
    (tmp_path / "void.parquet").touch()
    save_rows(tmp_path / "whole.npz", rows)
    whole = (tmp_path / "whole.npz").read_bytes()
    (tmp_path / "cut.npz").write_bytes(whole[:900])
    middle = len(whole) // 2
    (tmp_path / "bent.npz").write_bytes(whole[:middle] + bytes(64) + whole[middle + 64 :])
    refused = {file.file: str(file.refused) for file in read_data(tmp_path, OPTIONS)[1].files}
    for name in ("broken.parquet", "cut.npz", "bent.npz"):
        assert "cannot be read" in refused[name] and "copy it again or delete it" in refused[name]
    for name in ("empty.csv", "void.parquet"):
        assert refused[name] == f"{name}: the file is empty; copy it again or delete it"


def test_an_implausible_calibration_offset_is_a_warning():
    def lines(offset: float | None) -> list[str]:
        vehicles = {"cf7": Calibration(0, "S", 100, 50, offset)}
        return LogReport([], {}, vehicles, 100, 0).lines()

    weight = 1000.0 * SMALL.mass
    for sound in (None, 0.14 * weight, -0.14 * weight):
        assert not any(line.startswith("warning") for line in lines(sound))
    for odd in (0.16 * weight, -0.16 * weight):
        said = lines(odd)[-1]
        assert said.startswith("warning: the calibration offset of S cf7 is 16 % of its weight")
        assert said.endswith("check mass, voltage, rotors")


MIXED = LogOptions(min_scenario_rows=20, min_quiet_rows=0, guard_s=0.25)


@pytest.fixture
def folder(table: FlightTable, rows: InteractionRows, tmp_path: Path) -> Path:
    """A sound log and a sound table, two bad logs, two bad tables, and what is neither."""
    data = tmp_path / "data"
    write_table(data / "a-log.csv", table)
    save_rows(data / "table.npz", rows)
    velocity = table.velocity.copy()
    velocity[5, 1] = np.nan
    unknown = np.full(len(table), "M")
    write_table(data / "bad-nan.csv", dataclasses.replace(table, velocity=velocity))
    write_table(data / "bad-unknown-type.csv", dataclasses.replace(table, type=unknown))
    save_rows(data / "bad-force.npz", dataclasses.replace(rows, force_g=1e3 * rows.force_g))
    (data / "bad-cut.npz").write_bytes((data / "table.npz").read_bytes()[:900])
    (data / "notes.txt").write_text("windy")
    return data


def test_logs_and_tables_are_joined(folder, rows):
    found, report = read_data(folder, MIXED)
    files = {file.file: file for file in report.files}
    assert files["table.npz"].rows == len(rows)
    assert len(found) == report.rows == files["a-log.csv"].rows + len(rows)
    assert np.unique(found.flight).size == 2
    assert sorted(found.vehicle_names.values()) == ["50", "big"]  # the same in both files
    assert set(report.vehicles) == {"50", "big"}
    for file in report.files:
        if file.refused is None:
            assert file.rows + sum(file.dropped.values()) == file.entries, file.file
    assert "bad-force.npz: force_g is " in str(files["bad-force.npz"].refused)


def test_vehicles_need_no_quiet_rows_where_no_offset_is_wanted(table, tmp_path):
    """Logs alone and logs among tables alike."""
    write_table(tmp_path / "flight.csv", table)
    options = dataclasses.replace(MIXED, min_quiet_rows=10_000)
    with pytest.raises(ValueError, match="vehicle not calibrated"):
        read_data(tmp_path, options)
    found, report = read_data(tmp_path, options, offsets=False)
    assert len(found) == report.rows > 100
    assert {vehicle.refused for vehicle in report.vehicles.values()} == {None}


def test_logs_alone_give_no_torque(table, tmp_path):
    write_table(tmp_path / "flight.csv", table)
    with pytest.raises(ValueError, match="a torque head is wanted"):
        read_data(tmp_path, MIXED, torque=True)


def test_only_bad_files_end_the_fit_with_every_reason(folder):
    (folder / "a-log.csv").unlink()
    (folder / "table.npz").unlink()
    with pytest.raises(ValueError, match=r"no file of .* is sound: bad-") as end:
        read_data(folder, MIXED)
    for message in ("line 7: column 'vy' is nan", "unknown vehicle type 'M'"):
        assert message in str(end.value)


@pytest.mark.parametrize("model", ["deep-set", "composed", "wake"])
def test_the_command_fits_every_model_and_reports_alike(model, folder, tmp_path, capsys):
    out, copy = tmp_path / "out", tmp_path / "copy.json"
    logs = ["--logs.min-scenario-rows", "20", "--logs.min-quiet-rows", "0", "--offsets", "none"]
    command = ["fit", "--data", str(folder), "--out", str(out), "--json", str(copy), *logs, *QUICK]
    assert main([*command, "--model", model]) == 0
    said = capsys.readouterr().out
    assert "2 of 6 files are sound" in said and "refused bad-nan.csv: line 7: column 'vy'" in said
    assert f"{model}: validation MSE" in said
    report = json.loads(copy.read_text())
    assert report == json.loads((out / REPORTS[model]).read_text())
    assert report["model"] == model
    assert set(report["findings"]) >= {"errors", "errors_raw", "axis_bins"}
    assert len(report["logs"]["files"]) == 6
    assert report["logs"]["not_read"] == ["notes.txt"]
    assert (report["findings"]["lipschitz_measured"] == {}) == (model == "wake")
    found = load(str(out / WEIGHTS[model]))
    force = found.forces([[[0.0, 0.0, 0.8], [0.0, 0.0, 1.1]]], np.zeros((1, 2, 3)), "SL")
    assert np.isfinite(force).all() and force[0, 0, 2] != 0.0
