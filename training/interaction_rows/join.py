"""Several tables of rows as one."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np

from swarm_envs.training.interaction_rows.rows import NO_NEIGHBOR, IntArray, InteractionRows


def join_rows(tables: Sequence[InteractionRows]) -> InteractionRows:
    """Put tables one after the other.

    Flights are numbered anew, so that none collide. Vehicles are the same if they have the same
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
