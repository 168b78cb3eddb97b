"""Convert a recorded flight into set-points and polynomial trajectories for Crazyflies.

    swarm-envs fly --layout stacked --team L2S --agent tracking --seed 1 --out flight
    python examples/crazyflie.py flight/trajectory.parquet --out real

writes for each drone of the flight

- `drone_0_setpoints.csv`: time, position, velocity, acceleration and yaw at a fixed rate, for a
  stream of full-state set-points (Crazyswarm's `cmdFullState`, cflib's
  `send_full_state_setpoint`);
- `drone_0.csv`: pieces of polynomials of 7th degree in the format of Crazyswarm's
  `uav_trajectories` (duration, then coefficients of x, y, z and yaw by ascending powers), which the
  firmware's high-level commander flies after one upload.

and prints for each drone the number of pieces, the largest distance between pieces and flight,
the largest speed and acceleration; then the least distance between the bodies of two drones on
these pieces. The exit status is 1 if bodies touch, and 2 after invalid input.

Pieces are a least-squares spline whose third derivative is continuous, so that the desired body
rates are continuous. The firmware stores 31 pieces of 132 bytes; for a flight that needs more, the
error message has the tolerance that 31 pieces reach. Positions are in meters in the world frame, z
pointing up; the positioning system must use the same frame. Fly a single drone first, with a net,
and place each drone at its start before the swarm takes off: the script does not check the
hardware.
"""

from __future__ import annotations

import csv
import math
import sys
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path
from typing import Annotated, NamedTuple

import numpy as np
import tyro
from scipy.interpolate import BSpline, CubicHermiteSpline, make_lsq_spline
from tqdm import tqdm

from swarm_envs.errors import check_number
from swarm_envs.viewing.record import Recording
from swarm_envs.viewing.trajectory import read_trajectory

DEGREE, MOST_PIECES = 7, 31  # degree of a piece; pieces in 4,096 bytes of the firmware
SMOOTH = 3  # derivatives that are continuous between pieces
HEADER = ("duration", *(f"{axis}^{k}" for axis in ("x", "y", "z", "yaw") for k in range(8)))
STATE = (*(f"{q}{axis}" for q in ("", "v", "a") for axis in "xyz"), "yaw")
DENSE = 240.0  # samples per second at which pieces are compared with the flight


@dataclass(frozen=True)
class Options:
    """Options of the conversion."""

    flight: Annotated[Path, tyro.conf.Positional]
    """trajectory file of `swarm-envs fly --out` or `write_trajectory`, .parquet or .npz"""
    out: Path = Path("real")
    """output folder"""
    rate: float = 100.0
    """set-points per second"""
    tolerance_m: float = 0.01
    """largest distance between pieces and flight, m"""

    def __post_init__(self) -> None:
        """Raise an error for invalid values."""
        check_number("--rate", self.rate, at_least=1.0, at_most=10_000.0)
        check_number("--tolerance-m", self.tolerance_m, above=0.0, unit="m")


class Pieces(NamedTuple):
    """The consecutive polynomials of one drone."""

    duration: np.ndarray  # (P,) s
    coefficients: np.ndarray  # (P, 4, 8) of x, y, z (m) and yaw (rad), by ascending powers

    def evaluate(self, time: np.ndarray, derivative: int = 0) -> np.ndarray:
        """Return x, y, z and yaw, or a derivative of them, (T, 4) at times (T,), s."""
        knots = np.concatenate([[0.0], np.cumsum(self.duration)])
        which = np.clip(np.searchsorted(knots, time, side="right") - 1, 0, len(self.duration) - 1)
        powers = np.arange(DEGREE + 1)
        factor = np.prod([powers - k for k in range(derivative)], axis=0)
        exponent = np.maximum(powers - derivative, 0)
        basis = factor * (time - knots[which])[:, None] ** exponent
        return np.einsum("tk,tak->ta", basis, self.coefficients[which])


def curve(flight: Recording, drone: int) -> CubicHermiteSpline:
    """Return position and yaw (4,) of a drone over time, from recorded states."""
    x, y, z, w = flight.quaternion[:, drone].T
    yaw = np.unwrap(np.arctan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z)))
    values = np.column_stack([flight.position[:, drone], yaw])
    slopes = np.column_stack([flight.velocity[:, drone], np.gradient(yaw, flight.time)])
    return CubicHermiteSpline(flight.time, values, slopes)


def fit(path: CubicHermiteSpline, tolerance_m: float) -> tuple[Pieces, float]:
    """Return the fewest pieces of equal duration within a tolerance, and their largest error, m.

    Raises:
        ValueError: 31 pieces are not enough; the message has the tolerance that they reach.
    """
    start, end = path.x[0], path.x[-1]
    time = np.linspace(start, end, max(round((end - start) * DENSE), 64) + 1)
    desired, error = path(time), np.inf
    for count in range(1, MOST_PIECES + 1):
        pieces = spline(time, desired, count)
        gap = pieces.evaluate(time - start) - desired
        error = float(np.linalg.norm(gap[:, :3], axis=1).max())
        if error <= tolerance_m:
            return pieces, error
    raise ValueError(
        f"{MOST_PIECES} pieces come within {math.ceil(1e6 * error) / 1e6:.6f} m of the flight, "
        f"but the tolerance is {tolerance_m} m; use a larger one or a shorter flight"
    )


