"""Calibration offsets: the constant force that a vehicle seems to feel far from everything.

The label is mass times acceleration minus modeled thrust, so a wrong mass, thrust curve or
battery reading gives a bias (small drones about -1 g, large ones about +2 g). It is no
aerodynamics, and the force model of an environment must not carry it.

The bias differs between vehicles of one type by a gram, and drifts from flight to flight: in
flights of a lone large drone above the ground effect its mean goes from +0.3 to +4.7 g, and
between the thirds of one such flight by 0.6 g (median). So each flight of each vehicle has its own
offset, drawn towards the vehicle's own where a flight has few quiet rows.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from swarm_envs.state import BoolArray, FloatArray
from swarm_envs.training.interaction_rows.row_tables import vehicle_name
from swarm_envs.training.interaction_rows.rows import InteractionRows
from swarm_envs.vehicles import VEHICLES

__all__ = ["NO_OFFSETS", "RULE", "Offsets", "estimate_offsets", "quiet_rows", "subtract_offsets"]

QUIET_HEIGHT_M = 0.3  # A row below this height is not quiet, m
QUIET_SPEED = 0.5  # Nor is one at this speed or above, m/s
QUIET_LATERAL_M = 0.25  # Nor one with a neighbor laterally nearer than this, m
QUIET_BELOW_M = 0.2  # Unless the neighbor is farther below than this, m
LEAST_ROWS = 30
"""Quiet rows that a vehicle's offset needs."""
PLAUSIBLE_SHARE = 0.15
"""Offset over weight above which the mass or the thrust curve can hardly be right."""
PRIOR_ROWS = 100.0  # Weight of the vehicle's offset in a flight's, in rows

RULE = (
    f"a row is quiet where height > {QUIET_HEIGHT_M} m, speed < {QUIET_SPEED} m/s and every "
    f"neighbor is > {QUIET_LATERAL_M} m away laterally or > {QUIET_BELOW_M} m below; a vehicle's "
    "offset is the median vertical label of its quiet training rows; a flight's offset is the "
    "median of its n quiet training rows, weighted n to the vehicle's offset weighted "
    f"{PRIOR_ROWS:g}"
)
"""The rule in one sentence, for reports."""


@dataclass(frozen=True)
class Offsets:
    """Vertical calibration offsets in gram-force."""

    vehicle: dict[int, float]
    """By vehicle id."""
    flight: dict[tuple[int, int], float]
    """By vehicle id and flight; a pair that is missing has its vehicle's offset."""

    def of(self, rows: InteractionRows) -> FloatArray:
        """Offset of each row, (R,); zero for a vehicle without an estimate."""
        offset: FloatArray = np.zeros(len(rows))
        for vehicle, value in self.vehicle.items():
            offset[rows.vehicle == vehicle] = value
        for (vehicle, flight), value in self.flight.items():
            offset[(rows.vehicle == vehicle) & (rows.flight == flight)] = value
        return offset


NO_OFFSETS = Offsets({}, {})
"""For rows whose labels are exact, such as those of a simulator."""


def quiet_rows(rows: InteractionRows, max_speed: float = QUIET_SPEED) -> BoolArray:
    """Rows in which nothing aerodynamic should act but drag: (R,) mask.

    The rule: height above 0.3 m (the ground effect of both types has ended), speed below
    `max_speed`, and every neighbor either more than 0.25 m away laterally (outside the measured
    wakes) or more than 0.2 m below.
    """
    lateral = np.linalg.norm(rows.neighbor[..., :2], axis=-1)
    harmless = (lateral > QUIET_LATERAL_M) | (rows.neighbor[..., 2] < -QUIET_BELOW_M)
    alone = np.all(harmless | ~rows.has_neighbor, axis=1)
    slow = np.linalg.norm(rows.velocity, axis=1) < max_speed
    aloft = rows.position[:, 2] > QUIET_HEIGHT_M
    return np.asarray(alone & slow & aloft, dtype=np.bool_)


def estimate_offsets(rows: InteractionRows, axis: int = 2) -> Offsets:
    """Estimate offsets from quiet training rows by the rule of `RULE`, along x, y or z.

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
    """Return rows whose vertical labels are free of the offsets."""
    return rows.with_vertical_force(rows.force_g[:, 2] - offsets.of(rows))


def implausible_offsets(rows: InteractionRows, offsets: Offsets) -> list[str]:
    """Return a note for each vehicle whose mass or thrust curve can hardly be right."""
    notes = []
    for vehicle, offset_g in offsets.vehicle.items():
        kind = rows.types[int(rows.ego_type[rows.vehicle == vehicle][0])]
        masses = [v.mass for v in VEHICLES.values() if v.interaction_type == kind]
        share = abs(offset_g) / (1000.0 * masses[0]) if masses else 0.0
        if share > PLAUSIBLE_SHARE:
            notes.append(
                f"the calibration offset of vehicle {vehicle_name(rows, vehicle)!r} is "
                f"{100 * share:.0f} % of its weight, but {100 * PLAUSIBLE_SHARE:.0f} % is usual at "
                "most; check mass, voltage and rotors"
            )
    return notes
