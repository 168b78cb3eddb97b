"""An episode as a task draws it: starts, goals of every stage, motions; how it is kept."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from swarm_envs.state import FloatArray
from swarm_envs.tables import World, new_world


class Orbit(NamedTuple):
    """Ellipses on which drones circle: center + first cos(angle) + second sin(angle)."""

    center: FloatArray
    """(N, 3) centres, m."""
    first: FloatArray
    """(N, 3) half axes to which angle zero points, m."""
    second: FloatArray
    """(N, 3) half axes to which a quarter turn points, m."""
    rate: FloatArray
    """(N,) angular rates, rad/s."""
    phase: FloatArray
    """(N,) angles at time zero, rad."""


class Placement(NamedTuple):
    """One episode of one environment, as a task draws it."""

    start: FloatArray
    """(N, 3) start positions, m."""
    goals: FloatArray
    """(S, N, 3) goal positions of each stage, m."""
    duration: float = 0.0
    """Seconds that the reference takes from one stage to the next; 0 if it rests at the goals."""
    orbit: Orbit | None = None
    """What the reference circles on, if it does."""


def place(world: World, e: int, placement: Placement) -> None:
    """Keep a new episode of environment `e` in the tables; its first stage begins."""
    drones, goals = world.drones[e], placement.goals
    drones["start"], drones["goal"], world.goals[e] = placement.start, goals[0], goals
    world.environments["duration"][e] = placement.duration
    if placement.orbit is not None:
        drones["orbit"] = np.stack(placement.orbit[:3], axis=1)
        drones["orbit_rate"], drones["orbit_phase"] = placement.orbit.rate, placement.orbit.phase


def world_of(placement: Placement) -> World:
    """The tables of a single environment that begins with a placement."""
    stages, drones, _ = placement.goals.shape
    world = new_world(1, drones, stages)
    place(world, 0, placement)
    return world
