"""Files of flights: npz without pickle, or Parquet in the format of real flight logs.

A real vehicle logs motor signals and battery voltage; here both are made from the commanded thrust.
"""

from __future__ import annotations

from pathlib import Path
from typing import Literal

import numpy as np

from swarm_envs.files import written_whole
from swarm_envs.motors import FULL_VOLTAGE, BatteryModel, rotor_force_g
from swarm_envs.state import FloatArray
from swarm_envs.training.collection.flight import vehicle_names
from swarm_envs.training.collection.log import (
    FlightLog,
    lagged_thrust,
    rotate,
    rotate_to_body,
)
from swarm_envs.training.flight_table import FlightTable, read_table, write_flight_table
from swarm_envs.vehicles import GRAM_FORCE, Team, Vehicle

__all__ = ["PWM_SPAN", "commanded_thrust", "flight_file", "read_log"]

PWM_SPAN = 65536.0
"""Motor signals are PWM over this (Neural-Swarm2, Sec. VII-A)."""
LARGEST_PWM = 65535.0  # The signal of a motor at full power


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
    return np.clip(PWM_SPAN * signal, 0.0, LARGEST_PWM), FULL_VOLTAGE * volts


def commanded_thrust(pwm: FloatArray, voltage: FloatArray, team: Team) -> FloatArray:
    """Rotor thrusts (T, N, 4), N, that psi1 gives at signals (T, N, 4) and voltages (T, N), V."""
    thrust = np.empty_like(pwm)
    for i, vehicle in enumerate(team):
        volts = voltage[:, i, None] / FULL_VOLTAGE
        thrust[:, i] = GRAM_FORCE * rotor_force_g(vehicle, pwm[:, i] / PWM_SPAN, volts)
    return thrust


def _signal(vehicle: Vehicle, force_g: FloatArray, volts: FloatArray) -> FloatArray:
    """The root of psi1(p, v) = f on its rising branch; where there is none, its minimum."""
    a, b, c, d, e = vehicle.pwm_to_force
    slope = b + e * volts
    inside = slope * slope - 4.0 * d * (a + c * volts - force_g)
    return np.asarray((np.sqrt(np.maximum(inside, 0.0)) - slope) / (2.0 * d))


Format = Literal["npz", "parquet"]  # Formats of a logged flight


def flight_file(out: Path, name: str, form: str = "npz") -> Path:
    """The file of a flight."""
    return out / f"{name}.{form}"


def save_log(
    path: Path, log: FlightLog, team: Team, rate_hz: float, accelerometer: bool = True
) -> None:
    """Write a log, atomically, as the path's ending says: `.npz` (single precision) or `.parquet`.

    `accelerometer` writes the acceleration into Parquet too; a fit then takes its label from there.

    Raises:
        ImportError: it is to be Parquet, and pyarrow is not installed.
    """
    if path.suffix == ".parquet":
        write_flight_table(path, to_table(log, team, rate_hz, accelerometer))
        return
    arrays = {name: array.astype(np.float32) for name, array in log._asdict().items()}
    with written_whole(path) as partial:
        np.savez(partial, allow_pickle=False, **arrays)


def read_log(path: Path, team: Team | None = None) -> FlightLog:
    """Read a file that `save_log` wrote; Parquet needs the team.

    Raises:
        FileNotFoundError: there is none.
    """
    if path.suffix == ".parquet":
        if team is None:
            raise ValueError(f"{path.name} is Parquet, whose lines are no team; give the team")
        return from_table(read_table(path), team)
    with np.load(path, allow_pickle=False) as file:
        return FlightLog(*(file[name].astype(np.float64) for name in FlightLog._fields))


def to_table(log: FlightLog, team: Team, rate_hz: float, accelerometer: bool = True) -> FlightTable:
    """The log as real vehicles would have written it; see `swarm_envs.training.flight_logs`.

    Rotor thrusts become motor signals and voltages by psi1 of Table I, and the specific force the
    acceleration in the world by the logged attitude.
    """
    count, drones = log.position.shape[:2]
    pwm, voltage = motor_signals(log.commands, team, rate_hz)
    acceleration = rotate(log.quaternion, log.specific_force)
    return FlightTable(
        drone=np.tile(np.array(vehicle_names(team)), count),
        type=np.tile(np.array([vehicle.token for vehicle in team]), count),
        time=np.repeat(np.arange(count) / rate_hz, drones),
        position=_lines(log.position),
        velocity=_lines(log.velocity),
        quaternion=_lines(log.quaternion),
        acceleration=_lines(acceleration) if accelerometer else None,
        pwm=_lines(pwm),
        voltage=_lines(voltage),
    )


def from_table(table: FlightTable, team: Team) -> FlightLog:
    """The log that `to_table` made a table of; no set-points, and NaN for no acceleration."""
    drones, names = len(team), vehicle_names(team)
    if tuple(table.drone[:drones]) != names or len(table) % drones:
        raise ValueError(
            f"a table begins with the drones {', '.join(table.drone[:drones])}, but must list "
            f"{', '.join(names)} at every time; collect it again"
        )

    def array(values: FloatArray) -> FloatArray:
        return values.reshape(-1, drones, *values.shape[1:])

    position, quaternion = array(table.position), array(table.quaternion)
    unknown = np.full(position.shape, np.nan)
    specific = unknown
    if table.acceleration is not None:
        specific = rotate_to_body(quaternion, array(table.acceleration))
    return FlightLog(
        position=position,
        velocity=array(table.velocity),
        quaternion=quaternion,
        specific_force=specific,
        setpoint=unknown,
        commands=commanded_thrust(array(table.pwm), array(table.voltage), team),
    )


def _lines(values: FloatArray) -> FloatArray:
    """Values (T, N, ...) as (T N, ...): the drones of a time follow each other."""
    return values.reshape(-1, *values.shape[2:])
