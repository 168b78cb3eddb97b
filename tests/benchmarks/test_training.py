"""The benchmark of training measures what it says; how fast is never tested."""

from __future__ import annotations

import pytest

pytest.importorskip("stable_baselines3")

from tests.benchmarks.training import PARTS, measure


@pytest.mark.parametrize(("threads", "unit"), [(1, "CPU s"), (2, "s")])
def test_parts_are_shares_of_the_whole(threads, unit):
    small = {"environments": 4, "batch_size": 64, "rollout": 16, "drones": (2, 4), "hidden": (8,)}
    small |= {"interactions": "none", "threads": threads}
    speed, *parts = measure(small, repetitions=1, rollouts=1)
    assert speed["value"] > 0.0 and speed["unit"] == f"agent-steps per {unit}"
    assert [row["what"].strip() for row in parts] == list(PARTS)
    whole, features, flown = (row["value"] for row in parts)
    assert 0.0 < features + flown < whole < 100.0
