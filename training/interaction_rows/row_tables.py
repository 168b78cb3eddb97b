"""Tables of rows: checks, vehicle types, and names of vehicles."""

from __future__ import annotations

import dataclasses

import numpy as np

from swarm_envs.training.interaction_rows.rows import NO_NEIGHBOR, InteractionRows

__all__ = ["check_row_table", "vehicle_name", "with_present_types"]


def with_present_types(rows: InteractionRows) -> InteractionRows:
    """Return the rows with only those types that some drone or neighbor has."""
    used = sorted({*np.unique(rows.ego_type).tolist(), *np.unique(rows.neighbor_type).tolist()})
    used = [index for index in used if index != NO_NEIGHBOR]
    place = np.full(len(rows.types) + 1, NO_NEIGHBOR)  # the last entry is for empty slots
    place[used] = np.arange(len(used))
    return dataclasses.replace(
        rows,
        types=tuple(rows.types[index] for index in used),
        ego_type=place[rows.ego_type],
        neighbor_type=place[rows.neighbor_type],
    )


def vehicle_name(rows: InteractionRows, vehicle: int) -> str:
    """Return the name of a vehicle, or its number if it has none."""
    return rows.vehicle_names.get(vehicle, str(vehicle))


LIMITS = {
    "position": (200.0, "m, world frame"),
    "velocity": (30.0, "m/s, world frame"),
    "neighbor": (400.0, "m and m/s, relative to the drone"),
    "force_g": (200.0, "gram-force"),
    "torque": (0.05, "N m"),
}
"""Largest magnitude of the numbers of an array, and their unit."""
LOWEST_M = -0.5  # Lowest allowed height, m; the ground is at 0


def check_row_table(rows: InteractionRows) -> None:
    """Check the values of a table.

    Raises:
        ValueError: it has no row, a duplicate row, or a number outside `LIMITS`.
    """
    if not len(rows):
        raise ValueError("it has no row; add rows or remove the file")
    _check_twice(rows)
    for name, (most, unit) in LIMITS.items():
        values = getattr(rows, name)
        if values is not None and np.abs(values).max(initial=0.0) > most:
            index = tuple(int(i) for i in np.argwhere(np.abs(values) > most)[0])
            raise ValueError(
                f"{name} is {values[index]:g} at index {index}, but must lie between {-most:g} and "
                f"{most:g} ({unit})"
            )
    lowest = int(np.argmin(rows.position[:, 2]))
    if rows.position[lowest, 2] < LOWEST_M:
        raise ValueError(
            f"position is {rows.position[lowest, 2]:g} at index ({lowest}, 2), but heights must "
            f"be at least {LOWEST_M:g} m: z points up, and the ground is at 0"
        )


def _check_twice(rows: InteractionRows) -> None:
    key = np.stack([rows.flight, rows.vehicle, rows.step], axis=1)
    found, first, count = np.unique(key, axis=0, return_index=True, return_counts=True)
    if (count > 1).any():
        k = int(np.argmax(count > 1))
        flight, vehicle, step = (int(value) for value in found[k])
        raise ValueError(
            f"step {step} of flight {flight} occurs {count[k]} times for vehicle {vehicle} "
            f"(first in row {first[k]}), but must occur once; remove duplicates, or number flights "
            "and steps uniquely"
        )
