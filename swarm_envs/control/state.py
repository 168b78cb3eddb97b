"""What a controller remembers between steps, and what it is asked to follow: arrays over (E, N)."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from swarm_envs.compiled import borrowing_kernel
from swarm_envs.state import BoolArray, FloatArray


class ControllerState(NamedTuple):
    """Memory of the tracking controller of every drone; all zero means freshly reset."""

    velocity_integral: FloatArray
    """(E, N, 3) integral of the velocity error, world frame, m."""
    rate_integral: FloatArray
    """(E, N, 3) integral of the body-rate error, body frame, rad."""
    thrust: FloatArray
    """(E, N) desired thrust T_d of the last step, N."""
    thrust_rate: FloatArray
    """(E, N) low-passed derivative of the desired thrust, N/s."""
    rate_error: FloatArray
    """(E, N, 3) body-rate error of the last step, body frame, rad/s."""
    rate_error_rate: FloatArray
    """(E, N, 3) low-passed derivative of the body-rate error, body frame, rad/s^2."""
    desired_attitude: FloatArray
    """(E, N, 4) desired tilt of the last step, quaternion (x, y, z, w), before the turn by yaw."""
    desired_rate: FloatArray
    """(E, N, 3) low-passed angular velocity of the desired tilt, in its own frame, rad/s."""
    started: BoolArray
    """(E, N) whether a step was made since the reset: derivatives are zero on the first one."""

    @classmethod
    def zeros(cls, num_envs: int, num_drones: int) -> ControllerState:
        """Memory of freshly reset controllers."""
        shape = (num_envs, num_drones)
        return cls(
            velocity_integral=np.zeros((*shape, 3)),
            rate_integral=np.zeros((*shape, 3)),
            thrust=np.zeros(shape),
            thrust_rate=np.zeros(shape),
            rate_error=np.zeros((*shape, 3)),
            rate_error_rate=np.zeros((*shape, 3)),
            desired_attitude=np.zeros((*shape, 4)),
            desired_rate=np.zeros((*shape, 3)),
            started=np.zeros(shape, dtype=np.bool_),
        )

    def copy(self) -> ControllerState:
        """Return a memory whose arrays are independent of this one's."""
        twin = ControllerState.zeros(*self.thrust.shape)
        twin.assign(self)
        return twin

    def assign(self, other: ControllerState, mask: BoolArray | None = None) -> None:
        """Copy another memory's values into these arrays, in the environments of the (E,) mask."""
        where = slice(None) if mask is None else mask
        for mine, theirs in zip(self, other, strict=True):
            mine[where] = theirs[where]

    def reset(self, mask: BoolArray | None = None) -> None:
        """Forget everything in the environments of the (E,) mask, or in all of them."""
        where = slice(None) if mask is None else mask
        for array in self:
            array[where] = 0


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


@borrowing_kernel
def forget_flight(e: int, memory: ControllerState) -> None:
    """Forget everything in environment `e`."""
    for i in range(memory.started.shape[1]):
        memory.thrust[e, i] = memory.thrust_rate[e, i] = 0.0
        memory.started[e, i] = False
        for k in range(4):
            memory.desired_attitude[e, i, k] = 0.0
        for k in range(3):
            memory.velocity_integral[e, i, k] = memory.rate_integral[e, i, k] = 0.0
            memory.rate_error[e, i, k] = memory.rate_error_rate[e, i, k] = 0.0
            memory.desired_rate[e, i, k] = 0.0


@borrowing_kernel
def hold(e: int, position: FloatArray, setpoint: Setpoint) -> None:
    """Rest environment `e`'s set-points at positions (E, N, 3), m."""
    for i in range(position.shape[1]):
        setpoint.yaw[e, i] = setpoint.yaw_rate[e, i] = 0.0
        for k in range(3):
            setpoint.position[e, i, k] = position[e, i, k]
            setpoint.velocity[e, i, k] = setpoint.acceleration[e, i, k] = 0.0
            setpoint.jerk[e, i, k] = 0.0
