"""Functions of tasks with successive goals, which are evaluated by a score."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

import numpy as np

from swarm_envs.compiled import part
from swarm_envs.state import FloatArray
from swarm_envs.tables import Record, Records

SCORED_WEIGHTS: Mapping[str, float] = MappingProxyType(
    {
        "progress": 0.5,
        "at_goal": 0.0,
        "tracking": 0.0,
        "effort": -0.1,
        "proximity": -4.0,
        "crash": -5.0,
        "success": 0.0,
    }
)
"""Default weights of the reward terms, which do not depend on the time limit."""


@part
def send_to(d: Record, goal: FloatArray) -> None:
    """Give a drone a new goal (3,), m, after the evaluation of a decision.

    Its last distance is set so that the reward term `progress` of this decision still counts the
    motion toward the previous goal.
    """
    covered, square = d.last_distance - d.distance, 0.0
    for k in range(3):
        d.goal[k] = d.reference_position[k] = goal[k]
        square += (d.position[k] - goal[k]) ** 2
    d.distance = np.sqrt(square)
    d.last_distance, d.arrival = d.distance + covered, np.inf


@part
def end_by_score(environment: Record, drones: Records, rules: Record) -> None:
    """Mark an episode as a success at its time limit, by its score and if no drone (N,) crashed."""
    won = environment.truncated and environment.score >= rules.least_score
    for i in range(drones.shape[0]):
        won = won and drones[i].incidents == 0.0
    if won:
        environment.succeeded, environment.achieved = True, 1.0
