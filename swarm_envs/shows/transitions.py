"""The ways from one formation to the next: assigned, or each drone to a place of its own.

Assigned: places are matched so that the squared scaled ways sum to the least, and all drones fly
straight at the same time. With places sqrt(2) spacings apart they keep the spacing (Turpin, Michael
and Kumar, CAPT, IJRR 2014): `least` says by how much. The share of the way is a curve of constant
jerk by piece, within limits of speed, acceleration and jerk.

Labelled: drone i flies to place i. Straight ways meet then, so cubic B-splines about them are
moved apart by minimising what pairs lack of the spacing, and what speeds and accelerations have too
much, for a row of durations; what remains too fast is slowed, and the shortest is taken.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import product
from typing import Annotated

import numpy as np
from scipy.optimize import linear_sum_assignment, minimize
from scipy.sparse import csr_array
from scipy.sparse.csgraph import maximum_bipartite_matching

from swarm_envs.arguments import POSITIVE, typed
from swarm_envs.compiled import kernel
from swarm_envs.shows.choreography import Choreography, least_distance
from swarm_envs.shows.formations import Room
from swarm_envs.state import FloatArray

__all__ = ["Pace"]

_BEZIER = np.array([[1, 4, 1, 0], [0, 4, 2, 0], [0, 2, 4, 0], [0, 1, 4, 1]]) / 6.0
_BASIS = np.array([[1, 4, 1, 0], [-3, 0, 3, 0], [3, -6, 3, 0], [-1, 3, -3, 1]]) / 6.0
_LADDER = (1.1, 1.2, 1.3, 1.45, 1.6, 1.8, 2.1, 2.5, 3.0, 4.0)
"""Durations over that of the slowest drone alone that labelled transitions try, in order."""
_LONGER = np.array([0.01, 0.05, 0.1, 0.15, 0.2, 0.3])
"""By how much the longest assigned way may be longer than the shortest possible, tried in order."""
_FORBIDDEN = 1e9
_MARGIN = 0.01
_SPREADS, _FREE, _SAMPLES = (0.0, 0.5), 12, 4


@typed
@dataclass(frozen=True)
class Pace:
    """Limits of the reference paths."""

    speed: Annotated[float, POSITIVE] = 2.0
    """m/s."""
    acceleration: Annotated[float, POSITIVE] = 4.0
    """m/s^2."""
    jerk: Annotated[float, POSITIVE] = 60.0
    """m/s^3, of straight ways."""

    def alone_s(self, distance: float) -> float:
        """Shortest time from rest to rest of one drone at speed and acceleration, any jerk, s."""
        v, a = self.speed, self.acceleration
        return distance / v + v / a if distance >= v * v / a else 2.0 * math.sqrt(distance / a)


@dataclass(frozen=True, eq=False)
class Transition:
    """The way from a formation to the next."""

    paths: Choreography  # Of the N drones
    alone_s: float
    """A bound on the duration: the slowest drone alone, of any assignment if places are free, s."""
    least: float  # A lower bound of the scaled distance at any time, m


def assigned(start: FloatArray, places: FloatArray, room: Room, pace: Pace) -> Transition:
    """Straight ways to the places that suit best; starts and places (N, 3), m.

    Of assignments whose longest way is little longer than it must be, the first that keeps the
    spacing; else that of the least sum of squares, which always does.

    Raises:
        ValueError: drones would come nearer than the spacing: starts or places are too close.
    """
    square = np.square((start[:, None] - places) / room.scaling).sum(axis=-1)
    ways = np.linalg.norm(start[:, None] - places, axis=-1)
    shortest = _bottleneck(ways)
    for longest in (*(1.0 + _LONGER) * shortest, math.inf):
        goal = places[linear_sum_assignment(np.where(ways > longest, _FORBIDDEN, square))[1]]
        knots, share = _share(float(np.linalg.norm(goal - start, axis=1).max()), pace)
        paths = Choreography(knots, start + share[..., None, None] * (goal - start))
        least = least_distance(paths, room.scaling)
        if least >= room.spacing:
            return Transition(paths, pace.alone_s(shortest), least)
    raise ValueError(
        f"drones would come within {least:.3f} m of each other, but must keep {room.spacing} m; "
        f"let places be at least {room.apart:.3f} m apart"
    )


def _share(distance: float, pace: Pace) -> tuple[FloatArray, FloatArray]:
    """Knots (K + 1,), s, and Bezier points (K, 4) of the share of a straight way, m."""
    times, jerks = _profile(max(distance, 1e-6), pace)
    points, s, v, a = [], 0.0, 0.0, 0.0
    for t, j in zip(times, jerks):
        end = (s + v * t + a * t**2 / 2 + j * t**3 / 6, v + a * t + j * t**2 / 2)
        points.append([s, s + v * t / 3, end[0] - end[1] * t / 3, end[0]])
        s, v, a = *end, a + j * t
    share = np.array(points) / s
    share[-1, 2:] = 1.0  # at rest to the last bit
    return np.concatenate([[0.0], np.cumsum(times)]), share


def _profile(distance: float, pace: Pace) -> tuple[FloatArray, FloatArray]:
    """Durations, s, and jerks of the pieces of a rest-to-rest motion within limits."""
    j = pace.jerk
    a = min(pace.acceleration, (distance * j * j / 2) ** (1 / 3), math.sqrt(pace.speed * j))
    ramp = a / j
    # With peak speed v the way is v (v / a + ramp) and the part at constant speed.
    v = min(pace.speed, a * (-ramp + math.sqrt(ramp**2 + 4 * distance / a)) / 2)
    even, cruise = max(v / a - ramp, 0.0), max(distance / v - v / a - ramp, 0.0)
    times = np.array([ramp, even, ramp, cruise, ramp, even, ramp])
    jerks = np.array([j, 0, -j, 0, -j, 0, j])
    kept = times > 2e-3  # Skybrush counts milliseconds
    return times[kept], jerks[kept]


def _bottleneck(ways: FloatArray) -> float:
    """Longest way of the assignment whose longest way is shortest, of ways (N, N), m."""
    low, high = float(max(ways.min(axis=0).max(), ways.min(axis=1).max())), float(ways.max())
    while high - low > 1e-4 * high:
        middle = (low + high) / 2
        full = maximum_bipartite_matching(csr_array(ways <= middle), perm_type="column")
        low, high = (low, middle) if (full >= 0).all() else (middle, high)
    return low


def labelled(start: FloatArray, goal: FloatArray, room: Room, pace: Pace, seed: int) -> Transition:
    """Ways on which drone i flies from start i to goal i, (N, 3), m.

    Raises:
        ValueError: no way was found that keeps the spacing, whatever its duration.
    """
    alone = pace.alone_s(float(np.linalg.norm(goal - start, axis=1).max()))
    rng = np.random.default_rng(seed)
    best: Transition | None = None
    for ratio, spread in product(_LADDER, _SPREADS):
        if best is not None and best.paths.duration_s <= ratio * alone:
            break
        paths = _slowed(_moved_apart(start, goal, ratio * alone, room, pace, rng, spread), pace)
        least = least_distance(paths, room.scaling)
        faster = best is None or paths.duration_s < best.paths.duration_s
        if least >= room.spacing and faster:
            best = Transition(paths, alone, least)
    if best is not None:
        return best
    raise ValueError(
        f"found no labelled ways of {len(start)} drones that keep {room.spacing} m within "
        f"{_LADDER[-1]} times the time of one alone; use a smaller spacing, or --no-labels"
    )


def _slowed(paths: Choreography, pace: Pace) -> Choreography:
    """The same ways, as slow as the limits ask for."""
    speed, acceleration = paths.largest()
    factor = max(1.0, speed / pace.speed, math.sqrt(acceleration / pace.acceleration))
    return Choreography(factor * paths.knots, paths.points)


def _moved_apart(
    start: FloatArray, goal: FloatArray, seconds: float, room: Room, pace: Pace,
    rng: np.random.Generator, spread: float,
) -> Choreography:  # fmt: skip
    """The splines of one duration with the least of what is lacking."""
    steps = _FREE + round(2 * seconds) + 3
    rows = _samplers(steps, seconds / steps)
    control, inner = _first_guess(start, goal, steps, room, rng, spread), slice(3, steps)
    floor = 0.9 * float(min(start[:, 2].min(), goal[:, 2].min()))

    def cost(x: FloatArray) -> tuple[float, FloatArray]:
        control[inner] = x.reshape(control[inner].shape)
        position, speed, pull = (np.tensordot(row, control, axes=1) for row in rows)
        grads = [np.zeros_like(x) for x in (position, speed, pull)]
        total = _lacking(position, room.scaling, room.spacing + _MARGIN, floor, grads[0])
        total += _excess(speed, 0.98 * pace.speed, 0.3, grads[1])
        total += _excess(pull, 0.98 * pace.acceleration, 0.1, grads[2])
        bend = pull * (seconds / steps) ** 2
        grads[2] += 2e-4 * bend * (seconds / steps) ** 2
        slope = np.zeros_like(control)
        for row, grad in zip(rows, grads):
            slope += np.tensordot(row.T, grad, axes=1)
        return total + 1e-4 * float((bend * bend).sum()), slope[inner].ravel()

    options = {"maxiter": 500, "maxcor": 20, "maxfun": 700}
    found = minimize(cost, control[inner].ravel(), jac=True, method="L-BFGS-B", options=options)
    control[inner] = found.x.reshape(control[inner].shape)
    windows = np.stack([control[k : k + steps] for k in range(4)], axis=1)
    points: FloatArray = np.einsum("bk,sknx->sbnx", _BEZIER, windows)
    points[0, 0], points[-1, -1] = start, goal
    return Choreography(np.linspace(0.0, seconds, steps + 1), points)


def _samplers(steps: int, h: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    """What makes positions, velocities and accelerations at samples of the control points."""
    samples = np.linspace(0.0, steps, _SAMPLES * steps + 1)
    place = np.zeros((len(samples), steps + 3))
    for k, t in enumerate(samples):
        step = min(int(t), steps - 1)
        place[k, step : step + 4] = np.vander([t - step], 4, increasing=True)[0] @ _BASIS
    # Of cubic splines accelerations are largest at knots: second differences of control points.
    stiff = np.diff(np.eye(steps + 3), n=2, axis=0)
    return place, np.diff(place, axis=0) * _SAMPLES / h, stiff / h**2


def _first_guess(
    start: FloatArray, goal: FloatArray, steps: int, room: Room, rng: np.random.Generator,
    spread: float,
) -> FloatArray:  # fmt: skip
    """Control points (steps + 3, N, 3) of straight lines with random bows, m."""
    share = np.clip((np.arange(steps + 3) - 2) / (steps - 2), 0.0, 1.0)[:, None, None]
    control: FloatArray = start + share * (goal - start)
    inner = slice(3, steps)
    bow = np.sin(np.pi * share[inner])
    bows = rng.normal(size=start.shape) * room.spacing * np.array([1.0, 1.0, 0.5])
    control[inner] += bow * bows
    control[inner] += spread * bow * (control[inner] - control[inner].mean(axis=1, keepdims=True))
    return control


@kernel
def _lacking(
    position: FloatArray, scaling: FloatArray, distance: float, floor: float, grad: FloatArray
) -> float:
    """Sum of squares of what pairs lack of a scaled distance at samples (T, N, 3); its slope."""
    total = 0.0
    for t in range(position.shape[0]):
        p, g = position[t], grad[t]
        for i in range(p.shape[0]):
            low = max(floor - p[i, 2], 0.0)
            total += low * low
            g[i, 2] -= 2.0 * low
            for j in range(i):
                x = (p[i, 0] - p[j, 0]) / scaling[0]
                if abs(x) >= distance:
                    continue
                y, z = (p[i, 1] - p[j, 1]) / scaling[1], (p[i, 2] - p[j, 2]) / scaling[2]
                square = x * x + y * y + z * z
                if square >= distance * distance:
                    continue
                size = np.sqrt(max(square, 1e-12))
                lack = distance - size
                total += lack * lack
                factor = -2.0 * lack / size
                for k, d in ((0, x), (1, y), (2, z)):
                    g[i, k] += factor * d / scaling[k]
                    g[j, k] -= factor * d / scaling[k]
    return total


def _excess(vectors: FloatArray, limit: float, weight: float, grad: FloatArray) -> float:
    """Weighted sum of squares of what vectors (T, N, 3) are too long; its slope into `grad`."""
    size = np.linalg.norm(vectors, axis=-1, keepdims=True)
    over = np.maximum(size - limit, 0.0)
    grad += 2.0 * weight * over * vectors / np.maximum(size, 1e-9)
    return weight * float((over * over).sum())
