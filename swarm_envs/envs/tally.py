"""What an episode's physics adds up to: forces against their bounds, energy, extrapolation."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from swarm_envs.compiled import borrowing_kernel
from swarm_envs.physics.rigid_body import TIME_STEP
from swarm_envs.physics.step import World
from swarm_envs.state import FloatArray, IntArray
from swarm_envs.vehicles import GRAM_FORCE, Team

AIR_DENSITY = 1.225
"""Density of air at sea level, kg/m^3."""
FORCE_BOUNDS_G: Mapping[str, float] = {"S": 5.0, "S*": 5.0, "L": 10.0}
"""Bounds on the vertical interaction force by vehicle token, gram-force: those with which
Neural-Swarm2 plans (Sec. VII-D, Fig. 6)."""


class Tally(NamedTuple):
    """What an episode's physics adds up to: arrays (E, N)."""

    worst_force: FloatArray
    """Largest interaction force so far, N."""
    energy: FloatArray
    """Ideal induced energy of the rotors, J: the integral of T^1.5 / sqrt(2 rho A) per rotor."""
    outside: IntArray
    """Physics steps with an interaction force extrapolated past what was measured."""
    steps: IntArray
    """Physics steps flown."""
    over_bound: IntArray
    """Physics steps in which the vertical interaction force was above the drone's bound."""


def new_tally(num_envs: int, num_drones: int) -> Tally:
    """The tally of flights that have not begun."""
    shape = (num_envs, num_drones)
    counts = (np.zeros(shape, dtype=np.int64) for _ in range(3))
    return Tally(np.zeros(shape), np.zeros(shape), *counts)


class Airframe(NamedTuple):
    """What the tally knows of the drones."""

    power_step: FloatArray
    """(E, N) energy of a rotor over one physics step for a thrust of 1 N, J."""
    force_bound: FloatArray
    """(E, N) bound on the vertical interaction force, N."""


def airframe_of(team: Team, bounds_g: Mapping[str, float], num_envs: int = 1) -> Airframe:
    """What the tally knows of a team.

    Args:
        team: the vehicles.
        bounds_g: bound on the vertical interaction force by vehicle token, gram-force; types that
            are left out have none.
        num_envs: how many environments it flies.
    """
    areas = [math.pi * vehicle.rotor_radius**2 for vehicle in team]
    power = [TIME_STEP / math.sqrt(2.0 * AIR_DENSITY * area) for area in areas]
    bound = [bounds_g.get(vehicle.token, np.inf) * GRAM_FORCE for vehicle in team]
    return Airframe(*(np.repeat(np.array([row]), num_envs, axis=0) for row in (power, bound)))


@borrowing_kernel
def clear_tally(e: int, tally: Tally) -> None:
    """Begin anew in environment `e`."""
    for i in range(tally.steps.shape[1]):
        tally.worst_force[e, i] = tally.energy[e, i] = 0.0
        tally.outside[e, i] = tally.steps[e, i] = tally.over_bound[e, i] = 0


@borrowing_kernel
def count(e: int, world: World, tally: Tally, airframe: Airframe) -> None:
    """Add one physics step of environment `e`, its force just evaluated, to the tally.

    Args:
        e: the environment.
        world: its state, at the beginning of the step.
        tally: changed in place.
        airframe: what the tally knows of the drones.
    """
    force, thrust = world.force, world.state.rotor_thrust
    for i in range(airframe.force_bound.shape[1]):
        size = 0.0
        for k in range(3):
            size += force[e, i, k] * force[e, i, k]
        tally.worst_force[e, i] = max(tally.worst_force[e, i], math.sqrt(size))
        power = 0.0
        for r in range(4):
            power += thrust[e, i, r] * math.sqrt(max(thrust[e, i, r], 0.0))
        tally.energy[e, i] += power * airframe.power_step[e, i]
        tally.outside[e, i] += world.outside[e, i]
        tally.steps[e, i] += 1
        tally.over_bound[e, i] += abs(force[e, i, 2]) > airframe.force_bound[e, i]
