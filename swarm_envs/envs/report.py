"""The metrics of one episode, in names and plain numbers."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from swarm_envs.tasks.base import Success
from swarm_envs.tasks.metrics import NEAR_MISS
from swarm_envs.tasks.motion import REST
from swarm_envs.vehicles import GRAM_FORCE

if TYPE_CHECKING:
    from swarm_envs.envs.core import SwarmCore


def episode_metrics(core: SwarmCore, e: int) -> dict[str, Any]:
    """What an episode is judged by.

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
    contacts, record, tally = core.physics.contacts, core.record, core.flight.tally
    clearance = record.clearance[e]
    separation = float(record.separation[e].min())
    steps = max(int(tally.steps[e].sum()), 1)
    arrival = float(record.arrival[e].max())
    arrived = np.isfinite(arrival) and isinstance(core.task.success, Success)
    to_obstacle = float((record.obstacle_clearance[e] * core.physics.parameters.radius[e]).min())
    return {
        "success": bool(core.verdict.succeeded[e]),
        "stages": int(core.mission.goals.shape[1]),
        "stages_reached": int(core.mission.reached[e]),
        "length_s": float(core.time[e]),
        "collided_drones": int((contacts.drone[e] >= 0).sum()),
        "collided_floor": int(contacts.floor[e].sum()),
        "collided_wall": int(contacts.wall[e].sum()),
        "collided_obstacle": int((contacts.obstacle[e] >= 0).sum()),
        "tumbled": int(contacts.tumbling[e].sum()),
        "near_misses": int(((clearance >= 1.0) & (clearance < NEAR_MISS)).sum()),
        "minimum_separation_m": separation if np.isfinite(separation) else None,
        "minimum_obstacle_distance_m": to_obstacle if np.isfinite(to_obstacle) else None,
        **_tracking(core, e),
        "worst_force_g": float(tally.worst_force[e].max()) / GRAM_FORCE,
        "energy_j": float(tally.energy[e].sum()),
        "force_bound_violations": int(tally.over_bound[e].sum()),
        "fraction_over_force_bound": float(tally.over_bound[e].sum() / steps),
        "fraction_outside_measured_range": float(tally.outside[e].sum() / steps),
        "time_to_goal_s": arrival if arrived else None,
    }


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
