"""Motions of a collection: random walks kept apart by artificial potentials, and stacked swaps.

Random walk (Neural-Swarm2, Sec. VII-B): each drone has a set-point, a point mass that an
attractive potential draws to a goal in a small box; goals are sampled again at a fixed frequency.
Half of the time all goals are on one vertical line, so that drones pass over and under each
other. Neighbors and the floor repel with an artificial potential (Khatib, 1986) of the
clearance c, U(c) = strength / 2 (1/c - 1/reach)^2 below the reach and 0 above it, whose slope at
the *measured* positions accelerates the set-point. The constants are not from the paper.
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

Pair = tuple[float, float]  # Lowest and highest of what is drawn evenly
_POSITIVE = ("goal_period_s", "reach_m", "floor_reach_m", "crossing_s")
"""Options that must not be zero."""


@dataclass(frozen=True)
class MotionRanges:
    """The ranges that motions are drawn from. SI units; a pair is (lowest, highest)."""

    half_width_m: float = 0.25
    """half width of the box of a random walk"""
    walk_heights_m: Pair = (0.5, 1.7)
    """heights of goals of a walk aloft"""
    low_walk_heights_m: Pair = (0.07, 0.8)
    """heights of goals near the ground; a drone's goal is at least 1 cm above touching the floor"""
    low_walk_power: float = 2.0
    """heights near the ground are the lowest plus the span times u^power, u uniform"""
    goal_period_s: float = 1.5
    """time between new goals of a walk"""
    aligned: float = 0.5
    """share of goals that are on one vertical line"""
    attraction: Pair = (2.0, 4.5)
    """natural frequency of the attraction to goals, drawn per flight, rad/s"""
    acceleration_limit: float = 3.0
    """largest acceleration by attraction, m/s^2"""
    reach_m: float = 0.15
    """clearance between two spheres below which they repel"""
    strength: float = 3e-3
    """strength of the repulsion, m^4/s^2"""
    floor_reach_m: float = 0.04
    """clearance from the floor below which it repels"""
    floor_strength: float = 1e-5
    """strength of the floor's repulsion, m^4/s^2"""
    repulsion_limit: float = 8.0
    """largest acceleration by repulsion from one neighbor or the floor, m/s^2"""
    radius_m: Pair = (0.35, 0.75)
    """radius of the circle of a swap"""
    gap_m: Pair = (0.15, 0.45)
    """distance of neighboring planes of a swap; more where spheres would come within
    `clearance_m`"""
    clearance_m: float = 0.015
    """least clearance of the spheres of drones in neighboring planes of a swap"""
    crossing_s: Pair = (2.0, 5.0)
    """time of one crossing"""
    pause_s: Pair = (0.2, 0.8)
    """rest between crossings"""
    miss_m: float = 0.06
    """standard deviation of ends of crossings in x and y, so that drones also pass off the axis"""
    lowest_m: Pair = (0.6, 1.0)
    """height of the lowest plane of a swap aloft"""
    low_lowest_m: Pair = (0.14, 0.4)
    """the same near the ground"""

    def __post_init__(self) -> None:
        """Refuse values that an option cannot have."""
        for option in fields(self):
            check = check_interval if isinstance(option.default, tuple) else check_number
            value = getattr(self, option.name)
            if option.name in _POSITIVE:
                check(option.name, value, above=0.0)
            else:
                check(option.name, value, at_least=0.0)


class MotionTarget(NamedTuple):
    """Where E teams of N drones are to be now, and what moves them. World frame, (E, N, 3), SI."""

    position: FloatArray  # Where the drone should be, m
    velocity: FloatArray  # Its derivative, m/s
    acceleration: FloatArray  # Its second derivative, m/s^2


class TeamMotion(Protocol):
    """A motion of E teams of N drones."""

    start: FloatArray  # (E, N, 3) where the drones start, at rest, m

    def target(self, time: float, position: FloatArray) -> MotionTarget:
        """Set-points at `time`, s, given measured positions (E, N, 3), m.

        Called once per time step, in order.
        """


_LEAST = 1e-3


class Potential(NamedTuple):
    """A potential of the clearance to what repels."""

    reach: float  # Clearance below which it repels, m
    strength: float  # m^4/s^2
    limit: float  # Largest acceleration, m/s^2


@kernel
def repulsion(clearance: float, potential: Potential) -> float:
    """Acceleration -dU/dc away from what is at a clearance c, m, within its limit, m/s^2."""
    c = max(clearance, _LEAST)
    if c >= potential.reach:
        return 0.0
    slope = potential.strength * (1.0 / c - 1.0 / potential.reach) / (c * c)
    return min(slope, potential.limit)


@kernel
def push_apart(
    position: FloatArray, radius: FloatArray, neighbor: Potential, floor: Potential, out: FloatArray
) -> None:
    """Write the acceleration (E, N, 3), m/s^2, by which drones repel each other and the floor.

    Spheres of the radii (N,) stand at positions (E, N, 3), m, z up from the floor; `neighbor` and
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

    `duration` is the length of the flights, s.
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
        """Set-points after one more step; see `TeamMotion`."""
        wanted = self.goals[:, int(time / self.ranges.goal_period_s)]
        # Goals jump; a low-pass of the time constant 1 / frequency keeps the acceleration smooth.
        self._goal += TIME_STEP * self.frequency * (wanted - self._goal)
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
    """Goals (count, N, 3) of one flight, m, for spheres of the radii (N,), m."""
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
    """Starts (N, 3), m: each drone moved in x from the lower-numbered ones that it would touch."""
    start = points.copy()
    for i in range(1, len(start)):
        for _ in range(i):
            reach = radius[:i] + radius[i] + 0.1
            near = np.linalg.norm(start[:i] - start[i], axis=1) < reach
            if near.any():
                start[i, 0] = (start[:i, 0] + reach)[near].max()
    return start


class StackedSwaps:
    """Swaps of E teams on cylinders, there and back, each drone in its own plane.

    The order of the team from top to bottom is drawn per flight, and its lowest plane, m.
    `duration` is the length of the flights, s.
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
        """Set-points at a time; the measured positions change nothing; see `TeamMotion`."""
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
    """References (T, N, 3) of one flight of swaps; see `StackedSwaps`."""
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
    """Height (N,) of each drone's plane, m; `order` lists the drones from the lowest up."""
    height = np.empty(len(radius))
    height[order[0]] = rng.uniform(*lowest)
    for below, above in itertools.pairwise(order):
        gap = max(rng.uniform(*ranges.gap_m), radius[below] + radius[above] + ranges.clearance_m)
        height[above] = height[below] + gap
    return height
