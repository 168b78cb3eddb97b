"""Motions of a collection: random walks with artificial potentials, and stacked swaps.

In a random walk (Neural-Swarm2, Sec. VII-B), the set-point of each drone is a point mass that an
attractive potential pulls to a goal in a small box; goals are sampled again at a fixed frequency.
Half of the time all goals are on one vertical line, so that drones pass over and under each other.
Neighbors and the floor repel with an artificial potential (Khatib, 1986) of the clearance c,
U(c) = strength / 2 (1/c - 1/reach)^2 below the reach and 0 above it, whose gradient at the
*measured* positions accelerates the set-point. The constants are not from the paper.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass, fields
from typing import NamedTuple, Protocol

import numpy as np

from swarm_envs.compiled import kernel
from swarm_envs.errors import check_interval, check_number
from swarm_envs.physics.rigid_body import TIME_STEP
from swarm_envs.state import FloatArray
from swarm_envs.trajectories import Reference, ramped_line
from swarm_envs.vehicles import Team

__all__ = ["MotionRanges"]

Pair = tuple[float, float]  # Bounds of a uniform distribution
_POSITIVE = ("goal_period_s", "reach_m", "floor_reach_m", "crossing_s")
"""Options that must not be zero."""


@dataclass(frozen=True)
class MotionRanges:
    """The distributions of motions. SI units; a pair is (lowest, highest)."""

    half_width_m: float = 0.25
    """Half of the width of the box of a random walk, m."""
    walk_heights_m: Pair = (0.5, 1.7)
    """Heights of goals of a walk aloft, m."""
    low_walk_heights_m: Pair = (0.07, 0.8)
    """Heights of goals near the ground, m; goals are at least 1 cm above contact with the floor."""
    low_walk_power: float = 2.0
    """Power p of heights near the ground: the lowest plus the span times u^p with uniform u."""
    goal_period_s: float = 1.5
    """Time between new goals of a walk, s."""
    aligned: float = 0.5
    """Fraction of goals that are on one vertical line."""
    attraction: Pair = (2.0, 4.5)
    """Natural frequency of the attraction to goals, drawn per flight, rad/s."""
    acceleration_limit: float = 3.0
    """Largest acceleration by attraction, m/s^2."""
    reach_m: float = 0.15
    """Clearance of two drones below which they repel, m."""
    strength: float = 3e-3
    """Strength of the repulsion, m^4/s^2."""
    floor_reach_m: float = 0.04
    """Clearance from the floor below which it repels, m."""
    floor_strength: float = 1e-5
    """Strength of the floor's repulsion, m^4/s^2."""
    repulsion_limit: float = 8.0
    """Largest acceleration by repulsion from one neighbor or the floor, m/s^2."""
    radius_m: Pair = (0.35, 0.75)
    """Radius of the circle of a swap, m."""
    gap_m: Pair = (0.15, 0.45)
    """Distance of neighboring planes of a swap, m, increased where `clearance_m` requires it."""
    clearance_m: float = 0.015
    """Least clearance of drones in neighboring planes of a swap, m."""
    crossing_s: Pair = (2.0, 5.0)
    """Duration of a crossing, s."""
    pause_s: Pair = (0.2, 0.8)
    """Pause between crossings, s."""
    miss_m: float = 0.06
    """Standard deviation of the ends of crossings in x and y, m, so that drones also pass beside
    the axis."""
    lowest_m: Pair = (0.6, 1.0)
    """Height of the lowest plane of a swap aloft, m."""
    low_lowest_m: Pair = (0.14, 0.4)
    """Height of the lowest plane of a swap near the ground, m."""

    def __post_init__(self) -> None:
        """Raise ValueError if a value is invalid."""
        for option in fields(self):
            check = check_interval if isinstance(option.default, tuple) else check_number
            value = getattr(self, option.name)
            if option.name in _POSITIVE:
                check(option.name, value, above=0.0)
            else:
                check(option.name, value, at_least=0.0)


class MotionTarget(NamedTuple):
    """Set-points of E teams of N drones, arrays (E, N, 3). World frame."""

    position: FloatArray  # m
    velocity: FloatArray  # m/s
    acceleration: FloatArray  # m/s^2


