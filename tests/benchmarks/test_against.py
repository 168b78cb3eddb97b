"""Two trees are measured in turn, and rows say which is faster; how fast is never tested."""

from __future__ import annotations

from pathlib import Path

import pytest

import swarm_envs
from tests.benchmarks import against as bench
from tests.benchmarks.rows import table


@pytest.fixture
def trees(monkeypatch):
    """This tree twice, each in a process of its own."""
    monkeypatch.setattr(bench, "LEAST_SECONDS", 0.001)
    both = [bench.Tree(Path(swarm_envs.__file__).parent.parent) for _ in range(2)]
    yield both
    for tree in both:
        tree.close()


def job(maker: str = "environment", **options: object) -> bench.Measured:
    return bench.Measured({"what": "a thing", "unit": "agent-steps/s"}, maker, dict(options), 2)


def test_both_trees_answer_and_are_compared(trees):
    pair = bench.in_turn(trees, job(engine="batch", drones=2), 3)
    assert isinstance(pair, tuple)
    assert [len(side) for side in pair] == [3, 3]
    assert min(*pair[0], *pair[1]) > 0.0
    rows = [job() for job in bench.compared({"what": "it", "unit": "ms"}, lambda: pair, fast=False)]
    assert [row["what"] for row in rows] == ["it, old", "it, new", "it, new over old"]
    assert rows[2]["low"] <= rows[2]["value"] <= rows[2]["high"]


def test_a_tree_that_fails_is_shown_with_its_error(trees):
    found = bench.in_turn(trees, job(engine="batch", drones=0), 1)
    assert isinstance(found, str)
    assert "num_drones" in found
    rows = [job() for job in bench.compared({"what": "it", "unit": "ms"}, lambda: found, fast=True)]
    assert found in table(rows)


def test_more_agent_steps_are_faster_and_more_seconds_slower():
    pair = ([1.0, 2.0], [2.0, 4.0])
    for fast, expected in ((True, 2.0), (False, 0.5)):
        *_, ratio = bench.compared({"what": "it", "unit": ""}, lambda: pair, fast)
        assert ratio()["value"] == expected
