"""Polynomial pieces: evaluation and fits against numpy's polynomials, files read back."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from swarm_envs.deploy import Pieces, evaluate, read_pieces
from swarm_envs.deploy.pieces import (
    HEADER,
    MOST_PIECES,
    PIECE_BYTES,
    YAW_TOLERANCE,
    fit_pieces,
    largest_jump,
    write_pieces,
)
from swarm_envs.state import FloatArray


def random_pieces(rng: np.random.Generator, count: int = 3) -> Pieces:
    """Pieces that do not even join."""
    scale = 0.5 ** np.arange(8)
    return Pieces(rng.uniform(0.3, 1.5, count), rng.normal(size=(count, 4, 8)) * scale)


def independent(pieces: Pieces, time: FloatArray, derivative: int = 0) -> FloatArray:
    """(T, 4) by numpy's polynomials."""
    knots = np.concatenate([[0.0], np.cumsum(pieces.duration)])
    which = np.clip(np.searchsorted(knots, time) - 1, 0, len(pieces) - 1)
    polynomials = [
        [np.polynomial.Polynomial(c).deriv(derivative) for c in piece]
        for piece in pieces.coefficients
    ]
    return np.array(
        [[p(t - knots[k]) for p in polynomials[k]] for t, k in zip(time, which, strict=True)]
    )


def test_evaluation_is_numpy_s() -> None:
    pieces = random_pieces(np.random.default_rng(0))
    time = np.append(np.linspace(0.0, pieces.total_s, 29), pieces.knots)  # knots: the earlier one
    for derivative in range(9):
        expected = independent(pieces, time, derivative)
        np.testing.assert_allclose(evaluate(pieces, time, derivative), expected, atol=1e-9)


def test_it_rests_before_and_after_as_the_firmware_does() -> None:
    pieces = random_pieces(np.random.default_rng(1))
    outside = np.array([-1.0, pieces.total_s + 5.0])
    ends = independent(pieces, np.array([0.0, pieces.total_s]))
    np.testing.assert_allclose(evaluate(pieces, outside), ends, atol=1e-9)
    assert not evaluate(pieces, outside, 1).any()


def test_jumps_are_those_of_the_coefficients() -> None:
    one = np.zeros((2, 4, 8))
    one[0, 0, 1], one[1, 0, 0], one[1, 1, 1] = 1.0, 1.5, 2.0  # x = t; then x = 1.5, y = 2 t
    pieces = Pieces(np.ones(2), one)
    assert largest_jump(pieces) == pytest.approx(0.5)
    assert largest_jump(pieces, 1) == pytest.approx(np.hypot(1.0, 2.0))


def test_a_file_is_read_back_to_the_last_bit(tmp_path: Path) -> None:
    pieces = random_pieces(np.random.default_rng(2), 5)
    write_pieces(tmp_path / "a.csv", pieces)
    again = read_pieces(tmp_path / "a.csv")
    np.testing.assert_array_equal(again.duration, pieces.duration)
    np.testing.assert_array_equal(again.coefficients, pieces.coefficients)
    # What `uav_trajectories` and Crazyswarm read it with.
    path, every = tmp_path / "a.csv", range(33)
    table = np.loadtxt(path, delimiter=",", skiprows=1, usecols=every, dtype=np.float32)
    np.testing.assert_array_equal(table[:, 0], pieces.duration)
    np.testing.assert_array_equal(table[:, 1:], pieces.coefficients.reshape(-1, 32))


def test_files_of_others_are_read(tmp_path: Path) -> None:
    head, row = ",".join(HEADER), ",".join(["1.05", *["0.5"] * 32])
    for text in (f"{head},\n{row},\n", f"# {head.lower()}\n{row}\n\n", f"{head}\r\n{row}\r\n"):
        (tmp_path / "b.csv").write_text(text)
        assert read_pieces(tmp_path / "b.csv").duration[0] == np.float32(1.05)


def test_memory_is_that_of_the_firmware() -> None:
    assert (struct.calcsize("<33f"), 4096 // 132) == (PIECE_BYTES, MOST_PIECES)
    assert (HEADER[0], HEADER[1:9], HEADER[-1]) == (
        "Duration",
        tuple(f"x^{k}" for k in range(8)),
        "yaw^7",
    )


@pytest.mark.parametrize(
    ("rows", "said"),
    [
        ("", "no piece"),
        ("1,2,3", "line 2: 3 numbers, but must be 33"),
        (",".join(["one", *["0"] * 32]), "line 2: could not convert"),
        (",".join(["0", *["0"] * 32]), "duration of piece 0 has 0.0"),
        (",".join(["1", *["nan"] * 32]), "coefficients of piece 0"),
        (",".join(["1", *["1e39"] * 32]), "finite in single precision"),
    ],
)
def test_bad_files_are_refused(rows: str, said: str, tmp_path: Path) -> None:
    path, head = tmp_path / "c.csv", ",".join(HEADER) + "\n"
    path.write_text(head + rows + "\n")
    with pytest.raises(ValueError, match=said):
        read_pieces(path)
    path.write_text(rows)  # without the header
    with pytest.raises(ValueError, match=r"c\.csv begins with"):
        read_pieces(path)


def test_bad_pieces_are_refused() -> None:
    with pytest.raises(ValueError, match="at least one piece"):
        Pieces(np.zeros(0), np.zeros((0, 4, 8)))
    with pytest.raises(ValueError, match=r"coefficients \(1, 3, 8\)"):
        Pieces(np.ones(1), np.zeros((1, 3, 8)))
    with pytest.raises(ValueError, match="derivative is -1"):
        evaluate(Pieces(np.ones(1), np.zeros((1, 4, 8))), 0.0, -1)


def helix(time: FloatArray, speed: float = 1.0) -> FloatArray:
    """(T, 4) a circle of 1 m that climbs, nose along the way."""
    angle = speed * time
    return np.column_stack([np.cos(angle), np.sin(angle), 1.0 + 0.1 * time, angle])


def test_a_helix_is_followed_and_a_smaller_tolerance_takes_more_pieces() -> None:
    time, counts = np.linspace(0.0, 20.0, 4001), []
    for tolerance in (0.1, 0.01, 0.001):
        pieces = fit_pieces(time, helix(time), tolerance)
        gap = independent(pieces, time) - helix(time)
        assert np.linalg.norm(gap[:, :3], axis=1).max() <= tolerance
        assert np.abs(gap[:, 3]).max() <= YAW_TOLERANCE
        assert pieces.total_s == pytest.approx(20.0, abs=1e-5)
        counts.append(len(pieces))
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
    for derivative in (1, 2):
        assert np.abs(evaluate(pieces, [0.0, pieces.total_s], derivative)).max() < 1e-4


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
