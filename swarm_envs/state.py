"""The state and parameters of drones, and set-points, as named arrays of shape (E, N, ...).

E is the number of environments, N that of drones.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from swarm_envs.tables import Records
from swarm_envs.vehicles import Team, Vehicle

__all__ = [
    "BoolArray",
    "FloatArray",
    "IntArray",
    "Parameters",
    "Setpoint",
    "SwarmState",
    "hover_state",
    "parameters",
    "state_of",
]

FloatArray = npt.NDArray[np.float64]
"""An array of float64."""
IntArray = npt.NDArray[np.int64]
"""An array of int64."""
BoolArray = npt.NDArray[np.bool_]
"""An array of booleans."""


class SwarmState(NamedTuple):
    """State of the drones. World frame (x, y horizontal, z up, origin on the ground), SI units."""

    position: FloatArray
    """(E, N, 3) position p of the center of mass, m."""
    velocity: FloatArray
    """(E, N, 3) velocity v, m/s."""
    quaternion: FloatArray
    """(E, N, 4) attitude, body to world, in the order (x, y, z, w), of unit length."""
    angular_velocity: FloatArray
    """(E, N, 3) angular velocity in the *world* frame, rad/s."""
    rotor_thrust: FloatArray
    """(E, N, 4) present thrust of each rotor, N."""
    battery: FloatArray
    """(E, N) charge, from 1 (full) to 0 (empty)."""

    def copy(self) -> SwarmState:
        """Return a copy."""
        return SwarmState(*(array.copy() for array in self))

    def read_only(self) -> SwarmState:
        """Return read-only views of the arrays."""
        views = SwarmState(*(array.view() for array in self))
        for view in views:
            view.flags.writeable = False
        return views


def state_of(drones: Records) -> SwarmState:
    """Return the state of drones (E, N) as read-only views of their records."""
    return SwarmState(*(drones[name] for name in SwarmState._fields)).read_only()


class Parameters(NamedTuple):
    """The parameters of the drones."""

    mass: FloatArray
    """(E, N) mass m, kg."""
    inertia: FloatArray
    """(E, N, 3) principal moments of inertia, kg m^2."""
    motor_rate: FloatArray
    """(E, N) motor rate lambda, 1/s."""
    max_rotor_thrust: FloatArray
    """(E, N) largest thrust of one rotor at a full battery, N."""
    rotor_offset: FloatArray
    """(E, N) distance of each rotor from the body x and y axes, m: arm / sqrt 2 in an X."""
    thrust_to_torque: FloatArray
    """(E, N) yaw torque per newton of rotor thrust, m."""
    radius: FloatArray
    """(E, N) radius of the collision sphere, m."""

    def copy(self) -> Parameters:
        """Return a copy."""
        return Parameters(*(array.copy() for array in self))


def parameters(team: Sequence[Vehicle]) -> Parameters:
    """Return the nominal parameters of a team, with shapes (N, ...)."""

    def table(values: Sequence[object]) -> FloatArray:
        return np.array(values, dtype=np.float64)

    return Parameters(
        mass=table([v.mass for v in team]),
        inertia=table([v.inertia for v in team]),
        motor_rate=table([v.motor_rate for v in team]),
        max_rotor_thrust=table([v.max_rotor_thrust for v in team]),
        rotor_offset=table([v.arm / np.sqrt(2.0) for v in team]),
        thrust_to_torque=table([v.thrust_to_torque for v in team]),
        radius=table([v.radius for v in team]),
    )


def hover_state(team: Team, position: npt.ArrayLike) -> SwarmState:
    """Return the state of a team at rest, with rotors at hover thrust and full batteries.

    Positions are (E, N, 3), or (N, 3) for one environment, m.

    Raises:
        ValueError: the positions do not fit the team.
    """
    p = np.array(position, dtype=np.float64)
    if p.ndim == 2:
        p = p[None]
    if p.ndim != 3 or p.shape[1:] != (len(team), 3):
        raise ValueError(
            f"position has shape {np.shape(position)}, but a team of {len(team)} needs "
            f"({len(team)}, 3) or (E, {len(team)}, 3)"
        )
    envs, drones = p.shape[:2]
    quaternion = np.zeros((envs, drones, 4))
    quaternion[..., 3] = 1.0
    hover = np.array([v.hover_rotor_thrust for v in team])
    return SwarmState(
        position=p,
        velocity=np.zeros((envs, drones, 3)),
        quaternion=quaternion,
        angular_velocity=np.zeros((envs, drones, 3)),
        rotor_thrust=np.repeat(np.repeat(hover[None, :, None], envs, axis=0), 4, axis=2),
        battery=np.ones((envs, drones)),
    )


class Setpoint(NamedTuple):
    """The set-points of the drones' tracking controllers at one instant. World frame, SI units."""

    position: FloatArray
    """(E, N, 3) desired position p_d, m."""
    velocity: FloatArray
    """(E, N, 3) its derivative, m/s."""
    acceleration: FloatArray
    """(E, N, 3) its second derivative, m/s^2."""
    jerk: FloatArray
    """(E, N, 3) its third derivative, m/s^3, which extrapolates set-points between decisions."""
    yaw: FloatArray
    """(E, N) desired rotation about the thrust axis, from the world x axis, rad."""
    yaw_rate: FloatArray
    """(E, N) derivative of yaw, rad/s."""

    @classmethod
    def zeros(cls, num_envs: int, num_drones: int) -> Setpoint:
        """Return set-points at rest at the origin."""
        shape = (num_envs, num_drones)
        widths = ((3,), (3,), (3,), (3,), (), ())
        return cls._make(np.zeros((*shape, *width)) for width in widths)

    @classmethod
    def hold(cls, position: FloatArray) -> Setpoint:
        """Return set-points at rest at positions (E, N, 3), m."""
        setpoint = cls.zeros(*position.shape[:2])
        setpoint.position[...] = position
        return setpoint

    def copy(self) -> Setpoint:
        """Return a copy."""
        return Setpoint(*(array.copy() for array in self))
