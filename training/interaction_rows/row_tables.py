"""Tables of rows: which are refused, and how several become one."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np

from swarm_envs.state import IntArray
from swarm_envs.training.interaction_rows.rows import NO_NEIGHBOR, InteractionRows
from swarm_envs.vehicles import VEHICLES

__all__ = ["check_row_table", "join_rows", "vehicle_name", "with_present_types"]


def join_rows(tables: Sequence[InteractionRows]) -> InteractionRows:
    """Put tables one after the other.

    Flights are numbered again, so that none collide. Vehicles are the same if they have the same
    name (or, without one, number) and type. Types, scenarios and neighbour slots are those of any
    table. The torque stays if every table has it.

    Raises:
        ValueError: there is no table.
    """
    if not tables:
        raise ValueError("no table of rows to join; give at least one")
    types = tuple(dict.fromkeys(name for table in tables for name in table.types))
    scenarios = tuple(sorted({name for table in tables for name in table.scenario_names}))
    slots = max(table.neighbor_type.shape[1] for table in tables)
    vehicles: dict[tuple[str, str], int] = {}
    parts, flights = [], 0
    for table in tables:
        part = dataclasses.replace(_padded(table, slots), types=types, scenario_names=scenarios)
        flight = np.unique(table.flight, return_inverse=True)[1].reshape(-1)
        place = np.array([*(types.index(name) for name in table.types), NO_NEIGHBOR])
        order = np.array([scenarios.index(name) for name in table.scenario_names])
        part = dataclasses.replace(
            part,
            ego_type=place[table.ego_type],
            neighbor_type=place[part.neighbor_type],
            scenario=order[table.scenario],
            flight=flight + flights,
            vehicle=_vehicles(table, vehicles),
        )
        flights += int(flight.max(initial=-1)) + 1
        parts.append(part)
    return _concatenated(parts, _names(vehicles))


def with_present_types(rows: InteractionRows) -> InteractionRows:
    """Return the rows with only those types that some drone or neighbour has."""
    used = sorted({*np.unique(rows.ego_type).tolist(), *np.unique(rows.neighbor_type).tolist()})
    used = [index for index in used if index != NO_NEIGHBOR]
    place = np.full(len(rows.types) + 1, NO_NEIGHBOR)  # the last entry serves empty slots
    place[used] = np.arange(len(used))
    return dataclasses.replace(
        rows,
        types=tuple(rows.types[index] for index in used),
        ego_type=place[rows.ego_type],
        neighbor_type=place[rows.neighbor_type],
    )


def vehicle_name(rows: InteractionRows, vehicle: int) -> str:
    """Name of a vehicle; its number if it has none."""
    return rows.vehicle_names.get(vehicle, str(vehicle))


def _vehicles(table: InteractionRows, known: dict[tuple[str, str], int]) -> IntArray:
    numbers = np.zeros_like(table.vehicle)
    for vehicle, kind in np.unique(np.stack([table.vehicle, table.ego_type]), axis=1).T:
        key = (vehicle_name(table, int(vehicle)), table.types[kind])
        number = known.setdefault(key, len(known))
        numbers[(table.vehicle == vehicle) & (table.ego_type == kind)] = number
    return numbers


def _names(vehicles: dict[tuple[str, str], int]) -> dict[int, str]:
    """Names by number; one that vehicles of several types have gets the type after it."""
    plain = [name for name, _ in vehicles]
    return {
        number: f"{name} ({kind})" if plain.count(name) > 1 else name
        for (name, kind), number in vehicles.items()
    }


def _padded(table: InteractionRows, slots: int) -> InteractionRows:
    missing = ((0, 0), (0, slots - table.neighbor_type.shape[1]))
    return dataclasses.replace(
        table,
        neighbor=np.pad(table.neighbor, (*missing, (0, 0))),
        neighbor_type=np.pad(table.neighbor_type, missing, constant_values=NO_NEIGHBOR),
    )


def _concatenated(parts: Sequence[InteractionRows], names: dict[int, str]) -> InteractionRows:
    arrays: dict[str, Any] = {
        entry.name: np.concatenate([getattr(part, entry.name) for part in parts])
        for entry in dataclasses.fields(InteractionRows)
        if isinstance(getattr(parts[0], entry.name), np.ndarray) and entry.name != "torque"
    }
    torques = [part.torque for part in parts if part.torque is not None]
    torque = np.concatenate(torques) if len(torques) == len(parts) else None
    changes: dict[str, Any] = arrays | {"torque": torque, "vehicle_names": names}
    return dataclasses.replace(parts[0], **changes)


LIMITS = {
    "position": (200.0, "m, world frame"),
    "velocity": (30.0, "m/s, world frame"),
    "neighbor": (400.0, "m and m/s, relative to the drone"),
    "force_g": (200.0, "gram-force"),
    "torque": (0.05, "N m"),
}
"""Largest magnitude of the numbers of an array, and their unit."""
LOWEST_M = -0.5  # Lowest height that is accepted: the ground is at 0


def check_row_table(rows: InteractionRows) -> tuple[str, ...]:
    """Check a table of finite numbers of the right shapes; return notes on what is odd about it.

    Raises:
        ValueError: it has no row, a row twice, or a number outside of `LIMITS`.
    """
    if not len(rows):
        raise ValueError("it holds no row; add rows or remove the file")
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
    known = {vehicle.interaction_type for vehicle in VEHICLES.values()}
    strange = [name for name in rows.types if name not in known]
    if not strange:
        return ()
    return (f"types {', '.join(map(repr, strange))} belong to no vehicle that ships",)


def _check_twice(rows: InteractionRows) -> None:
    key = np.stack([rows.flight, rows.vehicle, rows.step], axis=1)
    found, first, count = np.unique(key, axis=0, return_index=True, return_counts=True)
    if (count > 1).any():
        k = int(np.argmax(count > 1))
        flight, vehicle, step = (int(value) for value in found[k])
        raise ValueError(
            f"step {step} of flight {flight} is there {count[k]} times for vehicle {vehicle} "
            f"(first in row {first[k]}), but a drone has one row at a time; remove doubles, and "
            "count steps and number flights so that none collide"
        )
