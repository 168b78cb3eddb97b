"""What a tracking controller is asked to follow: arrays over (E, N)."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from swarm_envs.state import BoolArray, FloatArray


class Setpoint(NamedTuple):
    """What every drone is asked to follow at one instant. World frame, SI units."""

    position: FloatArray
    """(E, N, 3) desired position p_d, m."""
    velocity: FloatArray
    """(E, N, 3) its derivative, m/s."""
    acceleration: FloatArray
    """(E, N, 3) its second derivative, m/s^2."""
    jerk: FloatArray
    """(E, N, 3) its third derivative, m/s^3: used to extrapolate between decisions."""
    yaw: FloatArray
    """(E, N) desired turn about the thrust axis, from the world x axis, rad."""
    yaw_rate: FloatArray
    """(E, N) derivative of yaw, rad/s."""

    @classmethod
    def zeros(cls, num_envs: int, num_drones: int) -> Setpoint:
        """Set-points at the origin, at rest."""
        shape = (num_envs, num_drones)
        widths = ((3,), (3,), (3,), (3,), (), ())
        return cls._make(np.zeros((*shape, *width)) for width in widths)

    @classmethod
    def hold(cls, position: FloatArray) -> Setpoint:
        """Set-points at rest at the given (E, N, 3) positions, m."""
        setpoint = cls.zeros(*position.shape[:2])
        setpoint.position[...] = position
        return setpoint

    def copy(self) -> Setpoint:
        """Return set-points whose arrays are independent of these."""
        return Setpoint(*(array.copy() for array in self))

    def assign(self, other: Setpoint, mask: BoolArray | None = None) -> None:
        """Copy other set-points into these arrays, in the environments of the (E,) mask."""
        where = slice(None) if mask is None else mask
        for mine, theirs in zip(self, other, strict=True):
            mine[where] = theirs[where]
