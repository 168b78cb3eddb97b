"""Rows become a table and a file as they are."""

from __future__ import annotations

import json

import pytest

from tests.benchmarks.rows import run, spread, table


def test_table_and_json(tmp_path, capsys):
    row = {"what": "a thing", "unit": "per s", "drones": 4} | spread([12345.6, 1.0, 2e4])
    path = tmp_path / "speed.json"
    run("About.", lambda options: [lambda: row], ["--json", str(path), "--repetitions", "1"])
    printed = capsys.readouterr().out
    assert "12,346" in printed
    assert "1.00 - 20,000" in printed
    assert "pairs" not in printed
    assert json.loads(path.read_text())["rows"] == [row]
    assert [file.name for file in tmp_path.iterdir()] == ["speed.json"]


def test_a_row_without_a_number_says_why():
    lines = table([{"what": "a peer", "value": None, "note": "not installed", "unit": "per s"}])
    assert lines.splitlines()[1].split() == ["a", "peer", "not", "installed", "per", "s"]


def test_no_repetitions_are_refused(capsys):
    with pytest.raises(SystemExit):
        run("About.", lambda options: [], ["--repetitions", "0"])
    assert "must be at least 1" in capsys.readouterr().err