def spline(time: np.ndarray, desired: np.ndarray, count: int) -> Pieces:
    """Return the least-squares spline with `count` pieces of a curve."""
    knots = np.linspace(time[0], time[-1], count + 1)
    inner = np.repeat(knots[1:-1], DEGREE - SMOOTH)
    ends = [knots[0]] * (DEGREE + 1), [knots[-1]] * (DEGREE + 1)
    fitted = make_lsq_spline(time, desired, np.concatenate([ends[0], inner, ends[1]]), DEGREE)
    return Pieces(np.diff(knots).astype(np.float32), taylor(fitted, knots[:-1]))


def taylor(fitted: BSpline, at: np.ndarray) -> np.ndarray:
    """Return the polynomials (P, 4, 8) of a spline about times (P,), in single precision."""
    parts, factorial = [], 1.0
    for k in range(DEGREE + 1):
        factorial *= max(k, 1)
        parts.append(fitted(at, nu=k) / factorial)
    return np.stack(parts, axis=-1).astype(np.float32)


def write_rows(path: Path, header: tuple[str, ...], rows: np.ndarray) -> None:
    """Write a table as CSV."""
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(header)
        writer.writerows([[repr(float(value)) for value in row] for row in rows])


def write_setpoints(path: Path, track: CubicHermiteSpline, rate: float) -> None:
    """Write time, position, velocity, acceleration and yaw at a rate, 1/s, up to the end."""
    duration = track.x[-1] - track.x[0]
    time = np.append(np.arange(0.0, duration, 1.0 / rate), duration)
    at = track.x[0] + time
    states = [track(at)[:, :3], track(at, nu=1)[:, :3], track(at, nu=2)[:, :3], track(at)[:, 3:]]
    write_rows(path, ("t", *STATE), np.column_stack([time, *states]))


def least_clearance(flight: Recording, fitted: list[Pieces]) -> float:
    """Return the least distance between two bodies on their pieces, m; inf for a single drone."""
    time = np.arange(0.0, flight.time[-1] - flight.time[0], 1.0 / DENSE)
    places = [pieces.evaluate(time)[:, :3] for pieces in fitted]
    gaps = [
        np.linalg.norm(places[i] - places[j], axis=1).min()
        - (flight.team[i].radius + flight.team[j].radius)
        for i, j in combinations(range(len(fitted)), 2)
    ]
    return float(min(gaps, default=np.inf))


def fit_all(
    flight: Recording, tolerance_m: float
) -> list[tuple[CubicHermiteSpline, Pieces, float]]:
    """Return for each drone its flight, its pieces, and their largest error, m.

    Raises:
        ValueError: pieces of a drone miss the tolerance.
    """
    found = []
    for drone in tqdm(range(len(flight.team)), unit="drone", delay=1.0):
        track = curve(flight, drone)
        try:
            found.append((track, *fit(track, tolerance_m)))
        except ValueError as failure:
            raise ValueError(f"drone_{drone}: {failure}") from failure
    return found


def report(name: str, pieces: Pieces, error: float) -> None:
    """Print the number of pieces of a drone, their error, speed and acceleration."""
    time = np.linspace(0.0, float(pieces.duration.sum()), 500)
    speed, acceleration = (
        np.linalg.norm(pieces.evaluate(time, order)[:, :3], axis=1).max() for order in (1, 2)
    )
    print(
        f"{name}: {len(pieces.duration)} pieces, at most {100 * error:.2f} "
        f"cm from the flight, {speed:.2f} m/s, {acceleration:.2f} m/s^2"
    )


def main(options: Options) -> float:
    """Convert the flight, print the report and return the least distance between bodies, m."""
    if options.out.exists() and not options.out.is_dir():
        raise ValueError(f"--out is {str(options.out)!r}, but that is a file; name a folder")
    flight = read_trajectory(options.flight)
    fitted = fit_all(flight, options.tolerance_m)
    options.out.mkdir(parents=True, exist_ok=True)
    for drone, (track, pieces, error) in enumerate(fitted):
        name = f"drone_{drone}"
        rows = np.column_stack([pieces.duration, pieces.coefficients.reshape(-1, 32)])
        write_rows(options.out / f"{name}.csv", HEADER, rows)
        write_setpoints(options.out / f"{name}_setpoints.csv", track, options.rate)
        report(f"{name} ({flight.team[drone].token})", pieces, error)
    clearance = least_clearance(flight, [pieces for _, pieces, _ in fitted])
    if np.isfinite(clearance):
        print(f"bodies stay at least {100 * clearance:.1f} cm apart")
    print(f"wrote {2 * len(fitted)} files into {options.out}")
    return clearance


if __name__ == "__main__":
    try:
        sys.exit(int(main(tyro.cli(Options, description=__doc__)) <= 0.0))
    except (ImportError, OSError, ValueError) as error:
        print(f"error: {error}", file=sys.stderr)
        sys.exit(2)
