"""The benchmark of batches measures what it says; how fast is never tested."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path

import pytest

from tests.benchmarks import batched as bench
from tests.benchmarks.peers import DRONES_PEER, batch_peer_row, peer_row
from tests.benchmarks.rows import table


@pytest.fixture
def small(monkeypatch):
    monkeypatch.setattr(bench, "BATCH", (3, 4))
    monkeypatch.setattr(bench, "MEMORY", (2, 4))


def test_rows_say_how_many_pairs_were_evaluated(small):
    packed = bench.batch_row("packed", 48, "float32", 1)
    assert (packed["pairs"], packed["force_rate"]) == (3.0, 48)  # each of four has three neighbours
    random = bench.batch_row("random", 240, "float64", 2)
    assert random["pairs"] < 3.0
    assert 0.0 < random["low"] <= random["value"] <= random["high"]


def test_growth_is_drawn_from_its_rows(small, tmp_path):
    many, large = ((1, 4), (2, 4)), ((1, 5), (1, 6))
    rows = [bench.scale_row(size, sizes, 1) for sizes in (many, large) for size in sizes]
    assert [(row["environments"], row["drones"]) for row in rows] == [*many, *large]
    assert all(row["unit"] == "ms" and row["value"] > 0.0 for row in rows)
    bench.draw(rows, tmp_path / "speed.png")
    assert (tmp_path / "speed.png").read_bytes()[:4] == b"\x89PNG"


@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="needs Linux")
def test_memory_is_that_of_a_whole_process(small):
    row = bench.memory_row()
    assert 50.0 < row["value"] < 1024.0
    assert row["unit"] == "MiB"


def test_threads_are_compared_in_wall_time(small):
    row = bench.thread_row(48, 1)
    assert row["unit"] == "times"
    assert row["value"] > 0.0


@pytest.mark.skipif(
    importlib.util.find_spec("crazyflow") is not None, reason="the peer is installed"
)
def test_a_peer_that_is_not_installed_is_said_to_be():
    row = batch_peer_row(sys.executable, "48/240 Hz", 1, 4, 1)
    assert row["note"] == "not installed"
    assert "not installed" in table([row])


@pytest.mark.skipif(
    importlib.util.find_spec("gym_pybullet_drones") is not None, reason="the peer is installed"
)
def test_so_is_the_other():
    row = peer_row(sys.executable, "no effects", 4, 1)
    assert (row["what"].startswith(DRONES_PEER), row["note"]) == (True, "not installed")
