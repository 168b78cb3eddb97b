"""Polynomial pieces fitted to a curve: few of them, smooth from one to the next.

The pieces are a spline of 7th degree whose third derivative is continuous, so that not even body
rates jump at a knot. Splines with this property are all sums of B-splines with inner knots of
multiplicity four (de Boor, A Practical Guide to Splines, ch. IX): least squares over them need no
constraint.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from swarm_envs.deploy.pieces import DEGREE, MOST_PIECES, Pieces, evaluate
from swarm_envs.state import FloatArray

SMOOTH = 3
"""Derivatives that are continuous at the knots."""
YAW_TOLERANCE = 0.05
"""Largest deviation of yaw, rad."""
_TICK = 1e-3
"""Knots stand on multiples of this, s."""
_SHORTEST = 0.05
"""No piece is shorter, s."""


def fit_pieces(
    time: FloatArray,
    rows: FloatArray,
    tolerance: float = 0.01,
    most: int = MOST_PIECES,
    rests: tuple[bool, bool] = (False, False),
) -> Pieces:
    """Few pieces that stay within a tolerance of a curve, calculated as the firmware does.

    Knots are spread so that every piece has its equal share of what single polynomials can follow;
    the least number that does is taken, and then every knot that can be spared is dropped.

    Args:
        time: (T,) s, ascending from 0, dense enough to show the curve.
        rows: (T, 4) x, y, z (m), yaw (rad).
        tolerance: largest distance from the curve, m; yaw keeps to `YAW_TOLERANCE`.
        most: pieces that may be used.
        rests: whether velocity and acceleration are held at zero at the start and the end.

    Raises:
        ValueError: so many pieces do not reach the tolerance; the message says how close they come.
    """
    effort = _effort(time, rows, tolerance)
    best, closest = np.inf, None
    for count in range(1, most + 1):
        knots = _spread(effort, time, count)
        if len(knots) - 1 < count and closest is not None:
            break  # shorter pieces are not to be had
        pieces = _spline(time, rows, knots, rests)
        excess = _excess(pieces, time, rows, tolerance)
        if excess < best:
            best, closest = excess, pieces
        if excess <= 1.0:
            return _spare(pieces, time, rows, tolerance, rests)
    raise ValueError(
        f"{most} pieces come within {best * tolerance * 1e3:.1f} mm of the path at best (or yaw "
        f"within {best * YAW_TOLERANCE:.2f} rad), but the tolerance is {tolerance * 1e3:.1f} mm; "
        "allow a larger tolerance, or export a part of the flight (--begin-s, --end-s)"
    )


def deviations(pieces: Pieces, time: FloatArray, rows: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Distance (T,) from a curve's positions, m, and from its yaw, rad, in single precision."""
    gap = evaluate(pieces, time, single=True) - rows
    return np.linalg.norm(gap[:, :3], axis=1), np.abs(gap[:, 3])


def _excess(pieces: Pieces, time: FloatArray, rows: FloatArray, tolerance: float) -> float:
    """Largest deviation as a multiple of what is allowed."""
    distance, yaw = deviations(pieces, time, rows)
    return float(max(distance.max() / tolerance, yaw.max() / YAW_TOLERANCE))


def _effort(time: FloatArray, rows: FloatArray, tolerance: float) -> FloatArray:
    """(T,) how many polynomials, each as long as can be, follow the curve up to here."""
    effort, first = np.zeros(len(time)), 0
    scaled = rows / np.array([tolerance] * 3 + [YAW_TOLERANCE])
    count = 0
    while first < len(time) - 1:
        low, high = first + 1, len(time) - 1
        while low < high:  # the last sample that one polynomial reaches
            middle = (low + high + 1) // 2
            reached = _one_follows(time[first : middle + 1], scaled[first : middle + 1])
            low, high = (middle, high) if reached else (low, middle - 1)
        part = (time[first : low + 1] - time[first]) / (time[low] - time[first])
        effort[first : low + 1] = count + part
        first, count = low, count + 1
    return effort


def _one_follows(time: FloatArray, scaled: FloatArray) -> bool:
    if len(time) <= DEGREE + 1:
        return True
    u = 2.0 * (time - time[0]) / (time[-1] - time[0]) - 1.0
    basis = np.polynomial.chebyshev.chebvander(u, DEGREE)
    q, _ = np.linalg.qr(basis)
    rest = scaled - q @ (q.T @ scaled)
    return bool(max(np.linalg.norm(rest[:, :3], axis=1).max(), np.abs(rest[:, 3]).max()) <= 1.0)


def _spread(effort: FloatArray, time: FloatArray, count: int) -> FloatArray:
    """(up to count + 1,) knots with equal effort between them, none too close together."""
    shares = np.linspace(0.0, effort[-1], count + 1)[1:-1]
    inner = np.round(np.interp(shares, effort, time) / _TICK) * _TICK
    knots = [0.0]
    for knot in inner:
        if knot - knots[-1] >= _SHORTEST and time[-1] - knot >= _SHORTEST:
            knots.append(float(knot))
    return np.array([*knots, time[-1]])


def _spline(time: FloatArray, rows: FloatArray, knots: FloatArray, rests: Sequence[bool]) -> Pieces:
    """The smooth spline with these knots that is nearest in the mean square."""
    from scipy.interpolate import BSpline

    inner = np.repeat(knots[1:-1], DEGREE - SMOOTH)
    places = np.concatenate([[knots[0]] * (DEGREE + 1), inner, [knots[-1]] * (DEGREE + 1)])
    basis = BSpline.design_matrix(time, places, DEGREE).toarray()
    # At an end the first three control points are one where velocity and acceleration vanish.
    tie = np.eye(basis.shape[1])
    for at_end, rest in enumerate(rests):
        if rest:
            ends = [-1, -2, -3] if at_end else [0, 1, 2]
            tie[:, ends[0]] = tie[:, ends].sum(axis=1)
    kept = np.ones(len(tie), bool)
    kept[1:3], kept[-3:-1] = not rests[0], not rests[1]
    tie = tie[:, kept]
    control = tie @ np.linalg.lstsq(basis @ tie, rows, rcond=None)[0]
    return _as_pieces(BSpline(places, control, DEGREE), knots)


def _as_pieces(spline: Any, knots: FloatArray) -> Pieces:
    powers, factorial = [spline(knots[:-1])], 1.0
    for order in range(1, DEGREE + 1):
        factorial *= order
        powers.append(spline(knots[:-1], nu=order) / factorial)
    return Pieces(np.diff(knots), np.stack(powers, axis=-1))


def _spare(
    pieces: Pieces, time: FloatArray, rows: FloatArray, tolerance: float, rests: Sequence[bool]
) -> Pieces:
    """Drop knots, one at a time, as long as the tolerance is kept."""
    knots, k = np.append(pieces.knots[:-1], time[-1]), 1
    while k < len(knots) - 1:
        fewer = np.delete(knots, k)
        trial = _spline(time, rows, fewer, rests)
        if _excess(trial, time, rows, tolerance) <= 1.0:
            knots, pieces = fewer, trial
        else:
            k += 1
    return pieces
