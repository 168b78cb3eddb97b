"""Studies of the controller: lag compensation, the ball of Theorem 5, where compensation ends."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from swarm_envs.baselines.neural_swarm.flights import fly, swap_test
from swarm_envs.baselines.neural_swarm.theorem import (
    clamped_radius,
    error_ball,
    error_envelope,
    fly_point_mass,
    integral_force,
    without_clamp,
)
from swarm_envs.control.config import GAINS, MID, ControllerConfig, PositionGains
from swarm_envs.interactions import InteractionModel, load
from swarm_envs.tasks.swap import SwapTask
from swarm_envs.training.reproduce.ball_study import fly_quadrotors, growing_error, random_errors
from swarm_envs.training.reproduce.imperfect_flights import (
    Imperfection,
    fly_imperfectly,
    slow_noise,
)
from swarm_envs.training.reproduce.limits_study import Sweep, all_sweeps, harmful_values, sweep_rows
from swarm_envs.vehicles import GRAM_FORCE, GRAVITY, LARGE, SMALL
from tests.helpers.papers import run_quietly


def test_lag_compensation_cuts_the_compensated_error_to_a_quarter(tmp_path):
    asked = {"study": "lag", "episodes": 4, "engine": "batch", "out": tmp_path}
    summary, said = run_quietly("neural-swarm2", seed=3, **asked)
    assert set(summary["reductions"]["exact"]) == {"soft", "mid", "stiff"}
    assert min(summary["reductions"]["exact"].values()) >= 4.0
    assert all(1.05 < ratio < 1.4 for ratio in summary["reductions"]["none"].values())
    median = {(r["gains"], r["force"], r["lag"]): r["median_cm"] for r in summary["rows"]}
    for force in ("exact", "none"):
        soft, mid, stiff = (median[g, force, "not compensated"] for g in ("soft", "mid", "stiff"))
        assert soft > mid > stiff
    assert not any(row["crashed"] for row in summary["rows"])
    assert f"{summary['reductions']['exact']['mid']:.1f}" in said


@pytest.mark.slow
@pytest.mark.parametrize("engine", ["batch", "bullet"])
def test_the_claim_on_twenty_swaps(engine, tmp_path):
    if engine == "bullet":
        pytest.importorskip("pybullet")
    asked = {"study": "lag", "episodes": 20, "engine": engine, "out": tmp_path}
    summary, _ = run_quietly("neural-swarm2", **asked)
    assert min(summary["reductions"]["exact"].values()) >= 20.0


DT = 1.0 / 240.0
RATE = 0.5 * GRAM_FORCE

gains = st.builds(
    PositionGains,
    position=st.floats(0.8, 3.0),
    velocity=st.floats(0.8, 5.0),
    integral=st.floats(0.4, 2.0),
)
start = st.tuples(*[st.floats(-0.4, 0.4)] * 3)


def norms(errors):
    return np.linalg.norm(errors, axis=-1)


@settings(max_examples=10)
@given(gains, st.sampled_from((SMALL, LARGE)), start, start, st.integers(0, 2**32 - 1))
def test_errors_stay_under_the_envelope_and_end_in_the_ball(gain, vehicle, off, moving, seed):
    rate, steps = 0.02 * vehicle.mass * GRAVITY, round(8.0 / DT)
    rng = np.random.default_rng(seed)
    planted = random_errors(rng, 1, steps, 0.1 * vehicle.mass * GRAVITY, rate)[0]
    assert norms(planted).max() <= 0.1 * vehicle.mass * GRAVITY * (1.0 + 1e-9)
    assert norms(np.diff(planted, axis=0)).max() <= rate * DT * (1.0 + 1e-9)
    config = without_clamp(ControllerConfig(gain, min_vertical_thrust_fraction=1e-9))
    found = norms(fly_point_mass(vehicle, config, planted, DT, off, moving))
    time = DT * np.arange(steps + 1)
    bound = error_envelope(gain, vehicle.mass, rate, time, off, moving)
    # A law sampled at 240 Hz falls behind the continuous one by half a sample.
    assert (found <= 1.02 * bound + 1e-3 * bound[0]).all()


@pytest.mark.parametrize("name", GAINS)
def test_a_growing_error_comes_as_close_as_one_waits(name):
    gain, ball = GAINS[name], error_ball(GAINS[name], SMALL.mass, RATE)
    planted = growing_error(round(12.0 / ball.rate / DT), RATE)
    config = without_clamp(ControllerConfig(gain))
    found = norms(fly_point_mass(SMALL, config, planted, DT))
    assert 0.999 * ball.radius < found[-1] <= ball.radius
    bound = error_envelope(gain, SMALL.mass, RATE, DT * np.arange(len(found)))
    assert (found <= bound * (1.0 + 1e-6) + 1e-9).all()
    assert (found[1000:] > 0.98 * bound[1000:]).all()


def test_the_envelope_solves_the_equations_of_the_proof():
    mass, push = 0.034, 0.02

    def flow(t, x):
        p, first, second = x
        return [
            first - MID.position * p,
            second / mass - MID.velocity * first,
            RATE - MID.integral * second,
        ]

    first = 0.1 + MID.position * 0.3
    second = push - mass * MID.integral * first
    time = np.linspace(0.0, 6.0, 40)
    solved = solve_ivp(flow, (0.0, 6.0), [0.3, first, abs(second)], t_eval=time, rtol=1e-9)
    found = error_envelope(MID, mass, RATE, time, (0.3, 0, 0), (0.1, 0, 0), (push, 0, 0))
    assert found == pytest.approx(solved.y[0], rel=1e-5)


def test_a_clamped_integral_voids_the_ball():
    """Beyond what the clamp holds a standing error remains, of known size."""
    config = ControllerConfig(velocity_integral_limit=0.05)
    push = 5.0 * GRAM_FORCE
    held = integral_force(config, SMALL.mass)
    assert held == pytest.approx(0.22 * GRAM_FORCE, rel=0.02)
    planted = np.tile([0.0, 0.0, -push], (round(10.0 / DT), 1))
    found = fly_point_mass(SMALL, config, planted, DT)
    stiffness = MID.position * SMALL.mass * (MID.velocity + MID.integral)
    assert found[-1, 2] == pytest.approx(-(push - held) / stiffness, rel=1e-3)
    assert np.abs(found).max() <= clamped_radius(config, SMALL.mass, push)
    free = fly_point_mass(SMALL, without_clamp(config), planted, DT)
    assert abs(free[-1, 2]) < 0.05 * abs(found[-1, 2])  # eq. (23): a constant error leaves nothing


def test_the_quadrotor_ends_in_the_same_ball():
    steps = round(12.0 / DT)
    planted = np.concatenate(
        [
            growing_error(steps, RATE)[None],
            random_errors(np.random.default_rng(0), 4, steps, 5.0 * GRAM_FORCE, RATE),
        ]
    )
    config = without_clamp(ControllerConfig(GAINS["stiff"]))
    found = norms(fly_quadrotors(SMALL, config, planted))
    radius = error_ball(GAINS["stiff"], SMALL.mass, RATE).radius
    assert found[0, -1] == pytest.approx(radius, rel=0.01)
    assert found[1:].max() < 1.01 * radius


def test_errors_to_plant_are_checked():
    with pytest.raises(ValueError, match="force_errors"):
        fly_quadrotors(SMALL, ControllerConfig(), np.full((1, 5, 3), np.nan))


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
            assert p.cell != q.cell or p._replace(value=q.value) == q
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
