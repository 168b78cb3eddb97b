"""The limit study: spoiled beliefs beside the environment's own loop, and its tables."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
import pytest

from swarm_envs.baselines.neural_swarm.flights import fly, swap_test
from swarm_envs.control.config import ControllerConfig
from swarm_envs.interactions import InteractionModel, load
from swarm_envs.tasks.swap import SwapTask
from swarm_envs.training.reproduce.imperfect_flights import (
    Imperfection,
    fly_imperfectly,
    slow_noise,
)
from swarm_envs.training.reproduce.limits_study import (
    Sweep,
    all_sweeps,
    harmful_values,
    sweep_rows,
)

SEEDS = [11, 12, 13]
TEST = replace(swap_test("S2S"), horizon_s=2.6)
EXACT = ControllerConfig(feedforward=load("learned"))


def worst(controller=EXACT, seeds=SEEDS, test=TEST, **spoiled):
    return fly_imperfectly(test, controller, seeds, Imperfection(**spoiled)).height_error[:, -1]


def planted(scale):
    """The closed form with all its forces scaled by hand."""
    field = load("wake").field
    pairs, ground = field.wake_pair.copy(), field.wake_ground.copy()
    pairs[..., 0] *= scale
    ground[:, 0] *= scale
    scaled = field._replace(wake_pair=pairs, wake_ground=ground, drag=scale * field.drag)
    return InteractionModel("planted", load("wake").types, scaled)


@pytest.mark.parametrize("feedforward", [None, "learned"])
def test_with_nothing_spoiled_it_is_the_environments_loop(feedforward):
    model = None if feedforward is None else load(feedforward)
    controller, test = ControllerConfig(feedforward=model), replace(TEST, decision_rate=240)
    flown = fly(test, controller, SEEDS)
    found = fly_imperfectly(test, controller, SEEDS)
    assert found.height_error == pytest.approx(flown.worst_height_error, abs=1e-9)
    assert np.array_equal(found.crashed, flown.crashed)


def test_a_scaled_belief_is_the_belief_of_a_scaled_model():
    controller = ControllerConfig(feedforward=load("wake"))
    scaled = worst(controller, scale=0.6)
    assert scaled == pytest.approx(worst(ControllerConfig(feedforward=planted(0.6))), abs=1e-9)
    assert not np.allclose(scaled, worst(controller), atol=1e-3)
    assert worst(scale=0.0) == pytest.approx(worst(ControllerConfig()), abs=1e-12)


def test_the_error_grows_with_each_imperfection():
    perfect = worst()
    for name, values in (
        ("noise_g", (1.0, 3.0)),
        ("delay_s", (0.02, 0.1)),
        ("velocity_noise", (0.015, 0.03)),
        ("position_noise_m", (0.01, 0.03)),
    ):
        small, large = (worst(**{name: value}) for value in values)
        assert np.median(large) > 1.5 * np.median(small) > 2.0 * np.median(perfect), name


def test_a_late_belief_is_what_was_believed_before():
    """In a swap that is over before the delay ends nothing is compensated."""
    assert worst(delay_s=4.0) == pytest.approx(worst(ControllerConfig()), abs=1e-12)


def test_the_same_seeds_give_the_same_flights():
    spoiled = {"noise_g": 1.0, "velocity_noise": 0.01}
    assert np.array_equal(worst(**spoiled), worst(**spoiled))
    assert not np.array_equal(worst(seeds=[11, 12, 14], **spoiled), worst(**spoiled))


def test_noise_is_slow_and_of_known_size():
    noise = slow_noise(np.random.default_rng(0), (3, 2, 1441))
    assert np.sqrt((noise**2).mean(axis=-1)) == pytest.approx(1.0)
    assert noise.mean(axis=-1) == pytest.approx(0.0, abs=1e-12)
    power = np.abs(np.fft.rfft(noise)) ** 2
    assert power[..., np.fft.rfftfreq(1441, 1 / 240) > 5.0].sum() < 1e-9 * power.sum()
    assert abs(np.corrcoef(noise[0])[0, 1]) < 0.4


def test_sweeps_vary_what_they_say():
    sweeps = {sweep.name: sweep for sweep in all_sweeps()}
    thrust = [p.test.task.team[-1] for p in sweeps["thrust"].points if p.belief == "exact"]
    assert [round(v.thrust_to_weight, 2) for v in thrust[:3]] == [1.2, 1.3, 1.4]
    counts = [len(p.test.task.team) - 1 for p in sweeps["neighbours"].points]
    assert counts == [int(p.value) for p in sweeps["neighbours"].points]
    planes = sweeps["plane distance"].points
    for p in planes:
        assert isinstance(p.test.task, SwapTask)
        assert p.test.task.stacked.gap_m == (p.value, p.value)
    assert len(planes) == 36
    for sweep in sweeps.values():
        for p, q in itertools.combinations(sweep.points, 2):
            assert p.cell != q.cell or replace(p, value=q.value) == q
    for p in sweeps["velocity noise"].points:
        assert p.imperfection.velocity_noise == pytest.approx(0.01 * p.value)
    assert all(
        p.imperfection == Imperfection() for p in sweeps["noise"].points if p.belief == "none"
    )


def test_harm_is_found_where_the_lines_cross():
    scale = next(sweep for sweep in all_sweeps() if sweep.name == "scale")
    points = [p for p in scale.points if p.case == "S2S" and p.value in (1.0, 2.0, 2.5)]
    after = {1.0: 2.0, 2.0: 8.0, 2.5: 14.0}
    cells = {
        p.cell: {"worst_cm": [10.0, 10.0] if p.belief == "none" else [after[p.value]] * 2,
                 "crashed": 0}
        for p in points
    }  # fmt: skip
    sweep = Sweep("scale", "", points)
    rows = sweep_rows(sweep, cells)
    assert [row["ratio"] for row in rows] == [0.2, 0.8, 1.4]
    assert [row["made_worse"] for row in rows] == [0, 0, 2]
    found = {"sweep": "scale", "case": "S2S", "belief": "exact", "side": "above"}
    assert harmful_values(sweep, rows) == [
        {**found, "value": pytest.approx(2.0 + 0.5 / 3, abs=1e-3)}
    ]
