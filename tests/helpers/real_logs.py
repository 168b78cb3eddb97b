"""Simulated flights, written as the logs of real vehicles: with motor signals and voltages."""

from __future__ import annotations

import csv
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from swarm_envs.files import pyarrow
from swarm_envs.motors import FULL_VOLTAGE, BatteryModel
from swarm_envs.reference import rotate
from swarm_envs.state import FloatArray
from swarm_envs.training.collection.flight import vehicle_names
from swarm_envs.training.collection.log import FlightLog, lagged_thrust
from swarm_envs.training.flight_logs import FlightTable
from swarm_envs.training.flight_logs.checks import PWM_SPAN
from swarm_envs.training.flight_logs.flight_table import GROUPS
from swarm_envs.vehicles import GRAM_FORCE, Team, Vehicle


def motor_signals(
    commands: FloatArray, team: Team, rate_hz: float
) -> tuple[FloatArray, FloatArray]:
    """Signals (T, N, 4), 0 to 65535, and voltages (T, N), V, at which psi1 (Table I) gives thrusts.

    The commanded rotor thrusts are (T, N, 4), N. The battery is full at the start and empties as
    `BatteryModel` says; its voltage sags with the current. Where psi1 reaches a thrust with no
    signal, the nearest stands.
    """
    battery = BatteryModel()
    drones = battery.of_team(team)
    capacity, resistance = drones["battery_capacity"], drones["battery_resistance"]
    thrust = lagged_thrust(commands, team, 1.0 / rate_hz)
    current = battery.idle_current_a + battery.current_per_newton * thrust
    charge = 1.0 - np.cumsum(current, axis=0) / (rate_hz * capacity)
    full = np.linspace(0.0, 1.0, len(battery.open_circuit))
    volts = np.interp(charge, full, battery.open_circuit) - resistance * current
    signal = np.empty_like(commands)
    for i, vehicle in enumerate(team):
        signal[:, i] = _signal(vehicle, commands[:, i] / GRAM_FORCE, volts[:, i, None])
    return np.clip(PWM_SPAN * signal, 0.0, 65535.0), FULL_VOLTAGE * volts


def _signal(vehicle: Vehicle, force_g: FloatArray, volts: FloatArray) -> FloatArray:
    """The root of psi1(p, v) = f on its rising branch; where there is none, its minimum."""
    a, b, c, d, e = vehicle.pwm_to_force
    slope = b + e * volts
    inside = slope * slope - 4.0 * d * (a + c * volts - force_g)
    return np.asarray((np.sqrt(np.maximum(inside, 0.0)) - slope) / (2.0 * d))


def to_table(log: FlightLog, team: Team, rate_hz: float) -> FlightTable:
    """The log as real vehicles would have written it.

    Rotor thrusts become motor signals and voltages by psi1 of Table I, and the specific force the
    acceleration in the world by the logged attitude.
    """
    count, drones = log.position.shape[:2]
    pwm, voltage = motor_signals(log.commands, team, rate_hz)
    return FlightTable(
        drone=np.tile(np.array(vehicle_names(team)), count),
        type=np.tile(np.array([vehicle.token for vehicle in team]), count),
        time=np.repeat(np.arange(count) / rate_hz, drones),
        position=_lines(log.position),
        velocity=_lines(log.velocity),
        quaternion=_lines(log.quaternion),
        acceleration=_lines(rotate(log.quaternion, log.specific_force)),
        pwm=_lines(pwm),
        voltage=_lines(voltage),
        line=np.arange(count * drones) + 2,
    )


def _lines(values: FloatArray) -> FloatArray:
    """Values (T, N, ...) as (T N, ...): the drones of a time follow each other."""
    return values.reshape(-1, *values.shape[2:])


def columns_of(table: FlightTable) -> dict[str, npt.NDArray[Any]]:
    """The columns of a table by their names."""
    found: dict[str, npt.NDArray[Any]] = {"drone": table.drone, "type": table.type}
    for group, names in GROUPS.items():
        values = getattr(table, group)
        if values is not None:
            found |= zip(names, values.reshape(len(table), len(names)).T, strict=True)
    return found


def write_table(path: Path, table: FlightTable) -> None:
    """Write a table as CSV or Parquet, by the ending of the path."""
    path.parent.mkdir(parents=True, exist_ok=True)
    columns = {name: values.tolist() for name, values in columns_of(table).items()}
    if path.suffix == ".parquet":
        arrow, parquet = pyarrow(path.name, "write the table as CSV")
        parquet.write_table(arrow.table(columns), path)
        return
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(columns)
        writer.writerows(zip(*columns.values(), strict=True))
