"""Polynomial pieces as a Crazyflie flies them: their CSV files, and their fit to a curve.

A trajectory is a sequence of polynomials of 7th degree in x, y, z (m, world frame) and yaw (rad),
in the time since the start of each piece, s. The file is that of `uav_trajectories`, which cflib's
examples and Crazyswarm read; the firmware holds all numbers in single precision, and so do we.

Fitted pieces are a spline whose third derivative is continuous, so that not even body rates jump at
a knot. Splines with this property are all sums of B-splines with inner knots of multiplicity four
(de Boor, A Practical Guide to Splines, ch. IX): least squares over them need no constraint.
"""

from __future__ import annotations

import csv
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import numpy.typing as npt

from swarm_envs.arguments import Range, typed
from swarm_envs.files import written_whole
from swarm_envs.state import FloatArray

DEGREE = 7  # Of every polynomial
AXES = ("x", "y", "z", "yaw")  # In the order of the file, and of the firmware's memory
PIECE_BYTES = 132  # What a piece takes of the firmware's memory: 33 numbers of 4 bytes
MEMORY_BYTES = 4096
"""The firmware's memory for trajectories (`TRAJECTORY_MEMORY_SIZE`), which all of them share."""
MOST_PIECES = MEMORY_BYTES // PIECE_BYTES  # Pieces that fit into it: 31
HEADER = ("Duration", *(f"{axis}^{power}" for axis in AXES for power in range(DEGREE + 1)))
"""First line of the file."""


@dataclass(frozen=True, eq=False)
class Pieces:
    """A trajectory of one drone, P pieces one after the other. World frame, SI.

    Args:
        duration: (P,) s.
        coefficients: (P, 4, 8) of x, y, z and yaw, by ascending powers of time.

    Raises:
        ValueError: wrong shapes, no piece, a number that is not finite, or a duration that is not
            positive; the message names the piece.
    """

    duration: FloatArray
    coefficients: FloatArray

    def __post_init__(self) -> None:
        """Check, round to single precision as the firmware does, and freeze."""
        duration, values = np.asarray(self.duration), np.asarray(self.coefficients)
        wanted = (len(duration) if duration.ndim == 1 else 0, len(AXES), DEGREE + 1)
        if not wanted[0] or values.shape != wanted:
            raise ValueError(
                f"durations have shape {duration.shape} and coefficients {values.shape}, but must "
                f"have (P,) and (P, {len(AXES)}, {DEGREE + 1}) with at least one piece"
            )
        object.__setattr__(self, "duration", _single("duration", duration, positive=True))
        object.__setattr__(self, "coefficients", _single("coefficients", values))

    def __len__(self) -> int:
        """How many pieces there are."""
        return len(self.duration)

    @property
    def total_s(self) -> float:
        """Duration of the whole, s."""
        return float(self.duration.sum())

    @property
    def knots(self) -> FloatArray:
        """(P + 1,) times at which pieces begin, and the end, s."""
        return np.concatenate([[0.0], np.cumsum(self.duration)])


def _single(name: str, values: npt.NDArray[Any], positive: bool = False) -> FloatArray:
    """Values, one row a piece, rounded to single precision and read-only."""
    with np.errstate(over="ignore"):
        rounded: FloatArray = values.astype(np.float32).astype(np.float64)
    bad = ~np.isfinite(rounded) | (positive & ~(rounded > 0.0))
    if bad.any():
        at = tuple(np.argwhere(bad)[0])
        rule = "finite in single precision" + (" and positive" if positive else "")
        raise ValueError(f"{name} of piece {at[0]} has {values[at]}, but must be {rule}")
    rounded.flags.writeable = False
    return rounded


@typed
def evaluate(
    pieces: Pieces,
    time: npt.ArrayLike,
    derivative: Annotated[int, Range(0, DEGREE + 1)] = 0,
    single: bool = False,
) -> FloatArray:
    """Where the drone should be, x, y, z (m) and yaw (rad), or a derivative of that: (..., 4).

    As in the firmware (`piecewise_eval`), it rests where it ends; before the start it rests too.
    At a knot the earlier piece counts.

    Args:
        pieces: the trajectory.
        time: (...) s since the start.
        derivative: 0 for position, 1 for velocity, and so on.
        single: calculate in single precision, as the firmware does.

    Raises:
        ValueError: the derivative is negative or more than one above the degree, or a time is NaN.
    """
    asked, knots = np.asarray(time, dtype=np.float64), pieces.knots
    if np.isnan(asked).any():
        raise ValueError(f"time is {time!r:.80}, but must hold no NaN")
    inside = np.clip(asked, 0.0, knots[-1])
    which = np.clip(np.searchsorted(knots, inside, side="left") - 1, 0, len(pieces) - 1)
    dtype = np.float32 if single else np.float64
    t = (inside - knots[which]).astype(dtype)[..., None]
    values: npt.NDArray[Any] = pieces.coefficients[which].astype(dtype)
    for _ in range(derivative):
        values = values[..., 1:] * np.arange(1, values.shape[-1], dtype=dtype)
    out = np.zeros(values.shape[:-1], dtype)
    for power in range(values.shape[-1] - 1, -1, -1):
        out = out * t + values[..., power]
    if derivative:
        out = out * ((asked >= 0.0) & (asked <= knots[-1]))[..., None]
    return out.astype(np.float64)


