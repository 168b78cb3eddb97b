"""Which entries of a flight become rows: the filter of the Neural-Swarm authors."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from swarm_envs.interactions.field import INTERACTION_VOLUME
from swarm_envs.state import BoolArray, FloatArray, IntArray
from swarm_envs.training.collection.table import TYPES, scenario_name
from swarm_envs.training.flight_logs.clock import ClockedFlight
from swarm_envs.training.interaction_rows import NO_NEIGHBOR

LOWEST_M = {"S": 0.07, "L": 0.085}
"""Height that a row's drone must be above, by interaction type: it stands on its legs below."""
LARGEST_G = 50.0
"""Largest vertical force: more is an impact."""
LARGEST_UPWARD_G = 35.0
"""Largest upward force aloft."""
ALOFT_M = 0.25
"""Height from which on a drone is away from the ground, m."""


class DroneRows(NamedTuple):
    """Rows of one drone in one flight, R of them, K neighbour slots; see `InteractionRows`."""

    name: str
    """Of the physical vehicle that feels the force."""
    ego_type: int
    """Index of its type."""
    scenario: str
    """Who flew around it, such as `L2S`."""
    step: IntArray
    """(R,) entry of the clock."""
    position: FloatArray
    """(R, 3) its position, m."""
    velocity: FloatArray
    """(R, 3) its velocity, m/s."""
    neighbor: FloatArray
    """(R, K, 6) positions and velocities of neighbours relative to it, m and m/s."""
    neighbor_type: IntArray
    """(R, K) indices of their types; -1 where there is none."""
    force_g: FloatArray
    """Force on it, gram-force."""
    dropped: dict[str, int]
    """Entries left out, by reason."""

    def select(self, keep: BoolArray, reason: str) -> DroneRows:
        """Return only the rows of an (R,) mask; the others are counted under `reason`."""
        arrays = ("step", "position", "velocity", "neighbor", "neighbor_type", "force_g")
        counts = self.dropped | {reason: self.dropped.get(reason, 0) + int((~keep).sum())}
        kept = {name: getattr(self, name)[keep] for name in arrays}
        return self._replace(**kept, dropped=counts)


def drone_rows(flight: ClockedFlight, force_g: FloatArray, i: int, keep_every: int) -> DroneRows:
    """Rows of drone i of a flight of N, with N - 1 neighbour slots, filtered.

    Args:
        flight: N drones at T times.
        force_g: (T, N, 3) their labels, NaN where unknown.
        i: which drone feels the force.
        keep_every: every so many entries one row.
    """
    kinds = [vehicle.interaction_type for vehicle in flight.team]
    others = [j for j in range(len(kinds)) if j != i]
    p, v = flight.position, flight.velocity
    apart = np.concatenate([p[:, others] - p[:, i, None], v[:, others] - v[:, i, None]], axis=-1)
    types = np.array([TYPES.index(kinds[j]) for j in others], dtype=np.int64)
    count = len(flight.time)
    rows = DroneRows(
        name=flight.names[i],
        ego_type=TYPES.index(kinds[i]),
        scenario=scenario_name(kinds[i], [kinds[j] for j in others]),
        step=np.arange(count),
        position=p[:, i],
        velocity=v[:, i],
        neighbor=apart,
        neighbor_type=np.broadcast_to(types, (count, len(others))),
        force_g=force_g[:, i],
        dropped={},
    )
    rows = rows.select(rows.step % keep_every == 0, "between kept entries")
    return filtered(rows, LOWEST_M[kinds[i]])


def filtered(rows: DroneRows, lowest_m: float) -> DroneRows:
    """Apply the authors' filter; see the numbers of this module."""
    rows = rows.select(_all(np.isfinite(rows.force_g)), "force unknown")
    if rows.neighbor.shape[1]:
        near = ~_all(~_all(np.abs(rows.neighbor[..., :3]) <= INTERACTION_VOLUME))
        rows = rows.select(near, "no neighbour in the volume")
    rows = rows.select(rows.position[:, 2] > lowest_m, "too low")
    rows = rows.select(np.abs(rows.force_g[:, 2]) <= LARGEST_G, "force over 50 g")
    low = rows.position[:, 2] <= ALOFT_M
    fair = (rows.force_g[:, 2] <= LARGEST_UPWARD_G) | low
    return rows.select(fair, "upward force over 35 g aloft")


def _all(mask: BoolArray) -> BoolArray:
    return np.asarray(mask.all(axis=-1))


def padded(rows: DroneRows, slots: int) -> tuple[FloatArray, IntArray]:
    """Neighbours (R, K, 6) and their types (R, K), empty slots filled up to K = `slots`."""
    missing = ((0, 0), (0, slots - rows.neighbor.shape[1]))
    neighbor = np.pad(rows.neighbor, (*missing, (0, 0)))
    return neighbor, np.pad(rows.neighbor_type, missing, constant_values=NO_NEIGHBOR)
