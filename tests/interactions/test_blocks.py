"""Networks on blocks of samples: precision, and that nobody sees who shares a block."""

from __future__ import annotations

import numpy as np
import pytest
from numba import njit

from swarm_envs.interactions import load
from swarm_envs.interactions.lanes import affine
from swarm_envs.vehicles import GRAM_FORCE


def test_float32_agrees_to_a_thousandth_of_a_gram() -> None:
    """1e5 random states of the flight range, against the float64 networks."""
    rng = np.random.default_rng(8)
    model = load("learned")
    fast = model.with_precision("float32")
    position = rng.uniform([-0.3, -0.3, 0.05], [0.3, 0.3, 1.6], (25_000, 4, 3))
    velocity = rng.normal(0.0, 0.5, position.shape)
    expected = model.forces(position, velocity, "SLLS")
    rounded = fast.forces(position, velocity, "SLLS")
    assert 0.0 < np.abs(rounded - expected).max() < 1e-3 * GRAM_FORCE
    assert fast.with_precision("float64").field.weights.dtype == np.float64
    for name in ("none", "wake"):
        assert load(name).with_precision("float32").field is not None
    with pytest.raises(ValueError, match="unknown precision 'float16'"):
        model.with_precision("float16")


@pytest.mark.parametrize("precision", ["float64", "float32"])
def test_what_is_computed_together_never_shows(precision: str) -> None:
    """Other environments, and drones out of reach, do not change a bit of a drone's force."""
    model = load("learned").with_precision(precision)
    rng = np.random.default_rng(9)
    position = rng.uniform([-0.3, -0.3, 0.1], [0.3, 0.3, 1.3], (37, 3, 3))
    velocity = rng.normal(0.0, 0.3, position.shape)
    together = model.forces(position, velocity, "SLS")
    for e in range(len(position)):
        alone = model.forces(position[e : e + 1], velocity[e : e + 1], "SLS")
        np.testing.assert_array_equal(alone[0], together[e])
    far = np.concatenate([position[:, :1] + [9.0, 0.0, 0.0], position], axis=1)
    more = model.forces(far, np.concatenate([velocity[:, :1], velocity], axis=1), "LSLS")
    np.testing.assert_array_equal(more[:, 1:], together)


def test_the_layer_without_compilation_is_the_compiled_one() -> None:
    rng = np.random.default_rng(10)
    field, outputs = load("learned").field, 25
    x = rng.normal(size=(40, 8))
    plain, compiled = np.zeros((40, 8)), np.zeros((40, 8))
    affine(field.weights, 0, 6, outputs, x, plain, 0.0)
    njit(lambda w, a, b: affine(w, 0, 6, 25, a, b, 0.0))(field.weights, x, compiled)
    np.testing.assert_allclose(compiled, plain, rtol=0, atol=1e-14)
    assert plain[:outputs].any()
    assert not plain[outputs:].any()