def largest_jump(pieces: Pieces, derivative: int = 0) -> float:
    """Largest jump of position (m) or one of its derivatives from a piece to the next."""
    if len(pieces) == 1:
        return 0.0
    ends = np.array(
        [
            evaluate(Pieces(pieces.duration[k : k + 1], c[None]), pieces.duration[k], derivative)
            for k, c in enumerate(pieces.coefficients[:-1])
        ]
    )
    factorial = float(np.prod(np.arange(1, derivative + 1)))
    begins = pieces.coefficients[1:, :, derivative] * factorial
    return float(np.linalg.norm((ends - begins)[:, :3], axis=1).max())


def write_csv(path: Path, head: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    """Write a head and rows as CSV, whole or not at all."""
    with written_whole(path) as partial, partial.open("w", encoding="utf-8", newline="") as file:
        csv.writer(file, lineterminator="\n").writerows([head, *rows])


def write_pieces(path: str | Path, pieces: Pieces) -> None:
    """Write the CSV file, so that it is read back to the last bit."""
    rows = np.concatenate([pieces.duration[:, None], pieces.coefficients.reshape(-1, 32)], axis=1)
    write_csv(Path(path), HEADER, [[str(value) for value in row] for row in rows.astype("f4")])


@typed
def read_pieces(path: str | Path) -> Pieces:
    """Read a CSV file of `write_pieces`, `uav_trajectories` or Crazyswarm.

    Raises:
        ValueError: another header, or a line that is not 33 finite numbers with a positive
            duration first; the message names the file and the line.
        OSError: the file cannot be read.
    """
    if not Path(path).is_file():
        raise FileNotFoundError(f"path is {str(path)!r:.80}, but must be a file of pieces, .csv")
    # Bytes that are no text are replaced, and refused with the header or the number they are in.
    with Path(path).open(encoding="utf-8", errors="replace", newline="") as file:
        lines = [[cell.strip() for cell in row] for row in csv.reader(file) if any(row)]
    lines = [row[:-1] if row[-1] == "" else row for row in lines]  # Crazyswarm ends with a comma
    head = [cell.lower().lstrip("# ") for cell in lines[0]] if lines else []
    if head != [cell.lower() for cell in HEADER]:
        raise ValueError(f"{path} begins with {','.join(head)!r:.60}, not with {HEADER[0]},x^0,...")
    rows = [_row(path, number, row) for number, row in enumerate(lines[1:], start=2)]
    if not rows:
        raise ValueError(f"{path} holds no piece, only a header")
    table = np.array(rows)
    try:
        return Pieces(table[:, 0], table[:, 1:].reshape(-1, len(AXES), DEGREE + 1))
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from error


def _row(path: str | Path, number: int, cells: list[str]) -> list[float]:
    if len(cells) != len(HEADER):
        raise ValueError(f"{path}, line {number}: {len(cells)} numbers, but must be {len(HEADER)}")
    try:
        return [float(cell) for cell in cells]
    except ValueError as error:
        raise ValueError(f"{path}, line {number}: {error}") from error


SMOOTH = 3  # Derivatives that are continuous at the knots
YAW_TOLERANCE = 0.05  # Largest deviation of yaw, rad
_TICK = 1e-3  # Knots stand on multiples of this, s
_SHORTEST = 0.05  # No piece is shorter, s


def fit_pieces(
    time: FloatArray,
    rows: FloatArray,
    tolerance: float = 0.01,
    most: int = MOST_PIECES,
    rests: tuple[bool, bool] = (False, False),
) -> Pieces:
    """Few pieces that stay within a tolerance (m) of a curve, calculated as the firmware does.

    Knots are spread so that every piece has its equal share of what single polynomials can follow;
    the least number that does is taken, and then every knot that can be spared is dropped. Times
    (T,) ascend from 0, dense enough to show the curve; rows (T, 4) are x, y, z and yaw, which keeps
    to `YAW_TOLERANCE`. `rests`: whether velocity and acceleration are held at zero at start and
    end.
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
    q, _ = np.linalg.qr(basis)  # what is left off its columns no polynomial of this degree gives
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
