"""Polynomial pieces: evaluation against numpy's polynomials, files read back, bad files refused."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest

from swarm_envs.deploy import Pieces, evaluate, read_pieces, write_pieces
from swarm_envs.deploy.pieces import HEADER, MOST_PIECES, PIECE_BYTES, largest_jump


def random_pieces(rng: np.random.Generator, count: int = 3) -> Pieces:
    """Pieces that do not even join."""
    scale = 0.5 ** np.arange(8)
    return Pieces(rng.uniform(0.3, 1.5, count), rng.normal(size=(count, 4, 8)) * scale)


def test_evaluation_is_numpy_s() -> None:
    pieces = random_pieces(np.random.default_rng(0))
    knots = np.concatenate([[0.0], np.cumsum(pieces.duration)])
    for derivative in range(9):
        for k in range(len(pieces)):
            time = np.linspace(knots[k] + 1e-6, knots[k + 1] - 1e-6, 7)
            expected = [
                np.polynomial.Polynomial(c).deriv(derivative)(time - knots[k])
                for c in pieces.coefficients[k]
            ]
            found = evaluate(pieces, time, derivative)
            np.testing.assert_allclose(found, np.transpose(expected), atol=1e-9)


def test_it_rests_before_and_after_as_the_firmware_does() -> None:
    pieces = random_pieces(np.random.default_rng(1))
    last = np.polynomial.polynomial.polyval(pieces.duration[-1], pieces.coefficients[-1].T)
    np.testing.assert_allclose(evaluate(pieces, pieces.total_s + 5.0), last, atol=1e-9)
    np.testing.assert_allclose(evaluate(pieces, -1.0), pieces.coefficients[0, :, 0])
    for time in (-1.0, pieces.total_s + 5.0):
        assert not evaluate(pieces, time, 1).any()
    # At a knot the earlier piece counts (`piecewise_eval` in pptraj.c).
    first = np.polynomial.polynomial.polyval(pieces.duration[0], pieces.coefficients[0].T)
    np.testing.assert_allclose(evaluate(pieces, pieces.duration[0]), first, atol=1e-9)


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
    table = np.loadtxt(
        tmp_path / "a.csv", delimiter=",", skiprows=1, usecols=range(33), dtype=np.float32
    )
    np.testing.assert_array_equal(table[:, 0], pieces.duration)
    np.testing.assert_array_equal(table[:, 1:], pieces.coefficients.reshape(-1, 32))


def test_files_of_others_are_read(tmp_path: Path) -> None:
    head, row = ",".join(HEADER), ",".join(["1.05", *["0.5"] * 32])
    for text in (f"{head},\n{row},\n", f"# {head.lower()}\n{row}\n\n", f"{head}\r\n{row}\r\n"):
        (tmp_path / "b.csv").write_text(text)
        assert read_pieces(tmp_path / "b.csv").duration[0] == np.float32(1.05)


def test_memory_is_that_of_the_firmware() -> None:
    assert struct.calcsize("<33f") == PIECE_BYTES
    assert MOST_PIECES == 31
    assert HEADER[0] == "Duration"
    assert HEADER[1:9] == tuple(f"x^{k}" for k in range(8))
    assert HEADER[-1] == "yaw^7"


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
    (tmp_path / "c.csv").write_text(",".join(HEADER) + "\n" + rows + "\n")
    with pytest.raises(ValueError, match=said):
        read_pieces(tmp_path / "c.csv")


def test_another_header_is_refused(tmp_path: Path) -> None:
    for text in ("", "time,x,y\n0,0,0\n"):
        (tmp_path / "d.csv").write_text(text)
        with pytest.raises(ValueError, match=r"d\.csv begins with"):
            read_pieces(tmp_path / "d.csv")


def test_bad_pieces_are_refused() -> None:
    with pytest.raises(ValueError, match="at least one piece"):
        Pieces(np.zeros(0), np.zeros((0, 4, 8)))
    with pytest.raises(ValueError, match=r"coefficients \(1, 3, 8\)"):
        Pieces(np.ones(1), np.zeros((1, 3, 8)))
    with pytest.raises(ValueError, match="derivative is -1"):
        evaluate(Pieces(np.ones(1), np.zeros((1, 4, 8))), 0.0, -1)
