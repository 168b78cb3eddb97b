"""What an episode is judged by: how well the reference was followed, how near drones came."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from swarm_envs.compiled import borrowing_kernel
from swarm_envs.physics.contact import Contacts
from swarm_envs.state import FloatArray, IntArray
from swarm_envs.tasks.mission import Mission

NEAR_MISS = 1.5
"""Drones that come closer than this times the sum of their radii had a near miss."""


class Record(NamedTuple):
    """What decisions add up to over an episode: arrays that lead with (E, N)."""

    separation: FloatArray
    """(E, N) smallest distance to another drone so far, m."""
    clearance: FloatArray
    """(E, N) the same over the sum of radii."""
    obstacle_clearance: FloatArray
    """(E, N) smallest distance to an obstacle so far, over the radius."""
    worst_error: FloatArray
    """(E, N) largest distance to the reference so far, m."""
    worst_height_error: FloatArray
    """(E, N) largest vertical distance to the reference so far, m."""
    squared_error: FloatArray
    """(E, N) sum of the squared distance to the reference, m^2."""
    scored: IntArray
    """(E,) decisions whose error counts."""
    arrival: FloatArray
    """(E, N) time at which the drone last came to its goal, s; infinite if it is not there."""


def new_record(num_envs: int, num_drones: int) -> Record:
    """A record of environments that have not begun."""
    shape = (num_envs, num_drones)
    return Record(
        separation=np.full(shape, np.inf),
        clearance=np.full(shape, np.inf),
        obstacle_clearance=np.full(shape, np.inf),
        worst_error=np.zeros(shape),
        worst_height_error=np.zeros(shape),
        squared_error=np.zeros(shape),
        scored=np.zeros(num_envs, np.int64),
        arrival=np.full(shape, np.inf),
    )


@borrowing_kernel
def clear_record(e: int, record: Record) -> None:
    """Begin anew in environment `e`."""
    record.scored[e] = 0
    for i in range(record.arrival.shape[1]):
        record.separation[e, i] = record.clearance[e, i] = np.inf
        record.obstacle_clearance[e, i] = record.arrival[e, i] = np.inf
        record.worst_error[e, i] = record.worst_height_error[e, i] = 0.0
        record.squared_error[e, i] = 0.0


@borrowing_kernel
def measure(
    e: int,
    position: FloatArray,
    reference: FloatArray,
    contacts: Contacts,
    mission: Mission,
    time: FloatArray,
    radius: float,
    settle_s: float,
    record: Record,
    error: FloatArray,
) -> None:
    """Measure the drones of environment `e` against goal and reference, and add to the record.

    Args:
        e: the environment.
        position: (E, N, 3) m.
        reference: (E, N, 3) m.
        contacts: of this decision.
        mission: its distances to the goal are updated.
        time: (E,) s.
        radius: how near counts as arrived, m.
        settle_s: errors count from this time on, s.
        record: changed in place.
        error: (N,) distance to the reference, m, written.
    """
    goal, distance = mission.goal, mission.distance
    scores = time[e] >= settle_s
    record.scored[e] += scores
    for i in range(position.shape[1]):
        to_goal = 0.0
        to_reference = 0.0
        for k in range(3):
            to_goal += (position[e, i, k] - goal[e, i, k]) ** 2
            to_reference += (position[e, i, k] - reference[e, i, k]) ** 2
        distance[e, i], error[i] = math.sqrt(to_goal), math.sqrt(to_reference)
        height = abs(position[e, i, 2] - reference[e, i, 2])
        record.separation[e, i] = min(record.separation[e, i], contacts.separation[e, i])
        record.clearance[e, i] = min(record.clearance[e, i], contacts.clearance[e, i])
        near = min(record.obstacle_clearance[e, i], contacts.obstacle_clearance[e, i])
        record.obstacle_clearance[e, i] = near
        if scores:
            record.worst_error[e, i] = max(record.worst_error[e, i], error[i])
            record.worst_height_error[e, i] = max(record.worst_height_error[e, i], height)
            record.squared_error[e, i] += to_reference
        if distance[e, i] >= radius:
            record.arrival[e, i] = np.inf
        elif record.arrival[e, i] == np.inf:
            record.arrival[e, i] = time[e]
