"""The benchmark of the forces measures what it says; how fast is never tested."""

from __future__ import annotations

import importlib.util
import json
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from swarm_envs.interactions import load
from swarm_envs.vehicles import GRAM_FORCE


@pytest.fixture(scope="module")
def bench() -> ModuleType:
    path = Path(__file__).with_name("forces.py")
    spec = importlib.util.spec_from_file_location("forces_benchmark", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_all_ways_compute_the_same(bench):
    position, velocity = bench.states(3, 4)
    model, team = load("learned"), bench.team_of(4)
    expected = model.forces(position, velocity, team)
    plain = bench.numpy_forces(model, position, velocity, team)
    np.testing.assert_allclose(plain, expected, rtol=0, atol=1e-9 * GRAM_FORCE)
    np.testing.assert_array_equal(bench.kernel_forces(model, position, velocity, team)(), expected)
    pytest.importorskip("torch")
    trained = bench.torch_forces("float64", position, velocity, team)().numpy() * GRAM_FORCE
    np.testing.assert_allclose(trained, expected[..., 2], rtol=0, atol=1e-9 * GRAM_FORCE)


def test_every_pair_is_evaluated_and_a_missing_peer_is_said(bench, monkeypatch):
    row = bench.force_row("kernel", "float32", 2, 4, 2)
    assert row["pairs"] == 12
    assert 0.0 < row["low"] <= row["value"] <= row["high"]
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    assert "not installed" in bench.table([row, bench.force_row("torch", "float64", 2, 4, 1)])


def test_table_and_json(bench, monkeypatch, tmp_path, capsys):
    row = bench.force_row("numpy", "float64", 1, 2, 1)
    monkeypatch.setattr(bench, "jobs", lambda repetitions: iter([lambda: row]))
    bench.main(["--json", str(tmp_path / "speed.json"), "--repetitions", "1"])
    assert "median us" in capsys.readouterr().out
    assert json.loads((tmp_path / "speed.json").read_text())["rows"] == [row]
