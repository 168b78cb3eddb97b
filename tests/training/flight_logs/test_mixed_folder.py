"""`swarm-envs fit --data DIR` on logs and tables together, sound and bad: what it uses and says."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from swarm_envs.cli import main
from swarm_envs.interactions import load
from swarm_envs.training.flight_logs import FlightTable, LogOptions, read_logs, write_table
from swarm_envs.training.force_model.fit_data import read_data
from swarm_envs.training.force_model.pipeline import REPORTS, WEIGHTS
from swarm_envs.training.interaction_rows import InteractionRows, save_rows
from swarm_envs.vehicles import GRAM_FORCE

QUICK = ("--steps", "30", "--batch-size", "64", "--slope-inputs", "16", "--lipschitz-samples", "50")
OPTIONS = LogOptions(min_scenario_rows=20, min_quiet_rows=0, guard_s=0.25)

Edit = Callable[[FlightTable], FlightTable]


def changed(**columns: object) -> Edit:
    return lambda table: dataclasses.replace(table, **columns)  # type: ignore[arg-type]


def nan_in_velocity(table: FlightTable) -> FlightTable:
    velocity = table.velocity.copy()
    velocity[5, 1] = np.nan
    return dataclasses.replace(table, velocity=velocity)


BAD_LOGS: dict[str, tuple[Edit, str]] = {
    "nan": (nan_in_velocity, "column 'vy' is nan in line 7"),
    "unknown-type": (lambda t: changed(type=np.full(len(t), "M"))(t), "unknown vehicle type 'M'"),
}


@pytest.fixture(scope="module")
def sound(flown: Any, as_table: Any) -> FlightTable:
    """Two drones, 8 s."""
    table: FlightTable = as_table(flown("SL", "walk", 8.0), "SL", ["50", "big"])
    return table


@pytest.fixture(scope="module")
def rows(sound: FlightTable, tmp_path_factory: pytest.TempPathFactory) -> InteractionRows:
    """The rows of that flight."""
    path = tmp_path_factory.mktemp("log") / "flight.csv"
    write_table(path, sound)
    return read_logs(path, dataclasses.replace(OPTIONS, block_s=1.0))[0]


@pytest.fixture
def folder(sound: FlightTable, rows: InteractionRows, tmp_path: Path) -> Path:
    """A sound log and a sound table, two bad logs, two bad tables, and what is neither."""
    data = tmp_path / "data"
    write_table(data / "a-log.csv", sound)
    save_rows(data / "table.npz", rows)
    for name, (edit, _) in BAD_LOGS.items():
        write_table(data / f"bad-{name}.csv", edit(sound))
    force = rows.force_g * GRAM_FORCE
    save_rows(data / "bad-newtons.npz", dataclasses.replace(rows, force_g=force))
    (data / "bad-cut.npz").write_bytes((data / "table.npz").read_bytes()[:900])
    (data / "notes.txt").write_text("windy")
    return data


def test_logs_and_tables_are_joined(folder: Path, rows: InteractionRows) -> None:
    found, report = read_data(folder, OPTIONS)
    files = {file.file: file for file in report.files}
    assert files["table.npz"].rows == len(rows)
    assert len(found) == report.rows == files["a-log.csv"].rows + len(rows)
    assert np.unique(found.flight).size == 2
    assert sorted(found.vehicle_names.values()) == ["50", "big"]  # the same in both files
    assert set(report.vehicles) == {"50", "big"}
    for file in report.files:
        if file.refused is None:
            assert file.rows + sum(file.dropped.values()) == file.entries, file.file


def test_vehicles_need_no_quiet_rows_where_no_offset_is_wanted(
    sound: FlightTable, tmp_path: Path
) -> None:
    """Logs alone and logs among tables alike."""
    write_table(tmp_path / "flight.csv", sound)
    options = dataclasses.replace(OPTIONS, min_quiet_rows=10_000)
    with pytest.raises(ValueError, match="vehicle not calibrated"):
        read_data(tmp_path, options)
    found, report = read_data(tmp_path, options, offsets=False)
    assert len(found) == report.rows > 100
    assert {vehicle.refused for vehicle in report.vehicles.values()} == {None}


def test_logs_alone_give_no_torque(sound: FlightTable, tmp_path: Path) -> None:
    write_table(tmp_path / "flight.csv", sound)
    with pytest.raises(ValueError, match="a flight log carries no torque"):
        read_data(tmp_path, OPTIONS, torque=True)


def test_every_refusal_is_said_with_its_reason(folder: Path) -> None:
    _, report = read_data(folder, OPTIONS)
    said = "\n".join(report.lines())
    assert f"2 of {len(BAD_LOGS) + 4} files are sound" in said
    for name, (_, message) in BAD_LOGS.items():
        assert f"refused bad-{name}.csv: " in said
        refused = next(f.refused for f in report.files if f.file == f"bad-{name}.csv")
        assert refused is not None and message in refused, name
    assert "refused bad-newtons.npz: force_g[:, 2] stays below" in said
    assert "refused bad-cut.npz: " in said


def test_too_few_rows_of_a_scenario_are_said(folder: Path) -> None:
    with pytest.raises(ValueError, match=r"no row is left of 2 files .*training rows, but must"):
        read_data(folder, dataclasses.replace(OPTIONS, min_scenario_rows=100_000))


def test_only_bad_files_end_the_fit_with_every_reason(folder: Path) -> None:
    (folder / "a-log.csv").unlink()
    (folder / "table.npz").unlink()
    with pytest.raises(
        ValueError, match=r"none of 2 logs and 2 tables in .* is sound: bad-"
    ) as end:
        read_data(folder, OPTIONS)
    for _, message in BAD_LOGS.values():
        assert message in str(end.value)


@pytest.mark.parametrize("model", ["deep-set", "pairwise", "wake"])
def test_the_command_fits_every_model_and_reports_alike(
    model: str, folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out, copy = tmp_path / "out", tmp_path / "copy.json"
    logs = ["--logs.min-scenario-rows", "20", "--logs.min-quiet-rows", "0", "--offsets", "none"]
    command = ["fit", "--data", str(folder), "--out", str(out), "--json", str(copy), *logs, *QUICK]
    assert main([*command, "--model", model]) == 0
    said = capsys.readouterr().out
    assert "2 of 6 files are sound" in said and "refused bad-nan.csv: column 'vy'" in said
    assert f"{model}: validation MSE" in said
    report = json.loads(copy.read_text())
    assert report == json.loads((out / REPORTS[model]).read_text())
    assert report["model"] == model
    assert set(report["findings"]) >= {"errors", "errors_raw", "lipschitz_bound", "axis_bins"}
    assert len(report["logs"]["files"]) == 6
    assert report["logs"]["not_read"] == ["notes.txt"]
    assert (report["findings"]["lipschitz_bound"] is None) == (model == "wake")
    found = load(str(out / WEIGHTS[model]))
    force = found.forces([[[0.0, 0.0, 0.8], [0.0, 0.0, 1.1]]], np.zeros((1, 2, 3)), "SL")
    assert np.isfinite(force).all() and force[0, 0, 2] != 0.0


def test_a_report_that_cannot_be_written_is_refused_before_the_fit(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    command = ["fit", "--data", str(folder), "--out", str(tmp_path / "o"), "--json", str(tmp_path)]
    assert main(command) == 2
    assert "--json is" in capsys.readouterr().err
