"""Motors and batteries: the identified polynomials of Table I, and the loss of thrust with charge.

Voltages are normalized as in the paper, v = Vbat / 4.2 V, and so are motor signals, p = PWM / 65536
(Neural-Swarm2, Sec. VII-A). The battery is a lithium-polymer cell with an internal resistance:

- current: I = I_idle + k T, with T the total thrust, fitted to Bitcraze's measurement;
- charge: dq = -I dt / capacity;
- voltage: the open-circuit voltage at that charge minus R I. R follows from Table I: psi3 gives the
  largest force at the voltage *measured under a signal p*, so that its term in p is the voltage
  drop due to that signal;
- largest force of a rotor: psi3 at that voltage and signal, at most that of a full battery.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from swarm_envs.compiled import part
from swarm_envs.errors import check_number, check_type
from swarm_envs.state import FloatArray
from swarm_envs.tables import Record
from swarm_envs.vehicles import GRAM_FORCE, SMALL, Vehicle

__all__ = ["FULL_VOLTAGE", "BatteryModel", "pwm_for_force", "rotor_force_g"]

FULL_VOLTAGE = 4.2
"""The voltage of a full cell, with which Table I normalizes, V."""

_LITHIUM_POLYMER_V = (3.27, 3.69, 3.73, 3.77, 3.80, 3.84, 3.87, 3.95, 4.02, 4.11, 4.20)


def rotor_force_g(
    vehicle: Vehicle, pwm: npt.ArrayLike, voltage: npt.ArrayLike
) -> np.float64 | FloatArray:
    """Return the force of a rotor, g, at a signal PWM / 65536 and a voltage over 4.2 V: psi1.

    The fit (Table I) has its minimum near p = 0.2 and holds for the signals of flight, above 0.3;
    at p = 0 it is some grams instead of 0. Signal and voltage, measured under it, broadcast.
    """
    a, b, c, d, e = vehicle.pwm_to_force
    p, v = np.asarray(pwm, dtype=np.float64), np.asarray(voltage, dtype=np.float64)
    return a + b * p + c * v + d * p * p + e * p * v


def pwm_for_force(
    vehicle: Vehicle, force_g: npt.ArrayLike, voltage: npt.ArrayLike
) -> np.float64 | FloatArray:
    """Return the signal PWM / 65536 for a rotor's force, g, at a voltage over 4.2 V: psi2.

    This fit (Table I) is not the exact inverse of psi1: between half and one and a half times the
    force of hover, at 3.4 to 4.0 V, psi1(psi2(f)) differs from f by at most 1.0 g (small) and 3.7 g
    (large), with an RMS of 0.5 g and 1.6 g. It is not limited to [0, 1].
    """
    a, b, c, d, e = vehicle.force_to_pwm
    f, v = np.asarray(force_g, dtype=np.float64), np.asarray(voltage, dtype=np.float64)
    return a + b * f + c * v + d * f * f + e * f * v


@dataclass(frozen=True)
class BatteryModel:
    """A model of batteries. The defaults are a Crazyflie's: six minutes of hover at 34 g.

    Raises:
        ValueError: a value is invalid; the message names it, the rule and the fix.
    """

    capacity_ah: float = 0.25
    """Capacity of the battery of `SMALL`, ampere-hours, that of a Crazyflie 2.X. Those of other
    vehicles are not published and assumed in proportion to the mass."""
    idle_current_a: float = 0.24
    """Current with the rotors at rest, A (Bitcraze, "PWM to thrust", at 0 % PWM)."""
    current_per_newton: float = 7.0
    """Current per newton of total thrust, A/N, for every vehicle: a linear fit to the rows of the
    same table up to 37 g, within 0.1 A."""
    open_circuit_v: tuple[float, ...] = _LITHIUM_POLYMER_V
    """Voltage without load at evenly spaced charges from empty to full, V, of a typical
    lithium-polymer cell; it rises with charge."""

    def __post_init__(self) -> None:
        """Raise ValueError for invalid values."""
        check_number("capacity_ah", self.capacity_ah, above=0.0, unit="Ah")
        for name in ("idle_current_a", "current_per_newton"):
            check_number(name, getattr(self, name), at_least=0.0)
        check_type("open_circuit_v", self.open_circuit_v, tuple | list)
        volts = np.array(self.open_circuit_v, dtype=np.float64)
        if volts.size < 2 or not (np.diff(volts) > 0.0).all() or not volts[0] > 0.0:
            raise ValueError(
                f"open_circuit_v is {self.open_circuit_v}, but must list at least two voltages "
                "that rise from empty to full, such as (3.3, 3.8, 4.2)"
            )

    def of_team(self, team: Sequence[Vehicle]) -> dict[str, FloatArray]:
        """Return the fields of the drones' table for the batteries of a team: (N, ...) by name."""
        sag = np.array([v.pwm_to_max_force[1] / v.pwm_to_max_force[2] for v in team])
        full_load = self.current_per_newton * np.array([v.max_thrust for v in team])
        capacity = 3600.0 * self.capacity_ah * np.array([v.mass / SMALL.mass for v in team])
        resistance = np.divide(sag, full_load, out=np.zeros_like(sag), where=full_load > 0.0)
        return {
            "battery_capacity": capacity,
            "battery_resistance": resistance,
            "force_to_pwm": np.array([v.force_to_pwm for v in team], dtype=np.float64),
            "pwm_to_max_force": np.array([v.pwm_to_max_force for v in team], dtype=np.float64),
        }

    @property
    def open_circuit(self) -> FloatArray:
        """The voltage (K,) without load over 4.2 V, at K evenly spaced charges from 0 to 1."""
        return np.array(self.open_circuit_v, dtype=np.float64) / FULL_VOLTAGE


