"""Table I of Neural-Swarm2: vehicles are identified by how they move."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from swarm_envs.training.reproduce.identified_vehicles import (
    fit_polynomial,
    mass_and_thrust,
    motor_rate,
)
from swarm_envs.vehicles import GRAM_FORCE, SMALL


def test_another_vehicle_is_recognised_by_how_it_moves():
    vehicle = replace(SMALL, mass=0.041, max_thrust=77 * GRAM_FORCE, motor_rate=23.0)
    mass, thrust = mass_and_thrust(vehicle)
    assert mass == pytest.approx(41.0, rel=1e-6)
    assert thrust == pytest.approx(77.0, rel=1e-6)
    assert motor_rate(vehicle) == pytest.approx(23.0, rel=1e-6)


def test_a_polynomial_is_found_with_its_errors():
    rng = np.random.default_rng(3)
    x, v = rng.uniform(0.3, 1.0, (2, 4000))
    wanted = np.array([11.0, -39.0, -9.5, 20.6, 38.4])
    exact = wanted @ [np.ones_like(x), x, v, x * x, x * v]
    found, error = fit_polynomial(exact, x, v)
    np.testing.assert_allclose(found, wanted, rtol=1e-9)
    assert error.max() < 1e-8
    misses = []
    for _ in range(40):
        found, error = fit_polynomial(exact + rng.normal(0.0, 0.1, len(x)), x, v)
        misses.append((found - wanted) / error)
    assert 0.8 < np.std(misses) < 1.2  # standard errors are what estimates scatter by
