"""Networks on blocks of samples: precision, and that nobody sees who shares a block."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numba import njit

from swarm_envs.interactions import load
from swarm_envs.interactions.lanes import BLOCK_BYTES, affine
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


def compiled_affine(number: Any) -> Any:
    return njit(
        lambda w, inputs, outputs, a, b, low: affine(w, 3, inputs, outputs, a, b, number(low))
    )


@pytest.mark.parametrize(("number", "tolerance"), [(np.float64, 1e-13), (np.float32, 1e-5)])
def test_a_layer_of_any_size_is_the_matrix_product(number: Any, tolerance: float) -> None:
    """Outputs that fill no whole tile, one input, a layer that begins anywhere; nothing beside."""
    rng, lanes = np.random.default_rng(10), BLOCK_BYTES // number(0).itemsize
    run = compiled_affine(number)
    for inputs, outputs in ((1, 1), (6, 25), (3, 7), (40, 12), (20, 40), (5, 13)):
        matrix, bias = rng.normal(size=(inputs, outputs)), rng.normal(size=outputs)
        weights = np.concatenate([[9.0] * 3, matrix.ravel(), bias, [9.0]]).astype(number)
        x = rng.normal(size=(41, lanes)).astype(number)
        for low in (0.0, -np.inf):
            expected = np.maximum(matrix.T @ x[:inputs] + bias[:, None], low)
            for function in (run, run.py_func):
                y = np.full((42, lanes), 7.0, number)
                function(weights, inputs, outputs, x, y, low)
                np.testing.assert_allclose(y[:outputs], expected, rtol=0, atol=tolerance)
                assert (y[outputs:] == 7.0).all()


def test_nan_goes_through_a_layer() -> None:
    """As numpy's maximum has it: a ReLU must not make a force out of a broken state."""
    weights, x, y = np.ones(6 * 9 + 12), np.ones((6, 8)), np.zeros((9, 8))
    x[2, 3] = np.nan
    compiled_affine(np.float64)(weights, 6, 9, x, y, 0.0)
    assert np.isnan(y[:, 3]).all() and np.isfinite(np.delete(y, 3, axis=1)).all()
