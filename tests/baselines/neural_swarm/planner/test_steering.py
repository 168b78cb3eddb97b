"""Bursts and coasting: against linear programs, and flown step by step."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import linprog

from swarm_envs.baselines.neural_swarm.planner.propagation import (
    impulse_cost,
    reach_burst,
    responses,
    rest_bursts,
)

DT, LIMIT, EDGE = 0.05, 5.0, 2
DRAGS = pytest.mark.parametrize("drag", [0.0, 0.43, 0.69])


def fly(drag, velocity, controls):
    """Place and speed (3,) after controls (K, 3), by the definition of the step."""
    p, v = np.zeros(3), np.array(velocity, dtype=np.float64)
    for u in controls:
        a = u - drag * v
        p, v = p + DT * v + 0.5 * DT * DT * a, v + DT * a
    return p, v


def cheapest(drag, steps, way, velocity):
    """Least sum |u| dt along a line from a velocity to rest, as a linear program over the steps."""
    nothing = np.zeros((steps, 3))
    p0, v0 = fly(drag, [velocity, 0.0, 0.0], nothing)
    columns = []
    for k in range(steps):
        unit = nothing.copy()
        unit[k, 0] = 1.0
        p, v = fly(drag, np.zeros(3), unit)
        columns.append((p[0], v[0]))
    matrix = np.array(columns).T
    result = linprog(
        np.full(2 * steps, DT),
        A_eq=np.hstack((matrix, -matrix)),
        b_eq=(way - p0[0], -v0[0]),
        bounds=(0.0, LIMIT),
    )
    return result.fun if result.success else np.inf


@DRAGS
def test_responses_are_those_of_the_step(drag):
    table = responses(np.full(3, drag), DT, 20)
    for k in (0, 1, 7, 20):
        for mode in (0, 1):
            pushes = np.full((k, 3), float(mode))
            p, v = fly(drag, np.full(3, 1.0 - mode), pushes)
            np.testing.assert_allclose(table[mode, k], (p, v), atol=1e-12)


@DRAGS
@pytest.mark.parametrize("velocity", [-1.0, 0.0, 0.7])
@pytest.mark.parametrize("way", [0.3, 1.5])
def test_two_impulses_are_a_lower_bound_and_a_tight_one(drag, velocity, way):
    steps = 60
    table = responses(np.full(3, drag), DT, steps)
    bound = impulse_cost(table, steps, np.array([way, 0, 0]), np.array([velocity, 0, 0]))
    optimum = cheapest(drag, steps, way, velocity)
    held = 1.0 - 0.5 * drag * DT  # a held control is not dragged within its step
    assert bound * held <= optimum + 1e-9
    assert optimum <= 1.12 * bound


@DRAGS
@pytest.mark.parametrize("velocity", [-0.5, 0.0, 0.7])
def test_two_bursts_cost_little_more_than_the_optimum(drag, velocity):
    """The program may push in every step, bursts only in whole edges, of one strength each."""
    edges, way, control = 25, 1.5, np.zeros(3)
    table = responses(np.full(3, drag), DT, edges * EDGE)
    at = np.array([way, 0.0, 0.0]), np.array([velocity, 0.0, 0.0])
    cost = rest_bursts(table, EDGE, edges, LIMIT, *at, control) * DT
    optimum = cheapest(drag, edges * EDGE, way, velocity)
    assert optimum - 1e-9 <= cost <= 1.08 * optimum


@DRAGS
def test_a_burst_and_coasting_lead_to_the_place(drag):
    edges, place, control = 10, np.array([0.5, -0.9, 0.2]), np.zeros(3)
    table = responses(np.full(3, drag), DT, edges * EDGE)
    velocity = np.array([0.3, 0.2, -0.4])
    assert reach_burst(table, EDGE, edges, LIMIT, place, velocity, control)
    flown = [
        fly(drag, velocity, np.vstack((np.tile(control, (on, 1)), np.zeros((20 - on, 3)))))[0]
        for on in range(EDGE, 21, EDGE)
    ]
    assert np.abs(np.array(flown) - place).max(axis=1).min() < 1e-9


def test_what_no_control_can_do_is_said():
    table, control = responses(np.zeros(3), DT, 20), np.zeros(3)
    far = np.array([9.0, 0.0, 0.0])
    assert not reach_burst(table, EDGE, 10, LIMIT, far, np.zeros(3), control)
    assert rest_bursts(table, EDGE, 10, LIMIT, far, np.zeros(3), control) == np.inf
