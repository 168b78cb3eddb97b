"""A folder as people have them: copies, doubles, other files, odd logs."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from swarm_envs.training.flight_logs import (
    FlightTable,
    LogOptions,
    LogReport,
    read_logs,
    write_table,
)
from swarm_envs.training.flight_logs.log_report import Calibration
from swarm_envs.training.force_model.fit_data import read_data
from swarm_envs.training.interaction_rows import InteractionRows, save_rows
from swarm_envs.vehicles import SMALL

OPTIONS = LogOptions(min_scenario_rows=1, min_quiet_rows=0, block_s=1.0, guard_s=0.1)


@pytest.fixture(scope="module")
def table(flown: Any, as_table: Any) -> FlightTable:
    """Two drones, 8 s."""
    made: FlightTable = as_table(flown("SL"), "SL")
    return made


@pytest.fixture(scope="module")
def rows(table: FlightTable, tmp_path_factory: pytest.TempPathFactory) -> InteractionRows:
    """The rows of that flight."""
    path = tmp_path_factory.mktemp("log") / "flight.csv"
    write_table(path, table)
    return read_logs(path, OPTIONS)[0]


def test_a_copy_of_a_flight_is_refused(table: FlightTable, tmp_path: Path) -> None:
    write_table(tmp_path / "a.csv", table)
    alone = len(read_logs(tmp_path, OPTIONS)[0])
    renamed = np.char.add(table.drone, "x")
    copy = dataclasses.replace(table, drone=renamed, time=table.time + 5.0)
    write_table(tmp_path / "b.csv", copy)
    found, report = read_logs(tmp_path, OPTIONS)
    assert len(found) == alone
    assert [file.refused is None for file in report.files] == [True, False]
    assert "b.csv is a copy of a.csv" in str(report.files[1].refused)


def test_a_copy_of_a_table_is_refused_whatever_its_labels(
    rows: InteractionRows, tmp_path: Path
) -> None:
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


def test_what_is_not_read_is_said(
    table: FlightTable, rows: InteractionRows, tmp_path: Path
) -> None:
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
    assert read_logs(tmp_path, OPTIONS)[1].not_read == ("b.tsv", "c.csv.gz", "d.npz", *others[2:])


@pytest.mark.parametrize("with_rows", [False, True])
def test_a_flight_in_two_files_is_refused_alone(
    with_rows: bool, table: FlightTable, rows: InteractionRows, tmp_path: Path
) -> None:
    write_table(tmp_path / "a.csv", table)
    for name in ("b.csv", "b.parquet"):
        (tmp_path / name).write_text("1")
    if with_rows:
        save_rows(tmp_path / "c.npz", rows)
    _, report = read_data(tmp_path, OPTIONS)
    refused = {file.file: file.refused for file in report.files if file.refused}
    reason = "flight 'b' is there as b.csv and as b.parquet; keep one of them"
    assert refused == {"b.csv": reason, "b.parquet": reason}


def test_sound_files_without_rows_are_counted(
    table: FlightTable, flown: Any, as_table: Any, tmp_path: Path
) -> None:
    write_table(tmp_path / "a.csv", table)
    low = as_table(flown("S"), "S", ["cf0"])
    level = np.array([1.0, 1.0, 0.0])
    low = dataclasses.replace(
        low, position=low.position * level, velocity=low.velocity * level, acceleration=None
    )
    write_table(tmp_path / "b.csv", low)
    said = read_logs(tmp_path, OPTIONS)[1].lines()
    assert said[0].startswith("2 of 2 flights are sound, 1 of them gives no row: ")


def test_damaged_files_are_refused_alone(
    table: FlightTable, rows: InteractionRows, tmp_path: Path
) -> None:
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
    assert refused["empty.csv"] == refused["void.parquet"]
    assert refused["empty.csv"] == "the file is empty; copy it again or delete it"


def test_an_implausible_calibration_offset_is_a_warning() -> None:
    def lines(offset: float | None) -> list[str]:
        vehicles = {"cf7": Calibration(0, "S", 100, 50, offset, 0.1)}
        return LogReport([], {}, vehicles, 100, 0).lines()

    weight = 1000.0 * SMALL.mass
    for sound in (None, 0.14 * weight, -0.14 * weight):
        assert not any(line.startswith("warning") for line in lines(sound))
    for odd in (0.16 * weight, -0.16 * weight):
        said = lines(odd)[-1]
        assert said.startswith("warning: the calibration offset of S cf7 is 16 % of its weight")
        assert said.endswith("check mass, voltage, rotors")