class TeamMotion(Protocol):
    """The protocol of a motion of E teams of N drones."""

    start: FloatArray  # (E, N, 3) start positions at rest, m

    def target(self, time: float, position: FloatArray) -> MotionTarget:
        """Return the set-points at `time`, s, for measured positions (E, N, 3), m.

        It is called once per time step, in order.
        """


_LEAST = 1e-3


class Potential(NamedTuple):
    """The parameters of a repulsive potential."""

    reach: float  # Clearance below which it repels, m
    strength: float  # m^4/s^2
    limit: float  # Largest acceleration, m/s^2


@kernel
def repulsion(clearance: float, potential: Potential) -> float:
    """Return the repulsive acceleration -dU/dc at a clearance c, m, up to its limit, m/s^2."""
    c = max(clearance, _LEAST)
    if c >= potential.reach:
        return 0.0
    slope = potential.strength * (1.0 / c - 1.0 / potential.reach) / (c * c)
    return min(slope, potential.limit)


@kernel
def push_apart(
    position: FloatArray, radius: FloatArray, neighbor: Potential, floor: Potential, out: FloatArray
) -> None:
    """Write the repulsive accelerations (E, N, 3), m/s^2, of drones by each other and the floor.

    Drones are spheres of radii (N,) at positions (E, N, 3), m, z up from the floor; `neighbor` and
    `floor` are potentials of their clearances.
    """
    out[:] = 0.0
    for e in range(position.shape[0]):
        p, push = position[e], out[e]
        for i in range(p.shape[0]):
            push[i, 2] += repulsion(p[i, 2] - radius[i], floor)
            for j in range(i):
                x, y, z = p[i, 0] - p[j, 0], p[i, 1] - p[j, 1], p[i, 2] - p[j, 2]
                distance = math.sqrt(x * x + y * y + z * z)
                size = repulsion(distance - (radius[i] + radius[j]), neighbor)
                scale = size / max(distance, 1e-6)
                for k, part in enumerate((x, y, z)):
                    push[i, k] += scale * part
                    push[j, k] -= scale * part


class RandomWalk:
    """Random walks of E teams in a small box, one per generator, near the ground or aloft.

    `duration` is the duration of the flights, s.
    """

    def __init__(
        self,
        team: Team,
        rngs: list[np.random.Generator],
        ranges: MotionRanges,
        low: bool,
        duration: float,
    ) -> None:
        self.ranges = ranges
        self.radius = np.array([vehicle.radius for vehicle in team])
        count = int(duration / ranges.goal_period_s) + 2
        goals = [draw_goals(self.radius, rng, ranges, low, count) for rng in rngs]
        self.goals = np.stack(goals)
        self.frequency = np.array([rng.uniform(*ranges.attraction) for rng in rngs])[:, None, None]
        self.start = np.stack([separated(g[0], self.radius) for g in self.goals])
        self._goal = self.start.copy()
        self._position, self._velocity = self.start.copy(), np.zeros_like(self.start)
        r = ranges
        self._neighbor = Potential(r.reach_m, r.strength, r.repulsion_limit)
        self._floor = Potential(r.floor_reach_m, r.floor_strength, r.repulsion_limit)
        self._push = np.zeros_like(self.start)

    def target(self, time: float, position: FloatArray) -> MotionTarget:
        """Return the set-points after one more step; see `TeamMotion`."""
        desired = self.goals[:, int(time / self.ranges.goal_period_s)]
        # Goals jump; a low-pass with time constant 1 / frequency keeps the acceleration smooth.
        self._goal += TIME_STEP * self.frequency * (desired - self._goal)
        w = self.frequency
        pull = w * w * (self._goal - self._position) - 2.0 * w * self._velocity
        size = np.sqrt((pull * pull).sum(axis=-1, keepdims=True))
        pull *= self.ranges.acceleration_limit / np.maximum(size, self.ranges.acceleration_limit)
        push_apart(position, self.radius, self._neighbor, self._floor, self._push)
        acceleration = pull + self._push
        self._velocity = self._velocity + TIME_STEP * acceleration
        self._position = self._position + TIME_STEP * self._velocity
        return MotionTarget(self._position, self._velocity, acceleration)


