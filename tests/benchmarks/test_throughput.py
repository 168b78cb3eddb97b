"""The benchmark measures what it says; how fast is never tested."""

from __future__ import annotations

import numpy as np
import pytest

from swarm_envs.vehicles import SMALL
from tests.benchmarks import throughput as bench


@pytest.mark.parametrize("n", [1, 4, 16, 64])
def test_packed_swarms_fit_one_interaction_volume(n):
    position = bench.packed(n)
    offset = np.abs(position[:, None] - position[None])
    assert position.shape == (n, 3)
    assert (offset.max(axis=(0, 1)) < [0.35, 0.35, 1.1]).all()
    distance = np.linalg.norm(offset, axis=2) + 9.0 * np.eye(n)
    assert distance.min() > 2 * SMALL.radius


def test_rows_say_how_many_pairs_were_evaluated():
    packed = bench.environment_row("batch", 4, "packed", 48, 1)
    assert packed["pairs"] == 3.0  # each of four has three neighbours
    assert packed["force_rate"] == 48
    assert packed["value"] > 0.0
    random = bench.environment_row("batch", 4, "random", 240, 2)
    assert random["pairs"] < 3.0
    assert random["low"] <= random["value"] <= random["high"]
