"""How close robots on a grid's splines can come, and the spacing for distances and for forces.

Two robots on valid paths never stand on one vertex and never exchange two. Within a step their
distance is a spline of four differences of vertices. There are finitely many such windows near
zero: the least distance over all of them holds for any plan, of any number of robots.

RTH3D names forces as future work. On a grid nothing but the spacing decides how large they are: the
smallest one at which a force model predicts no more than the limit is looked for.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import cache
from itertools import product
from typing import Annotated, NamedTuple

import numpy as np
import numpy.typing as npt

from swarm_envs.arguments import POSITIVE, POSITIVE_M, typed
from swarm_envs.baselines.rth3d.flight.spline import BASIS, SplineFlight, on_grid, shortest_step
from swarm_envs.compiled import kernel
from swarm_envs.interactions import InteractionModel
from swarm_envs.state import FloatArray
from swarm_envs.vehicles import GRAM_FORCE, Team

__all__ = ["least_spacing", "smallest_distance"]

_SAMPLES = 64
_CURVATURE = 4.0
"""Bounds the second derivative of a difference by the step's share: second differences of relative
positions, of two robots that each turn back, are at most this many spacings long."""


@cache
def worst_clearance(stretch: tuple[float, float, float] = (1.0, 1.0, 1.0)) -> float:
    """Least distance of two robots on any valid plan's splines, by the spacing along x.

    Args:
        stretch: spacing by axis over that along x, in the metric in which distances count: for a
            scaled distance, with heights divided by Theta, what remains after the division.

    Returns:
        A lower bound: 0.647 on a cubic lattice, where straight motion has 1 / sqrt(2).

    Raises:
        ValueError: a stretch is not positive and finite.
    """
    if not all(0.0 < s < math.inf for s in stretch):
        raise ValueError(f"stretch is {stretch}, but must be positive and finite")
    moves = np.array(sorted(_relative_moves()), dtype=np.float64)
    time = np.linspace(0.0, 1.0, _SAMPLES + 1)
    weights = np.vander(time, 4, increasing=True) @ BASIS
    square = _worst_square(moves, np.array(stretch), weights)
    between = _CURVATURE * max(stretch) * (0.5 / _SAMPLES) ** 2 / 2.0
    return math.sqrt(square) - between


def _relative_moves() -> set[tuple[int, ...]]:
    """By how much the difference of two robots changes in a step."""
    single = [
        (0, 0, 0),
        *(tuple(r) for e in np.eye(3, dtype=int) for r in (e.tolist(), (-e).tolist())),
    ]
    return {
        tuple(b - a for a, b in zip(first, second)) for first, second in product(single, single)
    }


@kernel
def _worst_square(moves: FloatArray, stretch: FloatArray, weights: FloatArray) -> float:
    """Least square of the stretched distance over all windows whose inner differences are small."""
    least = np.inf
    d = np.zeros((4, 3))
    for cell in range(125):
        d[1] = cell % 5 - 2, cell // 5 % 5 - 2, cell // 25 - 2
        if not _apart(d[1]):
            continue
        for j in range(len(moves)):
            d[2] = d[1] + moves[j]
            if not (_apart(d[2]) and _apart(d[1] + d[2])):
                continue
            for i in range(len(moves)):
                d[0] = d[1] - moves[i]
                if not (_apart(d[0]) and _apart(d[0] + d[1])):
                    continue
                for k in range(len(moves)):
                    d[3] = d[2] + moves[k]
                    if _apart(d[3]) and _apart(d[2] + d[3]):
                        least = min(least, _least_square(d, stretch, weights))
    return least


@kernel
def _apart(difference: FloatArray) -> bool:
    """Whether it is not zero: as a difference, one vertex; as a sum of two, an exchange."""
    return bool(difference[0] != 0.0 or difference[1] != 0.0 or difference[2] != 0.0)


@kernel
def _least_square(d: FloatArray, stretch: FloatArray, weights: FloatArray) -> float:
    least = np.inf
    for t in range(len(weights)):
        square = 0.0
        for axis in range(3):
            along = 0.0
            for k in range(4):
                along += weights[t, k] * d[k, axis]
            square += (along * stretch[axis]) ** 2
        least = min(least, square)
    return least


@typed
def least_spacing(
    distance: Annotated[float, POSITIVE_M], scaling: tuple[float, float, float]
) -> FloatArray:
    """Spacing (3,), m, at which any valid plan keeps a scaled distance, m.

    Distances are divided by `scaling`, the diagonal of Theta, such as (1, 1, 6).

    Raises:
        ValueError: the distance is not positive and finite.
    """
    return np.array(scaling) * distance / worst_clearance()


def smallest_distance(
    flight: SplineFlight, scaling: tuple[float, float, float], samples: int = 8
) -> float:
    """Smallest scaled distance of any two robots of a flight, at samples of each step, m."""
    from scipy.spatial import cKDTree

    if flight.num_robots < 2:
        return math.inf
    times = np.arange(flight.num_steps * samples + 1) * (flight.step_s / samples)
    least = math.inf
    for time in times:
        points = flight.reference(float(time)).position / np.array(scaling)
        distance, _ = cKDTree(points).query(points, k=2)
        least = min(least, float(distance[:, 1].min()))
    return least


GROWTH = 1.05
"""From one spacing that is tried to the next."""
_LARGEST = 40  # spacings tried at most


class SpacedFlight(NamedTuple):
    """A plan at the spacing that was found."""

    flight: SplineFlight
    """The flight along the plan."""
    spacing: FloatArray
    """(3,) m."""
    largest_force_g: float
    """Largest vertical interaction force on any robot, grams."""


def largest_force_g(
    flight: SplineFlight, team: Team, model: InteractionModel, samples: int = 4
) -> float:
    """Largest vertical interaction force that a model says for a flight of a team, grams."""
    times = np.arange(flight.num_steps * samples + 1) * (flight.step_s / samples)
    states = [flight.reference(float(t)) for t in times]
    position = np.array([state.position for state in states])
    velocity = np.array([state.velocity for state in states])
    force = model.forces(position, velocity, team)
    return float(np.abs(force[..., 2]).max() / GRAM_FORCE)


@typed
def space_for_forces(
    paths: npt.NDArray[np.integer],
    team: Team,
    model: InteractionModel,
    limit_g: Annotated[float, POSITIVE],
    *,
    speed: float = 2.0,
    acceleration: float = 5.0,
    floor: float = 0.5,
    heights: Sequence[float] = (1.0, 1.5, 2.0, 3.0),
    clearance_factor: float = 1.5,
) -> SpacedFlight:
    """The flight along a plan at the least volume of a cell at which forces stay within a limit.

    Args:
        paths: (T + 1, n, 3) vertices of a valid plan.
        team: the n vehicles.
        model: of the forces.
        limit_g: vertical force on any robot, grams.
        speed: by axis, m/s.
        acceleration: by axis, m/s^2.
        floor: height of the lowest layer, m.
        heights: ratios of the vertical to the horizontal spacing that are tried.
        clearance_factor: least distance of any two robots, over the largest sum of their radii.

    Raises:
        ValueError: the limit is not positive, or no spacing up to seven times the least one is wide
            enough: a robot alone may already feel more.
    """
    touching = 2.0 * max(vehicle.radius for vehicle in team)
    found: list[SpacedFlight] = []
    for ratio in heights:
        level = clearance_factor * touching / worst_clearance((1.0, 1.0, float(ratio)))
        for _ in range(_LARGEST):
            spacing = level * np.array([1.0, 1.0, ratio])
            step = shortest_step(spacing, speed, acceleration)
            flight = on_grid(paths, spacing, np.array([0.0, 0.0, floor]), step)
            force = largest_force_g(flight, team, model)
            if force <= limit_g:
                found.append(SpacedFlight(flight, spacing, force))
                break
            level *= GROWTH
    if not found:
        raise ValueError(
            f"no spacing keeps the vertical force within {limit_g} g; robots alone may feel as much"
        )
    return min(found, key=lambda one: float(np.prod(one.spacing)))