def draw_goals(
    radius: FloatArray, rng: np.random.Generator, ranges: MotionRanges, low: bool, count: int
) -> FloatArray:
    """Return goals (count, N, 3) of one flight, m, for drones of radii (N,), m."""
    n, width = len(radius), ranges.half_width_m
    goals = np.empty((count, n, 3))
    goals[..., :2] = rng.uniform(-width, width, (count, n, 2))
    aligned = rng.random(count) < ranges.aligned
    line = goals[:, :1, :2] + rng.normal(0.0, 0.03, (count, n, 2))
    goals[..., :2] = np.where(aligned[:, None, None], line, goals[..., :2])
    lowest, highest = ranges.low_walk_heights_m if low else ranges.walk_heights_m
    power = ranges.low_walk_power if low else 1.0
    reachable = np.maximum(lowest, radius + 0.01)
    goals[..., 2] = reachable + (highest - reachable) * rng.random((count, n)) ** power
    return goals


def separated(points: FloatArray, radius: FloatArray) -> FloatArray:
    """Return starts (N, 3), m, in which drones are moved along x so that none overlap."""
    start = points.copy()
    for i in range(1, len(start)):
        for _ in range(i):
            reach = radius[:i] + radius[i] + 0.1
            near = np.linalg.norm(start[:i] - start[i], axis=1) < reach
            if near.any():
                start[i, 0] = (start[:i, 0] + reach)[near].max()
    return start


class StackedSwaps:
    """Repeated swaps of E teams on cylinders, each drone in its own plane.

    The vertical order of the team and the height of the lowest plane, m, are drawn per flight.
    `duration` is the duration of the flights, s.
    """

    def __init__(
        self,
        team: Team,
        rngs: list[np.random.Generator],
        ranges: MotionRanges,
        lowest: Pair,
        duration: float,
    ) -> None:
        radius = np.array([vehicle.radius for vehicle in team])
        flights = [draw_swaps(radius, rng, ranges, lowest, duration) for rng in rngs]
        parts = zip(*flights, strict=True)
        self.reference = Reference(*(np.stack(part) for part in parts))
        self.start = self.reference.position[:, 0].copy()

    def target(self, time: float, position: FloatArray) -> MotionTarget:
        """Return the set-points at a time, independent of the measured positions."""
        index = round(time / TIME_STEP)
        p, v, a, _ = (part[:, index] for part in self.reference)
        return MotionTarget(p, v, a)


def draw_swaps(
    radius: FloatArray,
    rng: np.random.Generator,
    ranges: MotionRanges,
    lowest: Pair,
    duration: float,
) -> Reference:
    """Return the references (T, N, 3) of one flight of swaps; see `StackedSwaps`."""
    n = len(radius)
    height = stacked_heights(radius, rng.permutation(n), rng, ranges, lowest)
    angle = rng.uniform(0.0, 2 * np.pi) + 2 * np.pi * np.arange(n) / n
    size = rng.uniform(*ranges.radius_m)
    ends = size * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    time, begin = np.arange(round(duration / TIME_STEP) + 1) * TIME_STEP, 0.0
    here = np.column_stack([ends, height])
    pieces = []
    while begin <= time[-1]:
        ends = -ends
        there = np.column_stack([ends + rng.normal(0.0, ranges.miss_m, (n, 2)), height])
        crossing = rng.uniform(*ranges.crossing_s)
        end = begin + crossing + rng.uniform(*ranges.pause_s)
        now = time[(time >= begin) & (time < end)]
        pieces.append(ramped_line(here, there, np.full(n, crossing), now[:, None] - begin))
        here, begin = there, end
    return Reference(*(np.concatenate(parts) for parts in zip(*pieces, strict=True)))


def stacked_heights(
    radius: FloatArray,
    order: np.ndarray,
    rng: np.random.Generator,
    ranges: MotionRanges,
    lowest: Pair,
) -> FloatArray:
    """Return the height (N,) of each drone's plane, m; `order` lists drones from the lowest up."""
    height = np.empty(len(radius))
    height[order[0]] = rng.uniform(*lowest)
    for below, above in itertools.pairwise(order):
        gap = max(rng.uniform(*ranges.gap_m), radius[below] + radius[above] + ranges.clearance_m)
        height[above] = height[below] + gap
    return height
