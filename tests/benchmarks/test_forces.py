"""The benchmark of the forces measures what it says; how fast is never tested."""

from __future__ import annotations

import importlib.util
import json

import numpy as np
import pytest

from swarm_envs.interactions import load
from swarm_envs.vehicles import GRAM_FORCE
from tests.benchmarks import forces as bench
from tests.benchmarks.rows import table


def test_all_ways_compute_the_same():
    position, velocity = bench.states(3, 4)
    model, team = load("learned"), bench.team_of(4)
    expected = model.forces(position, velocity, team)
    plain = bench.numpy_forces(model, position, velocity, team)
    np.testing.assert_allclose(plain, expected, rtol=0, atol=1e-9 * GRAM_FORCE)
    np.testing.assert_array_equal(bench.kernel_forces(model, position, velocity, team)(), expected)
    pytest.importorskip("torch")
    trained = bench.torch_forces("float64", position, velocity, team)().numpy() * GRAM_FORCE
    np.testing.assert_allclose(trained, expected[..., 2], rtol=0, atol=1e-9 * GRAM_FORCE)


def test_every_pair_is_evaluated_and_a_missing_peer_is_said(monkeypatch):
    row = bench.force_row("kernel", "float32", 2, 4, 2)
    assert row["pairs"] == 3
    assert 0.0 < row["low"] <= row["value"] <= row["high"]
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    assert "not installed" in table([row, bench.force_row("torch", "float64", 2, 4, 1)])


def test_table_and_json(monkeypatch, tmp_path, capsys):
    row = bench.force_row("numpy", "float64", 1, 2, 1)
    monkeypatch.setattr(bench, "jobs", lambda options: iter([lambda: row]))
    bench.main(["--json", str(tmp_path / "speed.json"), "--repetitions", "1"])
    assert "numpy, float64" in capsys.readouterr().out
    assert json.loads((tmp_path / "speed.json").read_text())["rows"] == [row]
