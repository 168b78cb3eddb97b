"""Theorem 5 of Neural-Swarm2: bounds of the position error against flights and its equations."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from examples.papers.neural_swarm2.ball import fly_quadrotors, growing_error, random_errors
from examples.papers.neural_swarm2.theorem import (
    clamped_radius,
    error_ball,
    error_envelope,
    fly_point_mass,
    integral_force,
    without_clamp,
)
from swarm_envs.control.config import GAINS, MID, ControllerConfig, PositionGains
from swarm_envs.vehicles import GRAM_FORCE, GRAVITY, LARGE, SMALL

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
        slopes = first - MID.position * p, second / mass - MID.velocity * first
        return [*slopes, RATE - MID.integral * second]

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
    random = random_errors(np.random.default_rng(0), 4, steps, 5.0 * GRAM_FORCE, RATE)
    planted = np.concatenate([growing_error(steps, RATE)[None], random])
    config = without_clamp(ControllerConfig(GAINS["stiff"]))
    found = norms(fly_quadrotors(SMALL, config, planted))
    radius = error_ball(GAINS["stiff"], SMALL.mass, RATE).radius
    assert found[0, -1] == pytest.approx(radius, rel=0.01)
    assert found[1:].max() < 1.01 * radius
