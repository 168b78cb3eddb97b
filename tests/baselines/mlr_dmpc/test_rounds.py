"""Swarms without message loss: distances, Theorem 1, arrival, right of way."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from swarm_envs.baselines.mlr_dmpc.config import MlrDmpcConfig
from tests.helpers.mlr_rounds import Rounds, circle, keep_clear, scattered

CONFIG = MlrDmpcConfig()


@settings(max_examples=8, deadline=None)
@given(seed=st.integers(0, 10**6), n=st.integers(2, 12), units=st.integers(1, 4))
def test_swarms_stay_apart_and_what_they_fly_stays_feasible(seed, n, units):
    rng = np.random.default_rng(seed)
    swarm = Rounds(
        scattered(n, CONFIG, rng, 0.2501), scattered(n, CONFIG, rng), units, CONFIG, seed
    )
    for _ in range(30):
        swarm.step()
        keep_clear(swarm)


@pytest.mark.parametrize("units", [1, 2, 3])
def test_eight_change_places_on_a_circle(units):
    swarm = Rounds(*circle(8, 1.0), units, CONFIG)
    assert swarm.run(25.0, keep_clear) < 25.0


@pytest.mark.parametrize("offset", [0.0, 1e-3, -1e-3, 0.04, -0.04])
def test_two_head_on_pass_each_other_on_the_right(offset):
    """Also if they begin a little to the left of each other."""
    side = offset / 2
    starts = np.array([[-1.2, side, 1.0], [1.2, -side, 1.0]])
    swarm = Rounds(starts, starts * [-1.0, 1.0, 1.0], 1, CONFIG)
    aside = []

    def watch(now: Rounds) -> None:
        first, second = now.snapshot().positions
        aside.append((abs(first[0] - second[0]), first[1] - second[1]))

    assert swarm.run(15.0, watch) < 15.0
    assert min(aside)[1] < -0.1, "the one that flies towards +x passes at smaller y"


def test_the_same_seed_flies_the_same():
    flights = []
    for _ in range(2):
        swarm = Rounds(*circle(6, 0.6), 2, CONFIG, seed=4)
        for _ in range(15):
            swarm.step()
        flights.append(swarm.snapshot())
    assert all(np.array_equal(a, b) for a, b in zip(*flights, strict=True))


@pytest.mark.slow
@pytest.mark.parametrize(("units", "limit"), [(1, 30.0), (2, 20.0), (3, 18.0)])
def test_sixteen_change_places_on_a_circle(units, limit):
    swarm = Rounds(*circle(16), units, CONFIG)
    assert swarm.run(limit + 1.0, keep_clear) <= limit


@pytest.mark.slow
def test_none_of_200_random_swarms_ends_in_a_deadlock():
    late = []
    for seed in range(200):
        rng = np.random.default_rng(seed)
        n = int(rng.integers(4, 17))
        swarm = Rounds(scattered(n, CONFIG, rng), scattered(n, CONFIG, rng), 3, CONFIG, seed)
        if not swarm.run(60.0) <= 60.0:
            late.append(seed)
        keep_clear(swarm)
    assert not late


def test_finer_sampling_is_obeyed():
    fine = replace(CONFIG, collision_sampling_s=0.05)
    swarm = Rounds(*circle(4, 0.5), 2, fine)
    assert swarm.run(15.0, keep_clear) < 15.0
