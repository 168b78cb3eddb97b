"""Benchmarks measure what they say, peers where nothing of ours is; how fast is never tested."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import swarm_envs
from swarm_envs.baselines.mlr_dmpc import MlrDmpcConfig
from swarm_envs.interactions import load
from swarm_envs.vehicles import GRAM_FORCE, SMALL
from tests.benchmarks import against, batched, forces, mlr_arrivals, peers, throughput
from tests.benchmarks.rows import run, spread, table


def test_table_and_json(tmp_path, capsys):
    row = {"what": "a thing", "unit": "per s", "drones": 4} | spread([12345.6, 1.0, 2e4])
    path = tmp_path / "speed.json"
    run("About.", lambda options: [row], ["--json", str(path), "--repetitions", "1"])
    printed = capsys.readouterr().out
    assert "12,346" in printed and "1.00 - 20,000" in printed and "envs" not in printed
    assert json.loads(path.read_text())["rows"] == [row]
    with pytest.raises(SystemExit):
        run("About.", lambda options: [], ["--repetitions", "0"])
    assert "must be at least 1" in capsys.readouterr().err


@pytest.mark.parametrize("n", throughput.LAYERS)
def test_packed_swarms_fit_one_interaction_volume(n):
    position = throughput.packed(n)
    offset = np.abs(position[:, None] - position[None])
    assert position.shape == (n, 3)
    assert (offset.max(axis=(0, 1)) < [0.35, 0.35, 1.1]).all()
    assert (np.linalg.norm(offset, axis=2) + 9.0 * np.eye(n)).min() > 2 * SMALL.radius


def test_one_environment_and_many_fly(monkeypatch):
    monkeypatch.setattr(batched, "BATCH", (3, 4))
    rows = [
        throughput.environment_row("batch", 4, "packed", 48, 2),
        batched.batch_row("packed", 48, "float32", 2),
        batched.thread_row(48, 2),
        batched.hall_row(48, "learned", 1),
    ]
    for row in rows:
        assert row["force_rate"] == 48
        assert 0.0 < row["low"] <= row["value"] <= row["high"]


def test_all_ways_compute_the_same_forces():
    position, velocity = forces.states(3, 4)
    model, team = load("learned-v0"), forces.team_of(4)
    expected = model.forces(position, velocity, team)
    kernel = forces.kernel_forces(model, position, velocity, team)()
    np.testing.assert_array_equal(kernel, expected)
    pytest.importorskip("torch")
    trained = forces.torch_forces("float64", position, velocity, team)().numpy() * GRAM_FORCE
    np.testing.assert_allclose(trained, expected[..., 2], rtol=0, atol=1e-9 * GRAM_FORCE)


@pytest.fixture
def trees(monkeypatch):
    """This tree twice, each in a process of its own."""
    monkeypatch.setattr(against, "LEAST_SECONDS", 0.001)
    both = [against.Tree(Path(swarm_envs.__file__).parent.parent) for _ in range(2)]
    yield both
    for tree in both:
        tree.close()


def test_two_trees_are_measured_in_turn_and_one_that_fails_is_shown(trees):
    row = {"what": "it", "unit": "agent-steps/s"}
    options = {"engine": "batch", "drones": 2}
    pair = against.in_turn(trees, against.Measured(row, "environment", options, 2), 3)
    assert isinstance(pair, tuple)
    assert [len(side) for side in pair] == [3, 3] and min(*pair[0], *pair[1]) > 0.0
    bad = against.Measured(row, "environment", options | {"drones": 0}, 2)
    error = against.in_turn(trees, bad, 1)
    assert isinstance(error, str) and "num_drones" in error
    assert error in table([*against.compared(row, error, fast=True)])


@pytest.mark.parametrize(("fast", "expected"), [(True, 2.0), (False, 0.5)])
def test_more_agent_steps_are_faster_and_more_seconds_slower(fast, expected):
    pair = ([1.0, 2.0], [2.0, 4.0])
    old, new, ratio = against.compared({"what": "it", "unit": "ms"}, pair, fast)
    assert [old["what"], new["what"]] == ["it, old", "it, new"]
    assert (old["value"], new["value"], ratio["value"]) == (1.5, 3.0, expected)


@pytest.mark.parametrize(
    ("far", "limits", "least"),
    [
        (1.0, {"acceleration_limit": 99.0, "speed_limit": 99.0}, (32.0 / 5.0) ** (1 / 3)),
        (9.0, {"acceleration_limit": 99.0}, 9.0 / 2.0 + 2.0 * (2.0 / 5.0) ** 0.5),
        (9.0, {"acceleration_limit": 1.0}, 9.0 / 2.0 + 2.0 / 1.0 + 1.0 / 5.0),
    ],
)
def test_a_drone_alone_needs_what_its_limits_allow(far, limits, least):
    config = MlrDmpcConfig(**limits)
    goal = np.array([[0.0, far, 0.1]])
    assert mlr_arrivals.alone_s(np.zeros((1, 3)), goal, config) == pytest.approx(least)


BATCH = ("48/240 Hz", 1, 4, 1)


def interpreter(path: Path, script: str) -> str:
    """A program that takes an interpreter's place."""
    path.write_text(f"#!/bin/sh\n{script}\n")
    path.chmod(0o755)
    return str(path)


def test_measuring_needs_no_package_but_the_peer():
    """Without site-packages there is neither ours nor anything that we require."""
    words = f"-I -S {peers.__file__} {peers.BATCH_PEER} 48 240 1 4 1"
    bare = [sys.executable, *words.split()]
    output = subprocess.check_output(bare, text=True, stderr=subprocess.DEVNULL)
    assert json.loads(output.splitlines()[-1]) == {"note": "not installed"}


@pytest.mark.skipif(sys.platform == "win32", reason="the programs are shell scripts")
@pytest.mark.parametrize(
    ("script", "note"),
    [
        ("echo 'a warning'; echo '{\"note\": \"not installed\"}'", "not installed"),
        ('echo \'{"note": "TypeError: no such option"}\'', "TypeError: no such option"),
        ("echo 'Killed by something' >&2; exit 9", "Killed by something"),
        ("exit 3", "the process ended with status 3"),
    ],
)
def test_a_row_says_why_it_has_no_number(script, note, tmp_path):
    row = peers.batch_peer_row(interpreter(tmp_path / "python", script), *BATCH)
    assert (row["value"], row["note"]) == (None, note)
