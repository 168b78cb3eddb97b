"""Tables of rows: which are refused and how to mend them, and how several become one.

A table holds no angles and no clock, so what can be checked is sizes. The limits lie well outside
of what small quadrotors do; `check_units` of `LogOptions` turns them off.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np

from swarm_envs.state import FloatArray, IntArray
from swarm_envs.training.interaction_rows.rows import NO_NEIGHBOR, InteractionRows
from swarm_envs.vehicles import GRAM_FORCE, GRAVITY, VEHICLES

__all__ = ["check_row_table", "join_rows", "notes_of", "vehicle_name", "with_present_types"]


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


HEIGHT_M = (0.0, 20.0)  # Median height over the ground
FASTEST = 15.0  # 99 % of the speeds, m/s
FARTHEST_M = 50.0  # 99 % of the distances of neighbours
FORCE_G = (0.3, 60.0)
"""99 % of the vertical forces are smaller than the second, and not all smaller than the first."""
TORQUE_N_M = 0.05  # 99 % of the torques; a small quadrotor gives 6e-3 N m at most


def check_row_table(rows: InteractionRows, units: bool = True) -> None:
    """Refuse a table of finite numbers of the right shapes that cannot be what it says.

    Raises:
        ValueError: a rule is broken; the message names the value, the rule and the fix.
    """
    if not len(rows):
        raise ValueError("it holds no row; add rows or remove the file")
    _check_twice(rows)
    if units:
        _check_sizes(rows)


def notes_of(rows: InteractionRows) -> tuple[str, ...]:
    """What is odd about a table, though nothing is wrong with it."""
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


def _check_sizes(rows: InteractionRows) -> None:
    _check_height(rows)
    speed, pair = np.linalg.norm(rows.velocity, axis=1), rows.neighbor[rows.has_neighbor]
    fix = "it looks like millimetres a second: divide by 1000"
    _check_below("velocity", speed, FASTEST, "m/s", fix if _largest(speed) > 100.0 else "give m/s")
    apart, closing = (np.linalg.norm(pair[:, k : k + 3], axis=1) for k in (0, 3))
    _check_below("neighbor[..., :3]", apart, FARTHEST_M, "m", "give p_j - p_i in m")
    _check_below("neighbor[..., 3:]", closing, 2.0 * FASTEST, "m/s", "give v_j - v_i in m/s")
    force, (low, high) = np.abs(rows.force_g[:, 2]), FORCE_G
    if 0.0 < _largest(force) < low:
        raise ValueError(
            f"force_g[:, 2] stays below {_largest(force):.3g} g, but must reach {low:g} g; it "
            f"looks like newtons: divide by {GRAM_FORCE:.6g}. If the forces are so weak, set "
            "check_units to False"
        )
    fix = f"give gram-force without the weight; if it is millinewtons: divide by {GRAVITY}"
    _check_below("force_g[:, 2]", force, high, "g", fix)
    if rows.torque is not None:
        size = np.abs(rows.torque)
        _check_below("torque", size, TORQUE_N_M, "N m", "give N m")


def _largest(values: FloatArray) -> float:
    return float(np.quantile(values, 0.99)) if values.size else 0.0


def _check_below(name: str, values: FloatArray, most: float, unit: str, fix: str) -> None:
    found = _largest(values)
    if found > most:
        raise ValueError(
            f"{name} reaches {found:.4g} {unit}, but must stay below {most:g} {unit}; {fix}"
        )


def _check_height(rows: InteractionRows) -> None:
    height = float(np.median(rows.position[:, 2]))
    low, high = HEIGHT_M
    if not low <= height <= high:
        fix = "give heights over the ground in m"
        if height < low:
            fix = "z must point up: turn the sign of position, velocity and neighbours round"
        elif height > 200.0:
            fix = "it looks like millimetres: divide by 1000"
        raise ValueError(
            f"position[:, 2] is usually {height:.4g}, but must be {low:g} to {high:g} m; {fix}"
        )
