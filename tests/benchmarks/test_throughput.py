"""The benchmark measures what it says; how fast is never tested."""

from __future__ import annotations

import importlib.util
import json
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from swarm_envs.vehicles import SMALL


@pytest.fixture(scope="module")
def bench() -> ModuleType:
    path = Path(__file__).with_name("throughput.py")
    spec = importlib.util.spec_from_file_location("throughput", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.parametrize("n", [1, 4, 16, 64])
def test_packed_swarms_fit_one_interaction_volume(bench, n):
    position = bench.packed(n)
    offset = np.abs(position[:, None] - position[None])
    assert position.shape == (n, 3)
    assert (offset.max(axis=(0, 1)) < [0.35, 0.35, 1.1]).all()
    distance = np.linalg.norm(offset, axis=2) + 9.0 * np.eye(n)
    assert distance.min() > 2 * SMALL.radius


def test_rows_say_how_many_pairs_were_evaluated(bench):
    packed = bench.environment_row("batch", 4, "packed", 1)
    assert packed["pairs"] == 3.0  # each of four has three neighbours
    assert packed["force_rate"] == 240
    assert packed["value"] > 0.0
    random = bench.environment_row("batch", 4, "random", 2)
    assert random["pairs"] < 3.0
    assert random["low"] <= random["value"] <= random["high"]


def test_a_peer_that_is_not_installed_is_said_to_be(bench, monkeypatch):
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    row = bench.peer_row("no effects", 4, 1)
    assert row["note"] == "not installed"
    assert "not installed" in bench.table([row])


def test_table_and_json(bench, monkeypatch, tmp_path, capsys):
    row = {"what": "a thing", "value": 12345.6, "low": 1.0, "high": 2e4, "unit": "per s"}
    monkeypatch.setattr(bench, "jobs", lambda repetitions: iter([lambda: row | {"drones": 4}]))
    path = tmp_path / "speed.json"
    bench.main(["--json", str(path), "--repetitions", "1"])
    printed = capsys.readouterr().out
    assert "12,346" in printed
    assert "1.00 - 20,000" in printed
    assert json.loads(path.read_text())["rows"] == [row | {"drones": 4}]
    assert [file.name for file in tmp_path.iterdir()] == ["speed.json"]
