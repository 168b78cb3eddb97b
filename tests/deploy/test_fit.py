"""Fits of known curves: exact where that is possible, within tolerance and smooth elsewhere."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from swarm_envs.deploy import Pieces, evaluate, fit_pieces
from swarm_envs.deploy.fit import YAW_TOLERANCE
from swarm_envs.deploy.pieces import largest_jump
from swarm_envs.state import FloatArray


def helix(time: FloatArray, speed: float = 1.0) -> FloatArray:
    """(T, 4) a circle of 1 m that climbs, nose along the way."""
    angle = speed * time
    return np.column_stack([np.cos(angle), np.sin(angle), 1.0 + 0.1 * time, angle])


def independent(pieces: Pieces, time: FloatArray) -> FloatArray:
    """(T, 4) by numpy's polynomials."""
    knots = np.concatenate([[0.0], np.cumsum(pieces.duration)])
    which = np.clip(np.searchsorted(knots, time, side="right") - 1, 0, len(pieces) - 1)
    return np.array(
        [
            [np.polynomial.Polynomial(c)(t - knots[k]) for c in pieces.coefficients[k]]
            for t, k in zip(time, which, strict=True)
        ]
    )


@pytest.mark.parametrize("tolerance", [0.1, 0.01, 0.001])
def test_a_helix_is_followed(tolerance: float) -> None:
    time = np.linspace(0.0, 20.0, 4001)
    pieces = fit_pieces(time, helix(time), tolerance)
    gap = independent(pieces, time) - helix(time)
    assert np.linalg.norm(gap[:, :3], axis=1).max() <= tolerance
    assert np.abs(gap[:, 3]).max() <= YAW_TOLERANCE
    assert pieces.total_s == pytest.approx(20.0, abs=1e-5)


def test_a_smaller_tolerance_takes_more_pieces() -> None:
    time = np.linspace(0.0, 20.0, 4001)
    counts = [len(fit_pieces(time, helix(time), tol)) for tol in (0.1, 0.01, 0.001)]
    assert counts == sorted(counts)
    assert counts[0] < counts[-1] <= 8


def test_velocity_and_acceleration_are_those_of_the_helix() -> None:
    time = np.linspace(0.0, 10.0, 2001)
    pieces = fit_pieces(time, helix(time), 1e-3)
    inner = time[100:-100]
    sine, cosine = np.sin(inner), np.cos(inner)
    velocity, acceleration = (evaluate(pieces, inner, k)[:, :2] for k in (1, 2))
    np.testing.assert_allclose(velocity, np.column_stack([-sine, cosine]), atol=0.01)
    np.testing.assert_allclose(acceleration, -np.column_stack([cosine, sine]), atol=0.05)


def test_a_polynomial_of_7th_degree_is_one_piece_with_its_coefficients() -> None:
    time = np.linspace(0.0, 2.0, 401)
    wanted = np.random.default_rng(0).normal(size=(4, 8)) / 2.0 ** np.arange(8)
    rows = np.column_stack([np.polynomial.polynomial.polyval(time, c) for c in wanted])
    pieces = fit_pieces(time, rows, 1e-4)
    assert len(pieces) == 1
    np.testing.assert_allclose(pieces.coefficients[0], wanted, atol=1e-6)


def test_a_polynomial_that_rests_at_both_ends_is_exact_too() -> None:
    time = np.linspace(0.0, 3.0, 601)
    u = time / 3.0
    blend = u**4 * (35.0 - 84.0 * u + 70.0 * u**2 - 20.0 * u**3)
    rows = np.column_stack([blend, -2.0 * blend, 1.0 + 0.5 * blend, 0.0 * u])
    pieces = fit_pieces(time, rows, 1e-4, rests=(True, True))
    assert len(pieces) == 1
    np.testing.assert_allclose(independent(pieces, time), rows, atol=1e-5)
    for t in (0.0, pieces.total_s):
        for derivative in (1, 2):
            assert np.abs(evaluate(pieces, t, derivative)).max() < 1e-4


def test_pieces_join_smoothly() -> None:
    time = np.linspace(0.0, 12.0, 2401)
    pieces = fit_pieces(time, helix(time, 2.5), 1e-3)
    assert len(pieces) > 3
    # Single precision leaves rounding, which grows with the derivative.
    for derivative, jump in enumerate((1e-5, 1e-4, 1e-3, 1e-2)):
        assert largest_jump(pieces, derivative) < jump
    assert largest_jump(pieces, 5) > 0.1  # it could not do without pieces


def test_too_few_pieces_are_refused_with_what_they_reach() -> None:
    time = np.linspace(0.0, 20.0, 4001)
    with pytest.raises(ValueError, match=r"2 pieces come within \d+\.\d mm .* tolerance is 1\.0"):
        fit_pieces(time, helix(time, 3.0), 1e-3, most=2)


@settings(max_examples=15)
@given(st.integers(0, 2**32 - 1), st.floats(0.6, 12.0))
def test_any_smooth_flight_is_followed(seed: int, duration: float) -> None:
    rng = np.random.default_rng(seed)
    time = np.linspace(0.0, duration, max(int(200 * duration), 40))
    waves = rng.uniform(0.2, 3.0, (4, 4))
    phases, sizes = rng.uniform(0.0, 6.3, (4, 4)), rng.uniform(-0.4, 0.4, (4, 4))
    rows = (sizes * np.sin(waves * time[:, None, None] + phases)).sum(axis=-1)
    pieces = fit_pieces(time, rows, 0.02)
    gap = independent(pieces, time) - rows
    assert np.linalg.norm(gap[:, :3], axis=1).max() <= 0.0201
    assert pieces.total_s == pytest.approx(duration, abs=1e-5)
    assert largest_jump(pieces, 2) < 0.05
