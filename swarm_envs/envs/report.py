"""The metrics of episodes, in names and plain numbers."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from swarm_envs.state import FloatArray, IntArray
from swarm_envs.tasks.base import Success
from swarm_envs.tasks.metrics import NEAR_MISS
from swarm_envs.tasks.motion import REST
from swarm_envs.vehicles import GRAM_FORCE

if TYPE_CHECKING:
    from swarm_envs.envs.core import SwarmCore


def episode_metrics(core: SwarmCore, environments: Sequence[int]) -> list[dict[str, Any]]:
    """What the episodes of these environments are judged by, so far, in their order.

    - `success`: whether the team did its task; `stages_reached` of `stages`: sets of goals at
      which all have stood; `length_s`: time flown.
    - `collided_drones`, `collided_floor`, `collided_wall`, `collided_obstacle`, `tumbled`: number
      of drones that ended so; `near_misses`: drones that came within 1.5 times the sum of radii
      without touching.
    - `minimum_separation_m`: smallest distance between two drones (None if alone);
      `minimum_obstacle_distance_m`: from a drone's centre to an obstacle (None without one).
    - `worst_tracking_error_m`, `rms_tracking_error_m`, `worst_height_error_m`: against the
      reference, over all drones; the lists `..._by_drone_m` say which. None without a reference,
      or before errors count: in `ring` after the start-up. Errors are taken at decisions, so
      compare them at one decision rate.
    - `worst_force_g`: largest force of the air on a drone, its drag included; `energy_j`: ideal
      induced energy of all rotors; `force_bound_violations`: drone-steps of 1/240 s with a
      vertical force above the drone's bound, and `fraction_over_force_bound`: their share of all;
      `fraction_outside_measured_range`: of drone-steps whose force
      was extrapolated.
    - `time_to_goal_s`: when the last drone came to stay at its goal, in the present stage (None
      if one did not, or where goals move).
    """
    where = np.array(environments, dtype=np.int64)
    return [
        {**ended, **_tracking(core, e), **added}
        for e, ended, added in zip(
            environments,
            _by_episode(_ends(core, where)),
            _by_episode(_sums(core, where)),
            strict=True,
        )
    ]


_COUNTS = (
    "collided_drones",
    "collided_floor",
    "collided_wall",
    "collided_obstacle",
    "tumbled",
    "near_misses",
)
"""Numbers of drones that ended so."""
_Columns = dict[str, list[Any]]
"""Metrics by name, each of every episode."""


def _by_episode(columns: _Columns) -> Iterator[dict[str, Any]]:
    return (dict(zip(columns, row, strict=True)) for row in zip(*columns.values(), strict=True))


def _ends(core: SwarmCore, where: IntArray) -> _Columns:
    """How episodes ended, and how near drones came, of environments `where`."""
    contacts, record = core.physics.contacts, core.record
    clearance = record.clearance[where]
    drones = [
        contacts.drone[where] >= 0,
        contacts.floor[where],
        contacts.wall[where],
        contacts.obstacle[where] >= 0,
        contacts.tumbling[where],
        (clearance >= 1.0) & (clearance < NEAR_MISS),
    ]
    to_obstacle = record.obstacle_clearance[where] * core.physics.parameters.radius[where]
    return {
        "success": core.verdict.succeeded[where].tolist(),
        "stages": [int(core.mission.goals.shape[1])] * len(where),
        "stages_reached": core.mission.reached[where].tolist(),
        "length_s": core.time[where].tolist(),
        **dict(zip(_COUNTS, np.array(drones).sum(axis=2).tolist(), strict=True)),
        "minimum_separation_m": _finite(record.separation[where].min(axis=1)),
        "minimum_obstacle_distance_m": _finite(to_obstacle.min(axis=1)),
    }


def _sums(core: SwarmCore, where: IntArray) -> _Columns:
    """What flights of environments `where` add up to."""
    tally = core.flight.tally
    steps = np.maximum(tally.steps[where].sum(axis=1), 1)
    over_bound, outside = (a[where].sum(axis=1) for a in (tally.over_bound, tally.outside))
    arrival = core.record.arrival[where].max(axis=1)
    at_rest = isinstance(core.task.success, Success)
    return {
        "worst_force_g": (tally.worst_force[where].max(axis=1) / GRAM_FORCE).tolist(),
        "energy_j": tally.energy[where].sum(axis=1).tolist(),
        "force_bound_violations": over_bound.tolist(),
        "fraction_over_force_bound": (over_bound / steps).tolist(),
        "fraction_outside_measured_range": (outside / steps).tolist(),
        "time_to_goal_s": _finite(arrival) if at_rest else [None] * len(where),
    }


def _finite(values: FloatArray) -> list[float | None]:
    return [value if math.isfinite(value) else None for value in values.tolist()]


def _tracking(core: SwarmCore, e: int) -> dict[str, Any]:
    record = core.record
    if core.motion.kind == REST or not record.scored[e]:
        names = ("worst_tracking_error_m", "rms_tracking_error_m", "worst_height_error_m")
        return dict.fromkeys(names)
    mean_square = record.squared_error[e].mean() / int(record.scored[e])
    return {
        "worst_tracking_error_m": float(record.worst_error[e].max()),
        "rms_tracking_error_m": float(np.sqrt(mean_square)),
        "worst_height_error_m": float(record.worst_height_error[e].max()),
        "worst_tracking_error_by_drone_m": record.worst_error[e].tolist(),
        "worst_height_error_by_drone_m": record.worst_height_error[e].tolist(),
    }
