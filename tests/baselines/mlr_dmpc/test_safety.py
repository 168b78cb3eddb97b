"""Whatever is lost, whoever crashes: nobody collides, and the paper's lemmas hold in each round.

A failing example is a `Trouble`, which can be pasted and flown again.
"""

from __future__ import annotations

import os
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

from swarm_envs.baselines.mlr_dmpc.mlr_dmpc_config import MlrDmpcConfig
from tests.helpers.mlr_adversary import Flight, Trouble

FIXED = MlrDmpcConfig(planes="fixed")
LOSSLESS = {"unit_loss": 0.0, "drone_loss": 0.0, "jams": (), "bursts": 0.0, "trick": "none"}
MANY = int(os.environ.get("SWARM_ENVS_INSTANCES", "2000"))
"""Flights of the slow tests; a quarter where messages are lost by half."""


def hold(trouble: Trouble, config: MlrDmpcConfig | None = None) -> Flight:
    flight = trouble.fly(config)
    assert not flight.broken, (trouble, flight.broken[:5])
    return flight


WHO = st.sampled_from(["all", "units", "drones", "unit 0", "drone 1"])


def intervals(most: int) -> st.SearchStrategy[tuple[int, int]]:
    lengths = st.tuples(st.integers(0, most), st.integers(0, 15))
    return lengths.map(lambda pair: (pair[0], pair[0] + pair[1]))


@st.composite
def troubles(draw, recovery: bool | str = True) -> Trouble:
    drones = draw(st.integers(4, 10))
    units = draw(st.integers(1, min(drones, 4)))
    jams = draw(st.lists(st.tuples(intervals(20), WHO, WHO), max_size=2))
    outages = draw(st.lists(st.tuples(st.integers(0, units - 1), intervals(20)), max_size=2))
    most = int(recovery is True)
    return Trouble(
        seed=draw(st.integers(0, 10_000)),
        drones=drones,
        units=units,
        unit_loss=draw(st.floats(0.0, 0.6)),
        drone_loss=draw(st.floats(0.0, 0.6)),
        jams=tuple((a, b, s, r) for (a, b), s, r in jams),
        outages=tuple((unit, a, b) for unit, (a, b) in outages),
        joins=tuple((drones - 1, k) for k in draw(st.lists(st.integers(0, 12), max_size=most))),
        leaves=tuple((0, k) for k in draw(st.lists(st.integers(0, 20), max_size=most))),
        informed=draw(st.booleans()),
        rounds=30,
        recovery=recovery,
        trigger=draw(st.sampled_from(["WT", "HT", "RR", "DT"])),
    )


LONE = Trouble(
    seed=5,
    drones=5,
    units=3,
    unit_loss=0.6,
    drone_loss=0.3,
    jams=((12, 16, "unit 0", "units"), (15, 28, "unit 0", "all")),
    outages=((2, 14, 27), (2, 1, 9)),
    joins=((4, 9),),
    leaves=((0, 18),),
    rounds=30,
)
"""A unit hears of a newer view, but for 15 rounds from nobody who belongs to it."""


@settings(max_examples=12, deadline=None, suppress_health_check=list(HealthCheck))
@given(trouble=troubles())
@example(trouble=LONE)
def test_no_loss_brings_drones_together(trouble):
    hold(trouble)


@settings(max_examples=4, deadline=None, suppress_health_check=list(HealthCheck))
@given(trouble=troubles(recovery="paper"))
def test_nor_with_the_papers_own_recovery(trouble):
    hold(trouble)


def test_without_recovery_the_same_check_finds_collisions():
    lossy = Trouble(seed=2, drones=10, units=3, unit_loss=0.3, drone_loss=0.3, recovery=False)
    assert "may come to" in "".join(replace(lossy, rounds=15).fly().broken)


@pytest.mark.parametrize(("seed", "loss"), [(10, 0.05), (11, 0.2), (12, 0.0), (32, 0.2)])
def test_a_drone_that_joins_keeps_its_distance_from_its_first_instant_on(seed, loss):
    """Distances once counted a sample later, and promises were used for drones on the ground."""
    rng = np.random.default_rng(seed)
    drones = int(rng.integers(8, 13))
    joins = tuple((drones - 1 - i, int(rng.integers(0, 15))) for i in range(3))
    joining = Trouble(seed=seed, drones=drones, units=3, joins=joins, rounds=60)
    assert hold(replace(joining, unit_loss=loss, drone_loss=loss), FIXED).joined >= 2


@pytest.mark.parametrize("config", [None, FIXED], ids=["relinearised", "fixed"])
def test_a_radio_that_reads_messages_brings_nobody_together(config):
    flights = [hold(Trouble.drawn(seed), config) for seed in range(7)]
    assert sum(flight.plans for flight in flights) > 150
    assert sum(flight.joined for flight in flights) > 3


def test_the_invariants_are_about_something():
    """Lemmas checked on trackers that claim nothing would hold for any protocol."""
    few = LOSSLESS | {"unit_loss": 0.1, "drone_loss": 0.1}
    found = hold(Trouble.drawn(3, outages=(), joins=(), leaves=(), rounds=30, **few))
    assert found.covering > 300 and found.up_to_date > 200 and found.accepted > 10


@pytest.mark.slow
@pytest.mark.parametrize("config", [None, FIXED], ids=["relinearised", "fixed"])
def test_two_thousand_random_flights_are_safe(config):
    flights = [hold(Trouble.drawn(seed), config) for seed in range(MANY)]
    assert sum(f.rejected for f in flights) < 1e-3 * sum(f.plans for f in flights)


@pytest.mark.slow
def test_five_hundred_flights_are_safe_with_up_to_half_of_all_messages_lost():
    for seed in range(20_000, 20_000 + MANY // 4):
        loss = float(np.random.default_rng((seed, 11)).choice([0.0, 0.05, 0.1, 0.2, 0.3, 0.5]))
        hold(Trouble.drawn(seed, unit_loss=loss, drone_loss=loss))
