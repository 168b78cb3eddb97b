"""What a vehicle logs of its motors: signals and battery voltage that give the commanded thrust."""

from __future__ import annotations

import numpy as np

from swarm_envs.motors import FULL_VOLTAGE, BatteryModel, rotor_force_g
from swarm_envs.state import FloatArray
from swarm_envs.training.collection.labels import lagged_thrust
from swarm_envs.vehicles import GRAM_FORCE, Team, Vehicle

PWM_SPAN = 65536.0
"""Motor signals are PWM over this (Neural-Swarm2, Sec. VII-A)."""
LARGEST_PWM = 65535.0
"""The signal of a motor at full power."""


def motor_signals(
    commands: FloatArray, team: Team, rate_hz: float
) -> tuple[FloatArray, FloatArray]:
    """Signals and voltages under which psi1 (Table I) gives the commanded thrust.

    The battery is full at the start and empties as `BatteryModel` says; its voltage sags with the
    current. Where psi1 reaches a thrust with no signal from 0 to 65535, the nearest signal stands.

    Args:
        commands: (T, N, 4) commanded rotor thrusts, N.
        team: the N vehicles.
        rate_hz: log entries per second.

    Returns:
        Signals (T, N, 4), 0 to 65535, and voltages (T, N), V.
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
