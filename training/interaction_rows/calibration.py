"""Calibration offsets: the constant bias of the labels of a vehicle, far from other objects.

The label is mass times acceleration minus modeled thrust, so a wrong mass, thrust curve or
battery reading gives a bias (small drones about -1 g, large ones about +2 g). It is not
aerodynamic, and must not be part of the force model of an environment.

The bias differs between vehicles of one type by a gram, and drifts from flight to flight: in
flights of a lone large drone above the ground effect its mean varies from +0.3 to +4.7 g, and
between the thirds of one such flight by 0.6 g (median). So each flight of each vehicle has its own
offset, shrunk toward the vehicle's offset if the flight has few quiet rows.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from swarm_envs.state import BoolArray, FloatArray
from swarm_envs.training.interaction_rows.row_tables import vehicle_name
from swarm_envs.training.interaction_rows.rows import InteractionRows

__all__ = ["NO_OFFSETS", "Offsets", "estimate_offsets", "quiet_rows", "subtract_offsets"]

QUIET_HEIGHT_M = 0.3  # Least height of a quiet row, m
QUIET_SPEED = 0.5  # Largest speed of a quiet row, m/s
QUIET_LATERAL_M = 0.25  # Least horizontal distance of neighbors in a quiet row, m,
QUIET_BELOW_M = 0.2  # unless they are more than this far below, m
LEAST_ROWS = 30
"""Least number of quiet rows for a vehicle's offset."""
PRIOR_ROWS = 100.0  # Weight of the vehicle's offset in a flight's offset, in rows


@dataclass(frozen=True)
class Offsets:
    """Vertical calibration offsets in gram-force."""

    vehicle: dict[int, float]
    """Offsets by vehicle id."""
    flight: dict[tuple[int, int], float]
    """Offsets by vehicle id and flight; a missing pair has its vehicle's offset."""

    def of(self, rows: InteractionRows) -> FloatArray:
        """Return the offset of each row, (R,); zero for a vehicle without an estimate."""
        offset: FloatArray = np.zeros(len(rows))
        for vehicle, value in self.vehicle.items():
            offset[rows.vehicle == vehicle] = value
        for (vehicle, flight), value in self.flight.items():
            offset[(rows.vehicle == vehicle) & (rows.flight == flight)] = value
        return offset


NO_OFFSETS = Offsets({}, {})
"""Offsets of rows with exact labels, such as simulated ones."""


def quiet_rows(rows: InteractionRows, max_speed: float = QUIET_SPEED) -> BoolArray:
    """Return the mask (R,) of rows without aerodynamic forces except drag.

    They have a height above 0.3 m (outside the ground effect of both types), a speed below
    `max_speed`, and every neighbor is either more than 0.25 m away horizontally (outside the
    measured wakes) or more than 0.2 m below.
    """
    lateral = np.linalg.norm(rows.neighbor[..., :2], axis=-1)
    harmless = (lateral > QUIET_LATERAL_M) | (rows.neighbor[..., 2] < -QUIET_BELOW_M)
    alone = np.all(harmless | ~rows.has_neighbor, axis=1)
    slow = np.linalg.norm(rows.velocity, axis=1) < max_speed
    aloft = rows.position[:, 2] > QUIET_HEIGHT_M
    return np.asarray(alone & slow & aloft, dtype=np.bool_)


def estimate_offsets(rows: InteractionRows, axis: int = 2) -> Offsets:
    """Estimate offsets from quiet training rows, along x, y or z.

    A vehicle's offset is the median label of its quiet rows. A flight's offset is the median of
    its n quiet rows, weighted n, and the vehicle's offset, weighted `PRIOR_ROWS`.

    Raises:
        ValueError: a vehicle has fewer quiet training rows than `LEAST_ROWS`.
    """
    quiet = rows.select(quiet_rows(rows) & ~rows.validation)
    vehicles, flights = {}, {}
    for vehicle in np.unique(rows.vehicle):
        own = quiet.select(quiet.vehicle == vehicle)
        if len(own) < LEAST_ROWS:
            raise ValueError(
                f"vehicle {vehicle_name(rows, vehicle)!r} has {len(own)} training rows aloft, slow "
                f"and away from wakes, but must have {LEAST_ROWS} for its calibration offset; fly "
                "it alone for half a minute, leave it out, or fit with --offsets none if its "
                "labels are exact"
            )
        usual = float(np.median(own.force_g[:, axis]))
        vehicles[int(vehicle)] = usual
        for flight in np.unique(own.flight):
            labels = own.force_g[own.flight == flight, axis]
            share = len(labels) / (len(labels) + PRIOR_ROWS)
            drift = float(np.median(labels)) - usual
            flights[int(vehicle), int(flight)] = usual + share * drift
    return Offsets(vehicles, flights)


def subtract_offsets(rows: InteractionRows, offsets: Offsets) -> InteractionRows:
    """Return rows with the offsets subtracted from the vertical labels."""
    return rows.with_vertical_force(rows.force_g[:, 2] - offsets.of(rows))
