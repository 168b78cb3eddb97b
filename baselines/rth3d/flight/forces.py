"""The spacing at which a plan's flight respects limits of the interaction force.

RTH3D names forces as future work. On a grid nothing but the spacing decides how hard robots blow on
each other: the smallest one at which a force model says no more than the limit is looked for.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from swarm_envs.baselines.rth3d.flight.clearance import worst_clearance
from swarm_envs.baselines.rth3d.flight.spline import SplineFlight, on_grid, shortest_step
from swarm_envs.interactions import InteractionModel
from swarm_envs.state import FloatArray
from swarm_envs.vehicles import GRAM_FORCE, Team

GROWTH = 1.05
"""From one spacing that is tried to the next."""
_LARGEST = 40
"""Spacings tried at most."""


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
    """Largest vertical interaction force that a model says for a flight, grams.

    Args:
        flight: n robots.
        team: the n vehicles.
        model: of the forces.
        samples: instants of each step.
    """
    times = np.arange(flight.num_steps * samples + 1) * (flight.step_s / samples)
    states = [flight.reference(float(t)) for t in times]
    position = np.array([state.position for state in states])
    velocity = np.array([state.velocity for state in states])
    force = model.forces(position, velocity, team)
    return float(np.abs(force[..., 2]).max() / GRAM_FORCE)


def space_for_forces(
    paths: npt.NDArray[np.integer],
    team: Team,
    model: InteractionModel,
    limit_g: float,
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
    if not limit_g > 0.0:
        raise ValueError(f"limit_g is {limit_g!r}, but must be positive")
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
