"""One drone of a flight's table."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from swarm_envs.motors import FULL_VOLTAGE, rotor_force_g
from swarm_envs.state import FloatArray
from swarm_envs.training.collection.signals import PWM_SPAN
from swarm_envs.vehicles import Vehicle


class DroneLog(NamedTuple):
    """Lines of one drone, T of them, in order of time; units as in `FlightTable`."""

    name: str
    """Of the physical vehicle."""
    vehicle: Vehicle
    """Its type."""
    time: FloatArray
    """(T,) s."""
    position: FloatArray
    """(T, 3) m, world frame."""
    velocity: FloatArray
    """(T, 3) m/s, world frame."""
    quaternion: FloatArray
    """(T, 4) x, y, z, w, body to world."""
    acceleration: FloatArray | None
    """(T, 3) m/s^2, world frame, with gravity; None if it was not logged."""
    pwm: FloatArray
    """(T, 4) signals of the motors."""
    voltage: FloatArray
    """(T,) of the battery, V."""

    @property
    def step_s(self) -> float:
        """Usual time between two lines, s."""
        return float(np.median(np.diff(self.time)))

    def thrust_g(self) -> FloatArray:
        """Thrust (T,) that psi1 gives at the logged signals, gram-force."""
        volts = self.voltage[:, None] / FULL_VOLTAGE
        force = rotor_force_g(self.vehicle, self.pwm / PWM_SPAN, volts)
        return np.asarray(force).sum(axis=-1)
