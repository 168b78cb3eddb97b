"""Joins, leaves, dead units, and a radio that reads messages and loses the worst."""

from __future__ import annotations

import os
from dataclasses import replace

import numpy as np
import pytest

from swarm_envs.baselines.mlr_dmpc.mlr_dmpc_config import MlrDmpcConfig
from tests.helpers.mlr_adversary import TOLERANCE, Flight, Trouble

FIXED = MlrDmpcConfig(planes="fixed")


def hold(trouble: Trouble, config: MlrDmpcConfig | None = None) -> Flight:
    flight = trouble.fly(config)
    assert not flight.broken, (trouble, flight.broken[:5])
    assert flight.least_m >= flight.sampled_m - TOLERANCE
    assert flight.between_m >= flight.always_m - TOLERANCE
    return flight


@pytest.mark.parametrize(("seed", "loss"), [(10, 0.05), (11, 0.2), (12, 0.0), (32, 0.2)])
def test_a_drone_that_joins_keeps_its_distance_from_its_first_instant_on(seed, loss):
    """Distances once counted a sample later, and promises were used for drones on the ground."""
    assert hold(Trouble.joining(seed, loss), FIXED).joined >= 2


def test_a_radio_that_reads_messages_brings_nobody_together():
    flights = [hold(Trouble.drawn(seed)) for seed in range(8)]
    assert sum(flight.plans for flight in flights) > 150
    assert sum(flight.joined for flight in flights) > 8
    assert not any(flight.infeasible for flight in flights)


def test_nor_does_it_with_the_papers_planes():
    flights = [hold(Trouble.drawn(seed), FIXED) for seed in range(8, 14)]
    assert sum(flight.plans for flight in flights) > 100
    assert not any(flight.infeasible for flight in flights)


@pytest.mark.slow
def test_five_hundred_flights_are_safe_with_up_to_half_of_all_messages_lost():
    for seed in range(20_000, 20_000 + int(os.environ.get("SWARM_ENVS_INSTANCES", "500"))):
        loss = np.random.default_rng((seed, 11)).choice([0.0, 0.05, 0.1, 0.2, 0.3, 0.5])
        hold(replace(Trouble.drawn(seed), loss=float(loss)))


@pytest.mark.slow
def test_two_thousand_flights_with_the_papers_planes_are_safe():
    """Where SWARM_ENVS_INSTANCES says so, more or fewer."""
    for seed in range(int(os.environ.get("SWARM_ENVS_INSTANCES", "2000"))):
        hold(Trouble.drawn(seed), FIXED)
