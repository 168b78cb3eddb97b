"""The metrics of one episode, in names and plain numbers."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from swarm_envs.tasks.metrics import NEAR_MISS
from swarm_envs.vehicles import GRAM_FORCE

if TYPE_CHECKING:
    from swarm_envs.envs.core import SwarmCore


def episode_metrics(core: SwarmCore, e: int) -> dict[str, Any]:
    """What an episode is judged by.

    - `success`: whether the team did its task; `length_s`: time flown.
    - `collided_drones`, `collided_floor`, `collided_wall`, `tumbled`: number of drones that ended
      so; `near_misses`: drones that came within 1.5 times the sum of radii without touching.
    - `minimum_separation_m`: smallest distance between two drones (None if alone).
    - `worst_tracking_error_m`, `rms_tracking_error_m`, `worst_height_error_m`: against the
      reference, over all drones; the lists `..._by_drone_m` say which. None without a reference.
      Errors are taken at decisions, so compare them at one decision rate.
    - `worst_force_g`: largest force of the air on a drone, its drag included; `energy_j`: ideal
      induced energy of all rotors; `fraction_outside_measured_range`: of drone-steps whose force
      was extrapolated.
    - `time_to_goal_s`: when the last drone came to stay at its goal (None if one did not).
    """
    contacts, record, tally = core.physics.contacts, core.record, core.flight.tally
    clearance = record.clearance[e]
    separation = float(record.separation[e].min())
    arrival = float(record.arrival[e].max())
    return {
        "success": bool(core.verdict.succeeded[e]),
        "length_s": float(core.time[e]),
        "collided_drones": int((contacts.drone[e] >= 0).sum()),
        "collided_floor": int(contacts.floor[e].sum()),
        "collided_wall": int(contacts.wall[e].sum()),
        "tumbled": int(contacts.tumbling[e].sum()),
        "near_misses": int(((clearance >= 1.0) & (clearance < NEAR_MISS)).sum()),
        "minimum_separation_m": separation if np.isfinite(separation) else None,
        **_tracking(core, e),
        "worst_force_g": float(tally.worst_force[e].max()) / GRAM_FORCE,
        "energy_j": float(tally.energy[e].sum()),
        "fraction_outside_measured_range": float(
            tally.outside[e].sum() / max(int(tally.steps[e].sum()), 1)
        ),
        "time_to_goal_s": arrival if np.isfinite(arrival) else None,
    }


def _tracking(core: SwarmCore, e: int) -> dict[str, Any]:
    record = core.record
    if core.mission.duration[e] == 0.0:
        names = ("worst_tracking_error_m", "rms_tracking_error_m", "worst_height_error_m")
        return dict.fromkeys(names)
    mean_square = record.squared_error[e].mean() / max(int(record.decisions[e]), 1)
    return {
        "worst_tracking_error_m": float(record.worst_error[e].max()),
        "rms_tracking_error_m": float(np.sqrt(mean_square)),
        "worst_height_error_m": float(record.worst_height_error[e].max()),
        "worst_tracking_error_by_drone_m": record.worst_error[e].tolist(),
        "worst_height_error_by_drone_m": record.worst_height_error[e].tolist(),
    }
