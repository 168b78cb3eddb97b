"""Whatever is lost, whoever crashes: nobody collides, and the paper's lemmas hold in each round."""

from __future__ import annotations

import os
import tempfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from tests.helpers.mlr_instances import Instance

FAILURE = Path(tempfile.gettempdir()) / "mlr-dmpc-failure.json"
"""Where the last failing instance lies, after shrinking the simplest one."""
WHO = st.sampled_from(["all", "units", "drones", "unit 0", "drone 1"])


def intervals(most: int) -> st.SearchStrategy[tuple[int, int]]:
    lengths = st.tuples(st.integers(0, most), st.integers(0, 15))
    return lengths.map(lambda pair: (pair[0], pair[0] + pair[1]))


@st.composite
def instances(draw, recovery: bool | str = True) -> Instance:
    drones = draw(st.integers(4, 10))
    units = draw(st.integers(1, min(drones, 4)))
    jams = draw(st.lists(st.tuples(intervals(20), WHO, WHO), max_size=2))
    outages = draw(st.lists(st.tuples(st.integers(0, units - 1), intervals(20)), max_size=2))
    ours = recovery is True
    joins = draw(st.lists(st.integers(0, 12), max_size=1)) if ours else []
    leaves = draw(st.lists(st.integers(0, 20), max_size=1)) if ours else []
    return Instance(
        draw(st.integers(0, 10_000)),
        drones,
        units,
        draw(st.floats(0.0, 0.6)),
        draw(st.floats(0.0, 0.6)),
        tuple((a, b, s, r) for (a, b), s, r in jams),
        tuple((unit, a, b) for unit, (a, b) in outages),
        tuple((drones - 1, k) for k in joins),
        tuple((0, k) for k in leaves),
        draw(st.booleans()),
        30,
        recovery,
        draw(st.sampled_from(["HT", "RR", "DT"])),
    )


def hold(instance: Instance) -> None:
    """Fly an instance; if anything breaks, keep it to be replayed."""
    try:
        found = instance.run()
        broken = found.broken[:5]
    except Exception:
        instance.write(FAILURE)
        raise
    if broken:
        instance.write(FAILURE)
    assert not broken, f"{broken}; replay with Instance.read({str(FAILURE)!r}).run()"


@settings(max_examples=12, deadline=None, suppress_health_check=list(HealthCheck))
@given(instance=instances())
def test_no_loss_brings_drones_together(instance):
    hold(instance)


@settings(max_examples=4, deadline=None, suppress_health_check=list(HealthCheck))
@given(instance=instances(recovery="paper"))
def test_nor_with_the_papers_own_recovery(instance):
    hold(instance)


def test_without_recovery_the_same_check_finds_collisions():
    broken = [
        Instance.random(seed, recovery=False, joins=(), leaves=(), rounds=15).run().broken
        for seed in (2, 6)
    ]
    assert all("may come to" in "".join(one) for one in broken)


def test_a_failing_instance_can_be_replayed_from_its_file(tmp_path):
    instance = Instance.random(2, recovery=False, joins=(), leaves=(), rounds=8)
    instance.write(tmp_path / "failure.json")
    again = Instance.read(tmp_path / "failure.json")
    assert again == instance
    assert again.run().broken == instance.run().broken != []


def test_the_invariants_are_about_something():
    """Lemmas checked on trackers that claim nothing would hold for any protocol."""
    found = Instance.random(3, loss=0.1, drone_loss=0.1, jams=(), outages=(), joins=()).run()
    assert found.covering > 300 and found.up_to_date > 200 and found.accepted > 10


@pytest.mark.slow
def test_two_thousand_random_instances_are_safe():
    """4 to 16 drones; where SWARM_ENVS_INSTANCES says so, more or fewer."""
    plans = failures = 0
    least = np.inf
    for seed in range(int(os.environ.get("SWARM_ENVS_INSTANCES", "2000"))):
        instance = Instance.random(seed)
        found = instance.run()
        if found.broken:
            instance.write(FAILURE)
        assert not found.broken, (instance, found.broken[:5])
        plans, failures = plans + found.plans, failures + found.failures
        least = min(least, found.least)
    assert least >= 0.25 - 1e-6
    assert failures < 1e-3 * plans
