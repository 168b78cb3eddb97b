"""A folder as people have them: copies, doubles, other files, odd logs."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from swarm_envs.training.flight_logs import FlightTable, LogOptions, read_logs, write_table
from swarm_envs.training.force_model.data import read_data
from swarm_envs.training.force_model.rows import InteractionRows, save_rows

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
    low.position[:, 2] *= 0.0
    low.velocity[:, 2] *= 0.0
    low = dataclasses.replace(low, acceleration=None)
    write_table(tmp_path / "b.csv", low)
    said = read_logs(tmp_path, OPTIONS)[1].lines()
    assert said[0].startswith("2 of 2 flights are sound, 1 of them gives no row: ")