@part
def current(rotor_thrust_total_n: float, settings: Record) -> float:
    """Return the current of a vehicle, A, at a total thrust of its rotors, N."""
    return settings.idle_current + settings.current_per_newton * rotor_thrust_total_n


@part
def voltage(
    charge: float,
    rotor_thrust_total_n: float,
    drone: Record,
    settings: Record,
    open_circuit: FloatArray,
) -> float:
    """Return the voltage of a battery over 4.2 V, at a charge from 0 to 1 and a total thrust, N.

    `open_circuit` (K,) is the voltage without load over 4.2 V, at evenly spaced charges.
    """
    last = open_circuit.shape[0] - 1
    position = charge * last
    k = min(int(position), last - 1)
    low, high = open_circuit[k], open_circuit[k + 1]
    load = current(rotor_thrust_total_n, settings)
    return low + (position - k) * (high - low) - drone.battery_resistance * load


@part
def limit_rotors(
    charge: float,
    rotor_thrust_total_n: float,
    drone: Record,
    settings: Record,
    open_circuit: FloatArray,
) -> float:
    """Return the largest force of a rotor at a charge and a total thrust, N: psi3, with a limit.

    The signal in psi3 is psi2 of the mean force, clipped to [0, 1]; the limit is the vehicle's
    largest force. With an empty battery, the force is 0. The arguments are those of `voltage`.
    """
    if charge <= 0.0:
        return 0.0
    v = voltage(charge, rotor_thrust_total_n, drone, settings, open_circuit)
    f = rotor_thrust_total_n / (4.0 * GRAM_FORCE)
    a = drone.force_to_pwm
    p = a[0] + a[1] * f + a[2] * v + a[3] * f * f + a[4] * f * v
    b = drone.pwm_to_max_force
    limit_g = b[0] + b[1] * min(max(p, 0.0), 1.0) + b[2] * v
    return max(min(limit_g * GRAM_FORCE, drone.max_rotor_thrust), 0.0)


@part
def drain(
    charge: float,
    rotor_thrust_total_n: float,
    drone: Record,
    settings: Record,
    open_circuit: FloatArray,
    dt: float,
) -> tuple[float, float]:
    """Return the charge of a battery and the largest force of a rotor, N, after a step dt, s."""
    used = current(rotor_thrust_total_n, settings) * dt / drone.battery_capacity
    left = max(charge - used, 0.0)
    return left, limit_rotors(left, rotor_thrust_total_n, drone, settings, open_circuit)
